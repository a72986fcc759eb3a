"""Everything random: noise processes, the sea, streaks.

All of it comes from seeds; the same seed gives the same numbers.
"""
