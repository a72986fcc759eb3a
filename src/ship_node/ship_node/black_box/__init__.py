"""Black boxes: all inputs and outputs of a node in order of use, written while it runs.

The offline replay uses the format too, which imports no ROS; the writer needs rclpy. Of the package the room uses the
parameter files, the messages and the documents.
"""
