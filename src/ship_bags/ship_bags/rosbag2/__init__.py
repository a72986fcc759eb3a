"""rosbag2 folders: several MCAP files with one information file, as ``ros2 bag record`` writes them.

The room builds on :mod:`ship_bags.mcap` and does not import rclpy.
"""
