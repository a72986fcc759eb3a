"""Active publishers of an input topic, by the sequence numbers that the middleware gives their messages.

Each publisher numbers its messages from 1. The numbers of one publisher increase; those of two alternate. The ROS graph
is not sufficient: a publisher may never send, and a killed one stays in the graph until its lease ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

UNNUMBERED = 2**64 - 1
"""Number of every message if the middleware counts none, as CycloneDDS: publishers are then unknown."""

MIN_TIMEOUT_NS = 1_000_000_000
"""Minimum timeout of a publisher, ns."""

_TIMEOUT_PERIODS = 3
"""Timeout of a publisher in units of its longest interval between two messages."""

_REMOVAL_TIMEOUT_NS = 10_000_000_000
"""Time without a message after which a publisher is removed, ns."""

_MIN_RETURNS = 2
"""Number of returns to a publisher after messages of another one that shows two publishers.

A restart gives none, a lost message may give one."""


@dataclass
class _Sender:
    """Publisher, by its messages.

    Attributes:
        number: sequence number of its last message.
        last_ns: receive time of that message.
        longest_ns: longest interval between two of its messages.
    """

    number: int
    last_ns: int
    longest_ns: int = 0

    def is_timed_out(self, now_ns: int) -> bool:
        """Return True if the publisher has timed out."""
        return now_ns - self.last_ns > max(MIN_TIMEOUT_NS, _TIMEOUT_PERIODS * self.longest_ns)


class Senders:
    """Counts the active publishers of one topic.

    >>> senders = Senders()
    >>> [senders.add_message(number, n * 10_000_000) for n, number in enumerate((700, 701, 1, 702, 2, 703))]
    [False, False, False, False, True, True]
    """

    def __init__(self) -> None:
        self._senders: list[_Sender] = []
        self._latest: _Sender | None = None
        self._returns = 0

    def add_message(self, number: int, now_ns: int) -> bool:
        """Add a message by its sequence number and steady time, ns; return True if two publishers send."""
        if number == UNNUMBERED:
            return False
        latest = self._latest
        if len(self._senders) == 1 and latest is not None and number > latest.number:
            # This is the case for nearly every message.
            latest.longest_ns = max(latest.longest_ns, now_ns - latest.last_ns)
            latest.number, latest.last_ns = number, now_ns
            return False
        self._senders = [sender for sender in self._senders if now_ns - sender.last_ns <= _REMOVAL_TIMEOUT_NS]
        earlier = [sender for sender in self._senders if sender.number < number]
        # Of two publishers with the same number the latest one continues.
        found = max(earlier, key=lambda sender: (sender.number, sender is latest), default=None)
        if found is None:
            found = _Sender(number, now_ns)
            self._senders.append(found)
            self._returns = 0
        else:
            self._returns += found is not latest
            found.longest_ns = max(found.longest_ns, now_ns - found.last_ns)
            found.number, found.last_ns = number, now_ns
        self._latest = found
        return self.has_two(now_ns)

    def has_two(self, now_ns: int) -> bool:
        """Return True if two publishers send: each has continued after the other, and neither has timed out."""
        return self._returns >= _MIN_RETURNS and sum(not sender.is_timed_out(now_ns) for sender in self._senders) >= 2

    def keep_latest(self) -> None:
        """Keep only the latest publisher: the middleware lists no other one."""
        self._senders, self._returns = [self._latest] if self._latest is not None else [], 0


def publisher_names(publishers: Sequence[Any]) -> list[str]:
    """Return the full names of the nodes of publishers, from rclpy's endpoint information, in alphabetical order."""
    names = (f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in publishers)
    return sorted("a node without a name" if "_UNKNOWN_" in name else name for name in names)


def duplicate_publishers_text(topic: str, names: Sequence[str]) -> str:
    """Return the text for the user about two publishers of a topic, with the names of their nodes."""
    publishers = " and ".join(names) if len(names) > 1 else "the middleware does not name both"
    return f"two publishers send on {topic}: {publishers}; stop all but one"
