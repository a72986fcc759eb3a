"""Where messages meet a node: topics, checks of fields, health of inputs, diagnostics, reports.

Nothing here imports rclpy, so that the replay uses all of it.
"""
