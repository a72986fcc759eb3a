"""Theodolite pointing: axis errors calibrated by beacons on drones, and the main axis in the horizon at each reading.

Each of these rooms imports only those after it. ``axis_fit`` fits axis errors to a table of sightings. ``ros`` converts
messages to samples and results to messages. ``smoothing`` improves pointings by later sightings. ``optical_axis`` is
the core of the node. ``target`` gives directions and positions of targets. ``filter`` estimates. ``measured`` holds the
samples. ``config`` holds the parameters. ``lights`` and ``axis_geometry`` are pure geometry.
"""
