"""Where messages meet a node: checks of fields, health of inputs, messages of every node, the reporting adapter.

The room may import ``documents/``. Nothing here imports rclpy, so that the replay uses all of it.
"""
