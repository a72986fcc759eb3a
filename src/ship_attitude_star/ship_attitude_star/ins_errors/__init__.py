"""How the error of an INS goes on with time and way, where more is known of it than how fast it dies out.

Knows the vertical (room ``vertical``), no star and no filter.
"""
