"""Theodolite pointing: axis errors calibrated by beacons on drones, and the main axis in the horizon at each reading.

Each of these parts may import only those after it:

- ``axis_fit``: fit of axis errors to a table of sightings; ``design``: accuracy study; ``triangulation``: command.
- ``ros``: adapters of the nodes, conversion of messages to samples and of results to messages.
- ``smoothing``: pointings improved by later sightings.
- ``optical_axis``: core of the node of that name.
- ``target``: directions and positions of targets; ``escort``: advice for the drones.
- ``filter``: calibration filter.
- ``measured``: samples, their checks and tracks.
- ``config``: parameters.
- ``lights`` and ``chain``: geometry of beacons and axes, without a configuration.
"""
