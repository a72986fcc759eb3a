"""MCAP files and rosbag2 folders of them: walked without trust, read, written flushed to the disk, made whole again.

The room knows bytes, records, message types and the information file of a folder. It imports the flat modules of the
package and no other room; rclpy is unknown here.
"""
