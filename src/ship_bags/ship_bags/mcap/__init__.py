"""MCAP files and rosbag2 folders: reading with checks of all sizes, writing with flushes, recovery.

The folder handles bytes, records, message types and the ``metadata.yaml`` of a rosbag2 folder. It imports the common
modules of the package, but neither other folders nor rclpy.
"""
