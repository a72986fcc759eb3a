"""A node that runs: rclpy, callbacks, clocks, parameters, services, the log.

The room may import all others of the package; none of them imports it. Offline nothing of it is used.
"""
