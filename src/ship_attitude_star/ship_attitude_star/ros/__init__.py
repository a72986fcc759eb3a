"""Interface of the cores to ROS messages: adapters of the nodes, readers of messages, the alignment file.

No module here imports rclpy; only the node runtime (:mod:`ship_node.live`) does. The folder may import all other
folders of the package, and no other folder imports it. The method ``table`` of an adapter connects topics with methods
of the core.

Steps to add a new kind of sensor:

1. Define its struct in ``measurements/``.
2. Add a reader here that converts a message to the struct or rejects it. Connect topic, reader and
   ``ShipAttitudeCore.add_measurement`` by a row in the table of ``ship_attitude_adapter``.
3. Add its parameters to ``ship_attitude/config``, its error states and its device to ``ship_attitude/model``.
4. Add its prediction and residual to ``ship_attitude/comparison``.
5. Add to ``guards/stream_checks`` the value whose repetition shows that the sensor is stuck.
6. Add the states to save to ``ship_attitude/alignment``.

Late and repeated messages, pending measurements, revised decisions, input health and diagnostics are the same for all
sensors.
"""
