"""Detection of the active publishers of an input topic by the sequence numbers of their messages.

The middleware numbers the messages of each publisher from 1. The numbers of one publisher increase; the numbers of two
publishers alternate. The ROS graph is not sufficient: a publisher may never send, and a killed publisher stays in the
graph until its lease ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

UNNUMBERED = 2**64 - 1
"""Number of every message if the middleware does not count messages (CycloneDDS); publishers are then unknown."""

MIN_TIMEOUT_NS = 1_000_000_000
"""Minimum timeout of a publisher, ns."""

_TIMEOUT_PERIODS = 3
"""Timeout of a publisher in units of its longest interval between two messages."""

_REMOVAL_TIMEOUT_NS = 10_000_000_000
"""Time without a message after which a publisher is removed, ns."""

_MIN_RETURNS = 2
"""Minimum number of returns that shows two publishers.

A return is a message of a known publisher after a message of another publisher. A restart of a publisher causes no
return. A message lost after a restart may cause one, when the new numbers pass the last number before the restart.
"""


@dataclass
class _Publisher:
    """Publisher, by its messages.

    Attributes:
        number: sequence number of its last message.
        last_ns: receive time of its last message by the steady clock.
        longest_ns: longest interval between two of its messages.
    """

    number: int
    last_ns: int
    longest_ns: int = 0

    def is_timed_out(self, now_ns: int) -> bool:
        """Return True if the publisher has timed out."""
        return now_ns - self.last_ns > max(MIN_TIMEOUT_NS, _TIMEOUT_PERIODS * self.longest_ns)


class ActivePublishers:
    """Active publishers of one topic.

    >>> publishers = ActivePublishers()
    >>> [publishers.add_message(number, n * 10_000_000) for n, number in enumerate((700, 701, 1, 702, 2, 703))]
    [False, False, False, False, True, True]
    """

    def __init__(self) -> None:
        self._publishers: list[_Publisher] = []
        self._latest: _Publisher | None = None
        self._returns = 0

    def add_message(self, number: int, now_ns: int) -> bool:
        """Add a message by its sequence number and steady time, ns; return True if two publishers send."""
        if number == UNNUMBERED:
            return False
        latest = self._latest
        if len(self._publishers) == 1 and latest is not None and number > latest.number:
            # This is the case for nearly every message.
            latest.longest_ns = max(latest.longest_ns, now_ns - latest.last_ns)
            latest.number, latest.last_ns = number, now_ns
            return False
        self._publishers = [each for each in self._publishers if now_ns - each.last_ns <= _REMOVAL_TIMEOUT_NS]
        earlier = [each for each in self._publishers if each.number < number]
        # If two publishers have the same number, the message counts for the latest publisher.
        found = max(earlier, key=lambda each: (each.number, each is latest), default=None)
        if found is None:
            found = _Publisher(number, now_ns)
            self._publishers.append(found)
            self._returns = 0
        else:
            self._returns += found is not latest
            found.longest_ns = max(found.longest_ns, now_ns - found.last_ns)
            found.number, found.last_ns = number, now_ns
        self._latest = found
        return self.has_two(now_ns)

    def has_two(self, now_ns: int) -> bool:
        """Return True if two publishers send: each has continued after the other, and neither has timed out."""
        return self._returns >= _MIN_RETURNS and sum(not each.is_timed_out(now_ns) for each in self._publishers) >= 2

    def keep_latest(self) -> None:
        """Keep only the latest publisher, because the middleware lists no other publisher."""
        self._publishers, self._returns = [self._latest] if self._latest is not None else [], 0


def publisher_names(publishers: Sequence[Any]) -> list[str]:
    """Return the full names of the nodes of publishers, from rclpy's endpoint information, in alphabetical order."""
    names = (f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in publishers)
    return sorted("a node without a name" if "_UNKNOWN_" in name else name for name in names)


def duplicate_publishers_text(topic: str, names: Sequence[str]) -> str:
    """Return the text for the user about two publishers of a topic, with the names of their nodes if both are known."""
    publishers = " and ".join(names) if len(names) > 1 else "the middleware does not name both nodes"
    return f"two publishers send on {topic}: {publishers}; stop all but one"
