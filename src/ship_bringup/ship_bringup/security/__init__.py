"""DDS security of a suite: permissions of each of its programs, the policies that state them, and the ship's keystore.

The room may import the adapters and ``ship_bags``; it imports no other room of this package and creates no ROS node.
"""
