"""The shell that every node wears: parameters, quality of service, guarded callbacks, health of the inputs.

The rooms are :mod:`~ship_node.documents`, :mod:`~ship_node.edge`, :mod:`~ship_node.parameters`,
:mod:`~ship_node.black_box` and :mod:`~ship_node.live`; each may import those before it. Only the live room and the
writer of black boxes need rclpy; adapters and the offline replay use the rest.
"""
