"""What the three papers print, and what we compute for it: the rows, tables and pictures of docs/reproduction.md.

The peers, which are the papers' own methods and formulas, live here and in ``ship_testing``: the suite uses none of
them. One module a paper, and one each for the factors and the conclusions of [Z14].
"""
