"""Server of topics for Foxglove, by websocket.

Names, type definitions and message bytes are forwarded unchanged. No ROS is used.
"""
