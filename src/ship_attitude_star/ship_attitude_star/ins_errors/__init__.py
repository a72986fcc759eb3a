"""Error processes of an INS beyond independent first-order Gauss-Markov processes.

The folder imports ``vertical``, but neither stars nor the filter.
"""
