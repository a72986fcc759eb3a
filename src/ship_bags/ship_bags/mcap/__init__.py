"""MCAP files and rosbag2 folders of them: read with checks of all sizes, written with flushes, recovered.

Contains the handling of bytes, records, message types and the ``metadata.yaml`` of a rosbag2 folder. It imports the
common modules of the package and no other folder, and no rclpy.
"""
