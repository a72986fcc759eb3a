"""Theodolite pointing: axis errors, calibrated with beacons on drones, and the direction of the main axis over time.

Each folder imports only folders named below it:

- ``axis_fit`` fits axis errors to a table of sightings, ``design`` predicts the accuracy before a voyage,
  ``triangulation`` computes positions of targets from recorded directions.
- ``ros`` converts messages to samples and results to messages.
- ``smoothing`` improves pointings by later sightings.
- ``optical_axis`` is the core of the node.
- ``target`` gives directions and positions of targets; ``escort`` gives advised positions of the drones.
- ``filter`` estimates axis errors, deformation and the ship's error.
- ``measured`` holds the samples, ``config`` the parameters.
- ``lights`` is the camera model for beacons, and computes the telescope's attitude from their images.
- ``axis_geometry`` is the mount model: zero points, collimation, non-perpendicularity, tilt and flexure.
"""
