"""Rauch-Tung-Striebel smoothing of the ship attitude with later measurements.

The folder uses no ROS and no files.
"""
