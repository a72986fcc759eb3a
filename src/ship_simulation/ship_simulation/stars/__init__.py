"""The true sky over the ship, and the measurements of sensors that observe it.

It imports ``ship/``, ``draws/`` and ``scenario/``, and from ``ship_attitude_star`` the catalogue and the camera.
"""
