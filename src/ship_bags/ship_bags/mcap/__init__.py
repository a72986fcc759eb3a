"""MCAP files: records walked without trust, read, written flushed to the disk, and made whole after a crash.

The room knows bytes, records and message types. It does not import rclpy.
"""
