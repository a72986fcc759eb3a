"""Everything random: streams of numbers, slow errors, the sea.

All of it comes from seeds: the same seed gives the same numbers. The room imports ``scenario/`` alone.
"""
