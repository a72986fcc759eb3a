"""Bags: MCAP files and rosbag2 folders read, written, walked, recovered, recorded and played; ship logs read into them.

The flat modules are what every command, file and message needs: command lines, errors, files that are written, stamps,
names of topics, parameter files, messages made and decoded. The rooms are :mod:`~ship_bags.mcap`,
:mod:`~ship_bags.nmea`, :mod:`~ship_bags.live` and :mod:`~ship_bags.commands`; each imports those before it, the live
room alone imports rclpy. Of this suite only geometry is known here.
"""
