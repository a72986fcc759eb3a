"""What sensors say, as plain structs in radians, metres and nanoseconds.

The room imports no other room of the package. What else a new kind of sensor needs is told in ``ros/__init__``.
"""
