"""Conversion of messages and the common adapters: field checks, input health, messages of every node.

The room may import ``documents/``. Nothing here imports rclpy, so that the offline replay can use all of it.
"""
