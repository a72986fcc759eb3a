"""Start of a ROS process; and parts of record and play: installed types, recorded graph, playback clock.

Only this folder and the commands that use it import rclpy. The folder imports the common modules of the package and
:mod:`ship_bags.mcap`.
"""
