"""Black boxes: all inputs and outputs of a node in order of use, written while it runs.

The format imports no ROS, because the offline replay uses it too; the writer needs rclpy. Of the package the folder
imports ``parameters/``, ``edge/`` and ``documents/``.
"""
