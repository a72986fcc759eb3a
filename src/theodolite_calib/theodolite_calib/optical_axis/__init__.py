"""Core of the node ``optical_axis``: encoders, ship, baselines and beacons in, the main axis out.

The room adds time order, the output and the saved calibration to the filter. It may import all rooms except ``ros`` and
``axis_fit``.
"""
