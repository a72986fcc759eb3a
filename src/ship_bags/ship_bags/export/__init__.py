"""Topics of a bag as tables for people who do not use ROS: CSV, Parquet, NetCDF after the CF conventions.

The room knows message definitions, units and the three formats. It imports the room :mod:`~ship_bags.mcap` and the flat
modules of the package; rclpy is unknown here.
"""
