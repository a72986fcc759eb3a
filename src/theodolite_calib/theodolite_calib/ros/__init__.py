"""Interface of the cores to ROS messages: adapters of the nodes, conversion in both directions, saved calibration.

The folder may import the folders that :mod:`theodolite_calib` names below it. Only ``ship_replay``, the
commands ``fit_axes`` and ``triangulate``, and the executables of the nodes import this folder.

A new kind of sensor needs a struct in ``measured/`` and a reader here that converts a message to that struct or rejects
the message. A :class:`~ship_node.edge.reporting_adapter.Feed` in ``OpticalAxisAdapter.table`` connects the topic with
the reader and with a method of the core. ``filter/`` compares the measurement with the prediction. Rejections, input
health and the messages of decisions have one implementation for all kinds.
"""
