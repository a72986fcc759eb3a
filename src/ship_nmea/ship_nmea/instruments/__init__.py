"""Convert instruments' sentences to topics.

The folder contains links (sockets, serial lines), lines of text and the messages made from them; the parser is in
:mod:`ship_bags.nmea`. Only `nmea_in` depends on rclpy. The folder imports no other folder of the package.
"""
