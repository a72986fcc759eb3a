"""Bags: MCAP files and rosbag2 folders read, written, recovered, recorded, played; ship logs and tables.

The flat modules are needed by every command, file and message: command lines, errors, output files, stamps, topic
names, parameter files, messages made and decoded. The rooms are :mod:`~ship_bags.mcap`, :mod:`~ship_bags.nmea`,
:mod:`~ship_bags.export`, :mod:`~ship_bags.live` and :mod:`~ship_bags.commands`. Each may import the flat modules and
the MCAP room; the commands may import all; only the live room imports rclpy. Of this suite the package imports only
ship_geometry.
"""
