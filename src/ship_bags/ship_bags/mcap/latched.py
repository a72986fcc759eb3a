"""The last messages of latched topics, which every file of a split recording repeats: each can be used by itself.

A file notes what it repeats in a metadata record, so that a reader of the whole folder leaves the copies out.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

REPEATED_METADATA = "repeated"
"""Metadata record of a file: topic → log time of the copies, ns."""

_MOST_MESSAGES = 16
"""Of one topic: several nodes may have said something on it, as on /tf_static, each once."""
_MOST_BYTES = 16 * 2**20


class LatchedMessage(NamedTuple):
    """A message as it was written."""

    topic: str
    type_name: str
    data: bytes
    publish_time_ns: int


class LatchedMessages:
    """The newest messages of each latched topic, no two alike."""

    def __init__(self) -> None:
        self._kept: dict[str, deque[LatchedMessage]] = {}

    def __contains__(self, topic: str) -> bool:
        """True if a topic is latched."""
        return topic in self._kept

    def __iter__(self) -> Iterator[LatchedMessage]:
        """All that is kept, topic by topic, oldest first."""
        return (message for kept in self._kept.values() for message in kept)

    def add_topic(self, topic: str) -> None:
        """Announce a latched topic."""
        self._kept.setdefault(topic, deque(maxlen=_MOST_MESSAGES))

    def add(self, message: LatchedMessage) -> None:
        """Keep a message of a latched topic."""
        kept = self._kept[message.topic]
        for other in [other for other in kept if other.data == message.data]:
            kept.remove(other)
        kept.append(message)
        while len(kept) > 1 and sum(len(other.data) for other in kept) > _MOST_BYTES:
            kept.popleft()


def repeated_times(metadata: Mapping[str, Mapping[str, str]]) -> set[tuple[str, int]]:
    """Topic and log time of the copies in a file, by its metadata; nothing of a record that is damaged."""
    entries = metadata.get(REPEATED_METADATA, {})
    return {(topic, int(time)) for topic, time in entries.items() if time.isascii() and time.isdecimal()}
