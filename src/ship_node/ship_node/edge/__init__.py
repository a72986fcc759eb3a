"""Interface of the cores to ROS messages: field checks, input health, messages of every node, and the common adapters.

The folder may import ``documents/``. No module of the folder imports rclpy, so the offline replay can use all of them.
"""
