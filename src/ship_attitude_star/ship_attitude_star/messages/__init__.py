"""Conversion of messages to the structs of the cores and of results to messages, without rclpy."""
