"""Messages that came and wait for the adapter: in order of arrival, so many of each topic and no more."""

from collections import Counter, OrderedDict, deque
from collections.abc import Mapping
from typing import NamedTuple

LARGEST_MESSAGE_BYTES = 65_536
"""An exposure of a thousand stars is smaller. To decode a larger message alone would hold up the node."""


class Arrival(NamedTuple):
    """A message as it came: topic, CDR bytes, node's time and time of waiting then, ns (0 before the first /clock)."""

    topic: str
    data: bytes
    now_ns: int
    waiting_ns: int


class Inbox:
    """A queue per topic, taken from in the order of arrival over all topics.

    Where a queue is full, its oldest message makes room for the newest: the data of a node that does not keep up are
    at most so old, and a flood on one topic displaces nothing of another.

    Args:
        depths: topic → messages that may wait.
    """

    def __init__(self, depths: Mapping[str, int]) -> None:
        self._depths = depths
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()
        self._numbers: dict[str, deque[int]] = {topic: deque() for topic in depths}
        self._next_number = 0
        self._cuts: Counter[tuple[str, str]] = Counter()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, arrival: Arrival) -> None:
        """Take in what just came, unless it is too large."""
        topic, size = arrival.topic, len(arrival.data)
        if size > LARGEST_MESSAGE_BYTES:
            self._cuts[topic, f"larger than {LARGEST_MESSAGE_BYTES} bytes"] += 1
            return
        numbers = self._numbers[topic]
        if len(numbers) == self._depths[topic]:
            del self._waiting[numbers.popleft()]
            self._cuts[topic, f"the oldest of more than {self._depths[topic]} that waited: the node is behind"] += 1
        numbers.append(self._next_number)
        self._waiting[self._next_number] = arrival
        self._next_number += 1

    def take(self) -> Arrival:
        """The message that waits longest, which then waits no more."""
        _, arrival = self._waiting.popitem(last=False)
        self._numbers[arrival.topic].popleft()
        return arrival

    def take_cuts(self) -> Counter[tuple[str, str]]:
        """(topic, why) → messages that were not kept since the last call."""
        cuts, self._cuts = self._cuts, Counter()
        return cuts
