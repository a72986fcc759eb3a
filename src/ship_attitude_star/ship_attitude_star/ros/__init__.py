"""Adapters with the messages that they give, messages in, the saved alignment, nodes: where the cores meet ROS.

The room may import all others; only ``ship_replay`` and the executables import it. The method ``table`` of an adapter
says which topic feeds which method of the core.

A new kind of sensor is touched in this order: its struct in ``measurements/``; here a reader that makes the struct of
a message or refuses the message, and a row in the table of ``ship_attitude_adapter`` that binds topic, reader and
``ShipAttitudeCore.add_measurement``; its parameters in ``ship_attitude/config``; its errors as states and its device in
``ship_attitude/model``; what the filter compares it with in ``ship_attitude/comparison``; in ``guards/stream_guards``
what of it must not stand still; in ``ship_attitude/alignment`` what of it is saved. Lateness, doubles, waiting, revised
decisions, health and the messages that tell of them are the same for all sensors.
"""
