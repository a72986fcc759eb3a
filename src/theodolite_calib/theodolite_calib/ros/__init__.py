"""Interface of the cores to ROS messages: adapters of the nodes, conversion in both directions, saved calibration.

The folder may import all others; only ``ship_replay``, ``axis_fit`` (which writes the saved calibration) and the
executable import it.

A new kind of sensor needs a struct in ``measured/`` and a reader here that converts a message to that struct or rejects
it. A :class:`~ship_node.edge.reporting_adapter.Feed` in ``OpticalAxisAdapter.table`` connects the topic with the reader
and with a method of the core. The comparison belongs to ``filter/``. Rejections, input health and the messages of
decisions are common to all.
"""
