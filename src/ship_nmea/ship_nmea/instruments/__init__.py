"""Sentences of instruments become topics.

The room knows links (sockets, serial lines), lines of text and what they become; the parser is that of
:mod:`ship_bags.nmea`. Only `nmea_in` knows rclpy. It imports no other room of the package but the nodes' shell.
"""
