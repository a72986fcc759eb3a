"""The target: its direction by an image on the main detector and the pointing, its place by a range or by several.

The room knows no ROS, no files and no clock. ``direction`` and ``triangulation`` are pure functions; ``placing`` is the
core of the node ``triangulation``. It may import ``lights`` and ``measured``.
"""
