"""Black boxes: what a node used and gave, in the order of use, written while it runs.

The format is known to the offline replay too and imports no ROS; the writer needs rclpy. Of the package the room knows
the parameter files, the edge and the documents.
"""
