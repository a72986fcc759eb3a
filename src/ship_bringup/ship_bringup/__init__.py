"""Bring up a suite with one command, by launch files or without ``ros2 launch``."""
