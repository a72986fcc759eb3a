"""Beacons on the detector: image, lines of sight, the telescope's attitude from both, check of the beacons' names.

The folder holds measurement models without any configuration, so that the simulation can use ``image`` and
``line_of_sight`` too. The folder imports ``ship_geometry`` and ``ship_estimation``.
"""
