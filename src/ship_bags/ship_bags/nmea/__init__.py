"""Sentences of NMEA 0183 become messages; logs of a ship are read into a bag.

The room knows lines of text and messages; of a live instrument and of a log the same lines become the same messages. It
imports the flat modules and :mod:`ship_bags.mcap`; rclpy is unknown here.
"""
