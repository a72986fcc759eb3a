"""Core of the node ``optical_axis``: encoders, ship, baselines and beacons in, the main axis out.

The folder adds time order, the output and the saved calibration to the filter. It may import ``filter``, ``target``,
``escort`` and the folders below.
"""
