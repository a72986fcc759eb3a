"""MCAP files and rosbag2 folders of them: read with checks of all sizes, written with flushes, recovered.

The room handles bytes, records, message types and the information file of a folder. It imports the flat modules of the
package and no other room, and no rclpy.
"""
