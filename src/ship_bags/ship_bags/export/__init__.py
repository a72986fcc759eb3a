"""Topics of a bag as tables for use without ROS: CSV, Parquet, NetCDF with the CF conventions.

The room handles message definitions, units and the three formats. It imports the room :mod:`~ship_bags.mcap` and the
flat modules of the package, and no rclpy.
"""
