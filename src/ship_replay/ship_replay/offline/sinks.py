"""Sinks of a replay's messages."""

from abc import ABC, abstractmethod
from collections.abc import Container, Sequence
from typing import Any, Protocol

from ship_bags.message_store import message_store
from ship_node.messages.batch import StampArray


class MessageSink(Protocol):
    """Receiver of a replay's messages, for example a bag writer."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :meth:`ship_bags.mcap.bag_writer.BagWriter.write_many`."""
        ...


class NullSink:
    """Sink that discards all messages."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """Discard messages."""


class DecodingSink(ABC):
    """Sink that receives decoded messages.

    Attributes:
        topics: topics of the messages to decode; other messages are ignored.
    """

    topics: Container[str]

    @abstractmethod
    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Receive a message."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :class:`MessageSink`."""
        read = message_store().deserialize_cdr
        for number, content, time_ns in zip(of_topic.tolist(), data, log_times_ns.tolist(), strict=True):
            topic, type_name = topics[number]
            if topic in self.topics:
                self.write(topic, read(content, type_name), time_ns)
