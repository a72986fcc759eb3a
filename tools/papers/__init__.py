"""Results of the three papers, as printed and as computed here, in rows, tables and figures of docs/reproduction.md.

The peers, which are the methods and formulas of the papers, are here and in ``ship_testing``; the suite does not use
the peers. There is one module for each paper, and one module each for the factors and the conclusions of [Z14].
"""
