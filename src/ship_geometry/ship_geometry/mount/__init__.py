"""Geometry of a theodolite with beacons: mount, calibration telescope, image and lines of sight.

- ``axes`` gives the main axis from the ship's attitude, encoders and axis errors, and the inverse; and the telescope's
  attitude from that of the main frame.
- ``image`` relates points on the detector to directions.
- ``line_of_sight`` gives the directions to the beacons, with the propagation of their errors.
"""
