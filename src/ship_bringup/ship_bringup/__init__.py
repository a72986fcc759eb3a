"""Bring up a suite with one command: launch, parameter and layout files, and the same without ``ros2 launch``."""
