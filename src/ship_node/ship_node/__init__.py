"""Node runtime of the suite: parameters, quality of service, exception handling, input health.

The folders are, from top to bottom, :mod:`~ship_node.live`, :mod:`~ship_node.black_box`,
:mod:`~ship_node.parameters`, :mod:`~ship_node.adapters`, :mod:`~ship_node.health`, :mod:`~ship_node.messages`, and
:mod:`~ship_node.saved_files` and :mod:`~ship_node.pages`; each may import the folders after it. Only the
live folder and the writer of black boxes need rclpy. Adapters and the offline replay use the modules without rclpy.
"""
