"""Type and values of a message of rclpy, for comparisons."""

from typing import Any

from rclpy.serialization import serialize_message

from ship_bags.message_store import message_store, serialize


def type_name_of(message: Any) -> str:
    """Return the name of a message's type, as ``sensor_msgs/msg/Imu``."""
    kind = type(message)
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def value_bytes(message: Any) -> bytes:
    """Return all values of a message, bit-exact, without rclpy's padding bytes, which are undefined."""
    return serialize(message_store().deserialize_cdr(serialize_message(message), type_name_of(message)))
