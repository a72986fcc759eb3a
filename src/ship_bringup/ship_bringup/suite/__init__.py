"""A suite as processes: the programs of a suite file, and their supervision.

The folder may import ``security/``, the checks of suite files (``ship_replay.preflight``) and the adapters; it starts
programs by name, and creates no ROS node.
"""
