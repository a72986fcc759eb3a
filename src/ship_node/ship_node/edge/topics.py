"""What a node listens to and what it publishes, by relative topic names."""

from dataclasses import dataclass
from typing import Any

Published = tuple[str, Any]
"""A message on its way out: (topic, message)."""


@dataclass(frozen=True)
class InputTopic:
    """A topic that a node listens to.

    Attributes:
        topic: relative name, as ``"ins/imu"``.
        type_name: as ``"sensor_msgs/msg/Imu"``.
        required: whether the node is of no use without it.
        depth: messages that may wait for the node: a second of data.
        named: whether the configuration names the device behind it, so that its silence from the start is a fault.
        at_times: whether it comes only when there is something to tell, so that its silence tells nothing.
        lasting: True where a message holds until the next one, as a position does: it is used however long it waited.
    """

    topic: str
    type_name: str
    required: bool
    depth: int
    named: bool = False
    at_times: bool = False
    lasting: bool = False


@dataclass(frozen=True)
class OutputTopic:
    """A topic that a node publishes; who comes later to a ``latched`` one still gets its last message."""

    topic: str
    type_name: str
    latched: bool = False
