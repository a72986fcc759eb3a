"""Lights on the detector: their image, their lines of sight, the telescope's attitude from them, and which is which.

The room holds measurement models without any configuration, so that the simulation can build on ``image`` and
``line_of_sight`` too. It imports ``ship_geometry`` and ``ship_estimation``.
"""
