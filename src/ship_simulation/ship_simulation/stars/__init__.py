"""The true sky over the ship, and what sensors that look at it tell.

The room imports ``ship/``, ``draws/`` and ``scenario/``, and of ``ship_attitude_star`` the catalogue and the camera.
"""
