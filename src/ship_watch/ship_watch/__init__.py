"""State of a suite from its outputs: safety of each angle, sources that are OUT with their reasons, events, alerts.

The live page, the terminal view, the alerts and the report all use this package and therefore agree. The input is
decoded messages with their arrival times. The package does not use ROS. It reads no file except the ship's limits, and
it uses a clock only to limit log lines.
"""
