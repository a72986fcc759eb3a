"""Measurements as plain data classes in radians, metres and nanoseconds.

The folder imports no other folder of the package. The steps for a new kind of sensor are listed in ``ros/__init__``.
"""
