"""Bags: MCAP files and rosbag2 folders read, written, walked, recovered, recorded, played; ship logs in, tables out.

The flat modules are what every command, file and message needs: command lines, errors, files that are written, stamps,
names of topics, parameter files, messages made and decoded. The rooms are :mod:`~ship_bags.mcap`,
:mod:`~ship_bags.nmea`, :mod:`~ship_bags.export`, :mod:`~ship_bags.live` and :mod:`~ship_bags.commands`; each may import
the flat modules and the room of MCAP, the commands may import all, and the live room alone imports rclpy. Of this suite
only geometry is known here.
"""
