"""Simulated arrays as messages in the order of their arrival.

The folder imports all other folders but ``suite/``, and the names of the axis errors (``theodolite_calib.chain``).
"""
