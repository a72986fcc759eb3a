"""Results of the three papers as printed and as computed here: rows, tables and figures of docs/reproduction.md.

The peers, which are the papers' own methods and formulas, are here and in ``ship_testing``: the suite does not use
them. There is one module per paper, and one each for the factors and the conclusions of [Z14].
"""
