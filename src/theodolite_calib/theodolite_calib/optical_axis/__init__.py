"""Core of the node ``optical_axis``: encoders, ship, baselines and beacons in, the main axis out.

The folder adds time order, the output and the saved calibration to the filter. The folder may import the folders that
:mod:`theodolite_calib` names below it.
"""
