"""Which exposures of different sensors make one joint solution, and when it is time to make it."""

from collections.abc import Callable, Collection, Iterator
from typing import Generic, Protocol, TypeVar

from ship_attitude_star.star_attitude.config import JointConfig

_SECOND_NS = 1_000_000_000


class Timed(Protocol):
    """Something that a sensor gave for a moment."""

    @property
    def source(self) -> str:
        """The sensor."""
        ...

    @property
    def time_ns(self) -> int:
        """The moment."""
        ...


Item = TypeVar("Item", bound=Timed)


class JointWindow(Generic[Item]):
    """Makes groups of items. An item belongs to one group at most, and a group holds one item of a sensor at most.

    Args:
        sources: all sensors.
        config: how far apart in time the items of a group may be, and how long a group waits for more of them.
    """

    def __init__(self, sources: Collection[str], config: JointConfig) -> None:
        self._sources = frozenset(sources)
        self._window_ns = round(config.window_s * _SECOND_NS)
        self._simultaneous_ns = round(config.simultaneous_s * _SECOND_NS)
        self._wait_ns = round(config.wait_s * _SECOND_NS)
        self._items: list[Item] = []
        self._arrivals_ns: dict[tuple[int, str], int] = {}
        self._last_ns: int | None = None

    def add(self, item: Item, arrival_ns: int | None = None) -> bool:
        """Take an item, in the place of one of the same sensor and stamp. False where the group of its time is closed.

        Args:
            item: what a sensor gave.
            arrival_ns: when it came, in the time of waiting; None where each comes at its moment.
        """
        if self._last_ns is not None and item.time_ns <= self._last_ns:
            return False
        key = item.time_ns, item.source
        self._items = [other for other in self._items if (other.time_ns, other.source) != key]
        self._items.append(item)
        self._items.sort(key=lambda other: (other.time_ns, other.source))
        self._arrivals_ns[key] = item.time_ns if arrival_ns is None else arrival_ns
        return True

    def closed(self, movable: Callable[[int, int], bool], waiting_ns: int | None) -> Iterator[list[Item]]:
        """The groups that are complete, or have waited long enough, in order of time.

        Args:
            movable: whether an exposure can be moved to a moment from another one (both ns).
            waiting_ns: the time of waiting now; None where it is not known.
        """
        while self._items:
            group = self._group(movable)
            first_ns = group[0].time_ns
            # A sensor whose item is there, even if it is too late for this group, gives nothing more for this group.
            awaited = self._sources - {item.source for item in self._items}
            since_ns = self._arrivals_ns[first_ns, group[0].source]
            if awaited and (waiting_ns is None or waiting_ns - since_ns < self._wait_ns):
                return
            taken = {id(item) for item in group}
            self._items = [item for item in self._items if id(item) not in taken]
            for item in group:
                del self._arrivals_ns[item.time_ns, item.source]
            self._last_ns = first_ns
            yield group

    def _group(self, movable: Callable[[int, int], bool]) -> list[Item]:
        """The earliest item, and of each other sensor the next one that is near enough in time."""
        first_ns = self._items[0].time_ns
        group: dict[str, Item] = {}
        for item in self._items:
            later_ns = item.time_ns - first_ns
            if later_ns > self._window_ns and later_ns > self._simultaneous_ns:
                break
            if item.source not in group and (later_ns <= self._simultaneous_ns or movable(first_ns, item.time_ns)):
                group[item.source] = item
        return list(group.values())
