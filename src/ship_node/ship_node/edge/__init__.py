"""Interface of the cores to ROS messages: field checks, input health, messages of every node, and the common adapters.

The folder may import ``documents/``. Nothing here imports rclpy, so that the offline replay can use all of it.
"""
