"""Simulated arrays as messages in the order of their arrival.

The room imports all other rooms but ``suite/``, and the names of the axis errors (``theodolite_calib.axis_geometry``).
"""
