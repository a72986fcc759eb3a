"""Black boxes: all inputs and outputs of a node in order of use, written while the node runs.

The format is defined without ROS, because the offline replay uses it too; the writer needs rclpy. Of the package the
folder imports ``parameters/``, ``adapters/``, ``health/``, ``messages/`` and ``saved_files/``.
"""
