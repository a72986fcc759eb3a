"""Interface of the cores to ROS messages: adapters of the nodes, readers of messages, the alignment file.

Nothing here imports rclpy; the node runtime (:mod:`ship_node.live`) does. The folder may import all others of the
package, and none of them imports it. The method ``table`` of an adapter connects topics with methods of the core.

Steps to add a new kind of sensor:

1. its struct in ``measurements/``;
2. a reader here that converts a message to the struct or rejects it, and a row in the table of
   ``ship_attitude_adapter`` that connects topic, reader and ``ShipAttitudeCore.add_measurement``;
3. its parameters in ``ship_attitude/config``, its error states and its device in ``ship_attitude/model``;
4. its prediction and residual in ``ship_attitude/comparison``;
5. in ``guards/stream_checks`` the value whose repetition shows that the sensor is stuck;
6. in ``ship_attitude/alignment`` the states to save.

Late and repeated messages, pending measurements, revised decisions, input health and diagnostics are the same for all
sensors.
"""
