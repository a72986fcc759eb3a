"""Live node: rclpy, callbacks, clocks, parameters, services, log.

The folder may import all other folders of the package; no other folder imports it. The offline replay does not use it.
"""
