"""Comparison of a replay with recorded outputs to the last bit, for bags and black boxes."""
