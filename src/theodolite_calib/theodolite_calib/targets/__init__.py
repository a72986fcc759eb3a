"""Targets: direction from an image on the main detector and the pointing, and position from a range.

The folder has no ROS, files or clock. ``direction`` has pure functions; ``pending_targets`` keeps images until their
pointing is known. The folder imports ``samples``.
"""
