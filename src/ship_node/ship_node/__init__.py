"""Node runtime of the suite: parameters, quality of service, exception handling, input health.

The folders are :mod:`~ship_node.pages`, :mod:`~ship_node.adapters`, :mod:`~ship_node.parameters`,
:mod:`~ship_node.black_box` and :mod:`~ship_node.live`; each may import the folders before it in this list. Only the
live folder and the writer of black boxes need rclpy. Adapters and the offline replay use the modules without rclpy.
"""
