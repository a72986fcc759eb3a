"""Topics of a running suite, read at the pace of who looks at them.

This is the only room of the package that subscribes to topics. It imports rclpy and what ship_bags has for live nodes,
and no other room.
"""
