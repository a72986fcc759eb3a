"""Core of the node ``optical_axis``: encoders, ship, baselines and beacons in, main axis and directions of targets out.

The folder adds time order, the output, the targets and the saved calibration to the filter. The folder may import the
folders that :mod:`theodolite_calib` names below it.
"""
