"""Simulated arrays as messages in the order of their arrival.

The folder imports all other folders except ``suite/``, and the names of the axis errors
(``theodolite_calib.axis_geometry``).
"""
