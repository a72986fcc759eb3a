"""Inputs and outputs of an adapter: its topics, a batch of messages and ticks, and the messages of its outputs.

A live node processes batches of length one. A replay processes long batches, in which successive messages of one topic
that differ only in numbers are given as a block. Where batches end does not change an output, to the last bit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

from ship_bags.cdr_template import CdrRows
from ship_geometry.earth.time_scales import StampArray

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


class Arrival(NamedTuple):
    """Arrival of a message, or a tick.

    Attributes:
        receive_ns: time by the node's clock.
        waiting_ns: time by the timeout clock (:class:`ship_node.adapters.adapter.Adapter`).
        topic: relative topic of the message; empty for a tick.
        message: the message; None for a tick, and for a message of a block.
        block: key of the block that contains the message; None for no block.
    """

    receive_ns: int
    waiting_ns: int
    topic: str = ""
    message: Any = None
    block: int | None = None

    @property
    def is_empty(self) -> bool:
        """True for a tick, and for a message that cannot be decoded."""
        return self.message is None and self.block is None


class Block(NamedTuple):
    """Messages of one topic and one layout among the arrivals of a batch.

    Attributes:
        topic: relative topic of the messages.
        messages: N messages.
        receive_ns: receive time of each message, equal by both clocks, shape (N,).
        places: index of the arrival of each message, shape (N,).
    """

    topic: str
    messages: CdrRows
    receive_ns: StampArray
    places: StampArray


class Batch(NamedTuple):
    """Messages and ticks in order of their arrival.

    Attributes:
        arrivals: the arrivals.
        blocks: by key, the messages that the arrivals do not contain. An input topic from outside has at most one
            block, with all its messages; messages from another node may be in several blocks and alone, in any order.
    """

    arrivals: Sequence[Arrival]
    blocks: Mapping[int, Block] = MappingProxyType({})

    @classmethod
    def of_message(cls, topic: str, message: Any, receive_ns: int, waiting_ns: int | None = None) -> "Batch":
        """Return a batch of one message; ``waiting_ns`` is None if the timeout clock equals the node's clock."""
        return cls([Arrival(receive_ns, receive_ns if waiting_ns is None else waiting_ns, topic, message)])


class ReadBlock(NamedTuple):
    """Leading messages of a block that were read and passed all checks.

    Attributes:
        samples: input of the core, with the stamps ``times_ns``, shape (N,). The message after the last sample must be
            read alone.
        covariance_known: False if the messages give no covariance; the configured sigma is used then.
    """

    samples: Any
    covariance_known: bool = True


class OutputRows(NamedTuple):
    """Messages of one topic for some of N outputs.

    Attributes:
        topic: the topic.
        messages: messages in order of the outputs.
        places: index of the output of each message.
    """

    topic: str
    messages: CdrRows
    places: StampArray


class PlacedMessages(NamedTuple):
    """Messages that are published one after another.

    Attributes:
        place: index of the arrival at which they are published.
        order: number that sorts the outputs of one arrival.
        published: the messages.
    """

    place: int
    order: int
    published: list[OutputMessage]


class OutputBlock(NamedTuple):
    """Messages of one topic and one layout, with the place and order of each (:class:`PlacedMessages`)."""

    topic: str
    messages: CdrRows
    places: StampArray
    orders: StampArray


@dataclass
class BatchOutputs:
    """Outputs of a batch.

    Attributes:
        messages: messages that are published one by one.
        blocks: messages that were made together; their places ascend.
    """

    messages: list[PlacedMessages] = field(default_factory=list)
    blocks: list[OutputBlock] = field(default_factory=list)

    def output_messages(self) -> list[OutputMessage]:
        """Return the messages of a batch without blocks, in order of publication."""
        return [message for some in self.messages for message in some.published]
