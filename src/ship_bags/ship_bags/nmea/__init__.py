"""Logs of a ship in NMEA 0183, read into a bag.

The room knows lines of text and messages. It does not import rclpy.
"""
