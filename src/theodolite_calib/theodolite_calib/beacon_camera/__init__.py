"""Beacons on the detector: the telescope's attitude from image and lines of sight, check of the beacons' names.

The folder holds measurement models without any configuration. It imports ``ship_geometry`` and ``ship_estimation``.
"""
