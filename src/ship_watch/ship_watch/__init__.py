"""State of a suite from its outputs: safety of each angle, sources that are OUT with their reasons, events, alerts.

The live page, the terminal view, the alerts and the report use it, so that they agree. Its input are decoded messages
with their arrival times. It uses no ROS, no clock and no file except the ship's limits.
"""
