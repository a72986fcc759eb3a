"""Logs of a ship in NMEA 0183, read into a bag.

The room knows lines of text and messages. It imports the flat modules and :mod:`ship_bags.mcap`; rclpy is unknown here.
"""
