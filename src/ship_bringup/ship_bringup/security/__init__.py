"""DDS security of a suite: what each of its programs may do, the policies that say so, and the ship's keystore.

The room may import the adapters and ``ship_bags``; it imports no other room of this package and makes no ROS node.
"""
