"""Topics of a bag as tables for use without ROS: CSV, Parquet, NetCDF with the CF conventions.

The folder handles message definitions, units and the three formats, and imports the common modules of the package,
but not rclpy.
"""
