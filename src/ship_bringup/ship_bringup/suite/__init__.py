"""A suite as processes: the programs of a suite file, and their supervision.

Of this package, the folder imports only ``security/``. It starts programs by name, and creates no ROS node.
"""
