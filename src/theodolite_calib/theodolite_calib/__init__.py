"""Theodolite pointing: axis errors, calibrated with beacons on drones, and the direction of the main axis over time.

Each folder or module imports only those named below it:

- ``nodes`` starts the nodes; ``commands`` has the command ``triangulate``.
- ``adapters`` define which topic feeds which method of a core.
- ``messages`` converts messages to samples and results to messages.
- ``smoothing`` improves pointings by later sightings.
- ``optical_axis`` is the core of the node: pointings, and directions of targets.
- ``triangulation`` computes positions of targets from the directions of several theodolites.
- ``escort`` gives advised positions of the drones.
- ``filter`` estimates axis errors, deformation and the ship's error, and checks the beacons' names.
- ``samples`` holds the samples, ``config`` the parameters.

The geometry of mount, telescope and lines of sight is in :mod:`ship_geometry.mount`.
"""
