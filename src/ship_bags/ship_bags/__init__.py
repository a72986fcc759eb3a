"""Read, write, recover, record and play MCAP files and rosbag2 folders; import ship logs; export tables.

The modules outside the folders are common to all folders: command lines, errors, output files, stamps, topic names,
parameter files, encoding and decoding of messages. The folders are :mod:`~ship_bags.mcap`, :mod:`~ship_bags.nmea`,
:mod:`~ship_bags.export`, :mod:`~ship_bags.live` and :mod:`~ship_bags.commands`. Each folder may import the common
modules and :mod:`~ship_bags.mcap`. The commands may import all folders. Only :mod:`~ship_bags.live` and the commands
that use it import rclpy. Of this suite the package imports only ship_geometry.
"""
