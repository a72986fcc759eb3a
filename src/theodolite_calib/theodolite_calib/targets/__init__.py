"""Targets: direction from an image on the main detector and the pointing; position from a range or several directions.

The folder has no ROS, files or clock. ``direction`` and ``triangulation`` are pure functions; ``triangulation_core`` is
the core of the node ``triangulation``. The folder imports ``lights`` and ``measured``.
"""
