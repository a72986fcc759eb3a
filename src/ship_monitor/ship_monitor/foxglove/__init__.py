"""Server of topics for Foxglove, by websocket.

It forwards names, definitions and bytes unchanged, and uses no ROS.
"""
