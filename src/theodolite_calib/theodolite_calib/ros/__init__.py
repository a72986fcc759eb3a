"""Interface of the cores to ROS messages: adapters of the nodes, conversion in both directions, saved calibration.

Nothing here imports rclpy; the node runtime (:mod:`ship_node.live`) does. Of the package, ``axis_fit`` (which writes
the saved calibration) and ``triangulation`` (which reads directions) import this folder.

A new kind of sensor needs a struct in ``measured/`` and a reader here that converts a message to that struct or rejects
it. A :class:`~ship_node.edge.reporting_adapter.Feed` in ``OpticalAxisAdapter.table`` connects the topic with the reader
and with a method of the core. The comparison belongs to ``filter/``. Rejections, input health and the messages of
decisions are common to all.
"""
