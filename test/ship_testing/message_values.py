"""What a message of rclpy is and holds, for comparing."""

from typing import Any

from rclpy.serialization import serialize_message

from ship_bags.message_store import message_store, serialize


def type_name_of(message: Any) -> str:
    """The name of its type, as ``sensor_msgs/msg/Imu``."""
    kind = type(message)
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def value_bytes(message: Any) -> bytes:
    """All its values to the last bit. rclpy alone would leave between them whatever was in its memory."""
    return serialize(message_store().deserialize_cdr(serialize_message(message), type_name_of(message)))
