"""Adapters of the nodes, message conversion in both directions, saved calibration: interface of the cores to ROS.

The folder may import all others; only ``ship_replay``, ``axis_fit`` (which writes the saved calibration) and the
executable import it.

A new kind of sensor is a struct in ``measured/`` and a reader here that converts a message to that struct or rejects
it. A row in the table of ``optical_axis_adapter`` binds the topic to the reader and to a method of the core. The
comparison belongs to ``filter/``; rejection, health and the messages of decisions are common to all.
"""
