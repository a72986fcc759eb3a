"""The target: its direction by an image on the main detector and the pointing, its place by a range or by several.

The room knows no ROS, no files and no clock. ``direction`` and ``triangulation`` are pure functions; it may import
``lights`` and ``measured``.
"""
