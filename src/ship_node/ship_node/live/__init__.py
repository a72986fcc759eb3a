"""Live node: rclpy, callbacks, clocks, parameters, services, log.

The folder may import all others of the package; none of them imports it. The offline replay does not use it.
"""
