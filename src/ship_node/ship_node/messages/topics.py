"""Input and output topics of a node, by relative names."""

from dataclasses import dataclass
from typing import Any

OutputMessage = tuple[str, Any]
"""Message to publish: (topic, message)."""


@dataclass(frozen=True)
class InputTopic:
    """Topic that a node subscribes to.

    Attributes:
        topic: relative name, as ``"ins/imu"``.
        type_name: type of the messages, as ``"sensor_msgs/msg/Imu"``.
        required: True if the node cannot work without the topic.
        depth: queue depth, number of messages.
        is_configured: True if the configuration names the device; then it is a fault if no message ever arrives.
        is_occasional: True if messages come only occasionally, so that there is no timeout.
        is_valid_until_next: True if a message, for example a position, is valid until the next message arrives, and is
            used even after a long wait.
    """

    topic: str
    type_name: str
    required: bool
    depth: int
    is_configured: bool = False
    is_occasional: bool = False
    is_valid_until_next: bool = False


@dataclass(frozen=True)
class OutputTopic:
    """Topic that a node publishes; late subscribers of a ``latched`` topic get its last message."""

    topic: str
    type_name: str
    latched: bool = False
