"""A node that runs: rclpy, callbacks, clocks, parameters, services, the log.

The room may import all others of the package; none imports it.
"""
