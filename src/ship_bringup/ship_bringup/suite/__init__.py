"""A suite as processes: which programs a suite file asks for, and how they are kept running.

The room may import ``security/``, the checks of suite files (``ship_replay.preflight``) and the adapters; it starts
programs by name, and knows no ROS node.
"""
