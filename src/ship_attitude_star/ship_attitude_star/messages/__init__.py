"""Inputs from the sensors; conversion of messages to the structs of the cores and of results to messages; no rclpy."""
