"""Convert instruments' sentences to topics.

The folder contains links (sockets, serial lines), lines of text and the messages made from them; the parser is that of
:mod:`ship_bags.nmea`. Only `nmea_in` imports rclpy. Of the package, the folder imports only the node runtime.
"""
