"""Adapters with the messages that they give, messages in, the saved alignment, nodes: where the cores meet ROS.

The room may import all others; only ``ship_replay`` and the executables import it. The method ``table`` of an adapter
says which topic feeds which method of the core.

A new kind of sensor is a struct in ``measurements/`` and a reader here that makes that struct of a message or refuses
the message. A row in the table of ``ship_attitude_adapter``, with a value of the parameter ``input``, binds the topic
to the reader and to ``ShipAttitudeCore.add_measurement``. What the filter compares it with stands in
``ship_attitude/comparison``; refusing, health, waiting and the messages of decisions are the same for all sensors.
"""
