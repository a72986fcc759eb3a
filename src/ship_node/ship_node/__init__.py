"""The shell that every node wears: parameters, quality of service, guarded callbacks, health of the inputs.

Only :mod:`~ship_node.live.node_shell`, :mod:`~ship_node.live.live_node`, :mod:`~ship_node.live.qos` and
:mod:`~ship_node.live.ros_parameters` need rclpy; adapters and the offline replay use the rest.
"""
