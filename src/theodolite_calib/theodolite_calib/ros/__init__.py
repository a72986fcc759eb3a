"""Adapter with the messages that it gives, messages in, the saved calibration, node: where the core meets ROS.

The room may import all others; only ``ship_replay``, ``axis_fit`` (which writes the saved calibration) and the
executable import it.

A new kind of sensor is a struct in ``measured/`` and a reader here that makes that struct of a message or refuses the
message. A row in the table of ``optical_axis_adapter`` binds the topic to the reader and to a method of the core. What
the filter compares it with stands in ``filter/``; refusing, health and the messages of decisions are the same for all.
"""
