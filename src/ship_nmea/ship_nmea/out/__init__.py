"""The node ``nmea_out``: its parameters, the sinks that sentences go to, and who tells what to which sink, when.

The room imports ``sentences`` and the shell. A sink works in a thread of its own, so that none can hold up another.
"""
