"""Live node: rclpy, callbacks, clocks, parameters, services, log.

The room may import all others of the package; none of them imports it. Offline it is not used.
"""
