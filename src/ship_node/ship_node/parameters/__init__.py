"""Parameters of a node: ROS 2 parameter files read with line numbers, checked, written, and listed for ``--help``."""
