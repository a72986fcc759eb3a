"""The publishers of an input topic that send, by the numbers that the middleware gives their messages.

Each publisher numbers its messages from one on. The numbers of one publisher increase; those of two run alternately.
The graph alone does not tell: a publisher may never send, and one that was killed stands in it until its lease ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

UNNUMBERED = 2**64 - 1
"""Number of every message where the middleware counts none, as CycloneDDS: then nothing is known of its publishers."""

LEAST_SILENCE_NS = 1_000_000_000
"""A publisher counts as silent after this time at least, ns."""

_SILENT_PERIODS = 3
"""And after this number of its longest intervals between two messages."""

_FORGOTTEN_NS = 10_000_000_000
"""A publisher that has sent nothing for this time is forgotten, ns."""

_RETURNS = 2
"""Number of returns to a publisher after messages of another one: a restart makes none, a lost message may make one."""


@dataclass
class _Sender:
    """A publisher by its messages.

    Attributes:
        number: of its last message.
        last_ns: when that came.
        longest_ns: longest interval between two of its messages.
    """

    number: int
    last_ns: int
    longest_ns: int = 0

    def is_silent(self, now_ns: int) -> bool:
        """True if it has sent nothing for longer than a publisher that goes on does."""
        return now_ns - self.last_ns > max(LEAST_SILENCE_NS, _SILENT_PERIODS * self.longest_ns)


class Senders:
    """Counts the publishers of one topic that send.

    >>> senders = Senders()
    >>> [senders.came(number, n * 10_000_000) for n, number in enumerate((700, 701, 1, 702, 2, 703))]
    [False, False, False, False, True, True]
    """

    def __init__(self) -> None:
        self._senders: list[_Sender] = []
        self._latest: _Sender | None = None
        self._returns = 0

    def came(self, number: int, now_ns: int) -> bool:
        """A message came, by its number and a steady clock, ns; returns whether two publishers send."""
        if number == UNNUMBERED:
            return False
        latest = self._latest
        if len(self._senders) == 1 and latest is not None and number > latest.number:
            # So is nearly every message.
            latest.longest_ns = max(latest.longest_ns, now_ns - latest.last_ns)
            latest.number, latest.last_ns = number, now_ns
            return False
        self._senders = [sender for sender in self._senders if now_ns - sender.last_ns <= _FORGOTTEN_NS]
        earlier = [sender for sender in self._senders if sender.number < number]
        # Of two with one number the latest one goes on.
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
        return self.are_two(now_ns)

    def are_two(self, now_ns: int) -> bool:
        """True if two publishers send: each has gone on after the other, and neither is silent since."""
        return self._returns >= _RETURNS and sum(not sender.is_silent(now_ns) for sender in self._senders) >= 2

    def end(self) -> None:
        """The middleware knows one publisher only: no other one sends any more."""
        self._senders, self._returns = [self._latest] if self._latest is not None else [], 0


def publisher_names(publishers: Sequence[Any]) -> list[str]:
    """Full names of the nodes of publishers, by rclpy's information on the endpoints, in alphabetical order."""
    names = (f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in publishers)
    return sorted("a node without a name" if "_UNKNOWN_" in name else name for name in names)


def contested_text(topic: str, names: Sequence[str]) -> str:
    """For people: two publishers send on a topic, and which nodes these are."""
    told = " and ".join(names) if len(names) > 1 else "the middleware does not name both"
    return f"two publishers send on {topic}: {told}; end all but one"
