"""Topics served to Foxglove, by a websocket of this machine.

This room gets names, definitions and bytes, and gives them on as they are. It knows no ROS.
"""
