"""Theodolite pointing: axis errors, calibrated with beacons on drones, and the direction of the main axis over time.

Each folder imports only folders named below it:

- ``nodes`` starts the nodes; ``commands`` has the command ``triangulate``.
- ``adapters`` define which topic feeds which method of a core.
- ``messages`` converts messages to samples and results to messages.
- ``smoothing`` improves pointings by later sightings.
- ``optical_axis`` is the core of the node.
- ``triangulation`` computes positions of targets from the directions of several theodolites.
- ``targets`` gives directions of targets; ``escort`` gives advised positions of the drones.
- ``filter`` estimates axis errors, deformation and the ship's error.
- ``samples`` holds the samples, ``config`` the parameters.
- ``beacon_camera`` computes the telescope's attitude from images of beacons, and checks the beacons' names.

The geometry of mount, telescope and lines of sight is in :mod:`ship_geometry.mount`.
"""
