"""Last messages of latched topics, repeated in every file of a split recording, so that each file is usable alone.

A file lists its repeated messages in a metadata record, so that a reader of the whole folder leaves the copies out.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

REPEATED_METADATA = "repeated"
"""Name of a file's metadata record with topic → log time of the copies, ns."""

_MAX_MESSAGES = 16
"""Maximum number of messages per topic; several nodes may have published a message each, as on /tf_static."""
_MAX_BYTES = 16 * 2**20


class LatchedMessage(NamedTuple):
    """Message as written."""

    topic: str
    type_name: str
    data: bytes
    publish_time_ns: int


class LatchedMessages:
    """Newest messages of each latched topic, without duplicates."""

    def __init__(self) -> None:
        self._messages: dict[str, deque[LatchedMessage]] = {}

    def __contains__(self, topic: str) -> bool:
        """True if a topic is latched."""
        return topic in self._messages

    def __iter__(self) -> Iterator[LatchedMessage]:
        """Iterate over all messages, topic by topic, oldest first."""
        return (message for kept in self._messages.values() for message in kept)

    def add_topic(self, topic: str) -> None:
        """Add a latched topic."""
        self._messages.setdefault(topic, deque(maxlen=_MAX_MESSAGES))

    def add(self, message: LatchedMessage) -> None:
        """Add a message of a latched topic."""
        kept = self._messages[message.topic]
        for other in [other for other in kept if other.data == message.data]:
            kept.remove(other)
        kept.append(message)
        while len(kept) > 1 and sum(len(other.data) for other in kept) > _MAX_BYTES:
            kept.popleft()


def repeated_message_times(metadata: Mapping[str, Mapping[str, str]]) -> set[tuple[str, int]]:
    """Return topic and log time of the copies in a file, by its metadata; a damaged entry is left out."""
    entries = metadata.get(REPEATED_METADATA, {})
    return {(topic, int(time)) for topic, time in entries.items() if time.isascii() and time.isdecimal()}
