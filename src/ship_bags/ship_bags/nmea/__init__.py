"""NMEA 0183 sentences as messages; import of ship logs into a bag.

The room handles lines of text and messages; the lines of a live instrument and of a log become the same messages. It
imports the flat modules and :mod:`ship_bags.mcap`, and no rclpy.
"""
