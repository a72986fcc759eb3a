"""A progress bar for work that takes over two seconds, on a terminal only."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from ship_bags.mcap.bag_reader import Bag, BagRecord

Item = TypeVar("Item")

_PATIENCE_S = 2.0
_REFRESH_EVERY = 1000


def watched(records: "Iterator[BagRecord]", bag: "Bag") -> "Iterator[BagRecord]":
    """The records themselves, with a bar on stderr that shows how far into the bag they are."""
    if bag.start_ns is None or bag.end_ns is None:
        return records
    return with_bar(records, bag.path.name, bag.start_ns, bag.end_ns, lambda record: record.log_time_ns)


def with_bar(
    items: Iterable[Item], label: str, start_ns: int, end_ns: int, time_ns: Callable[[Item], int]
) -> Iterator[Item]:
    """Items in order of time, with a bar on stderr that shows how far they are from start to end."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import Progress

    started_s, span_ns = time.monotonic(), max(end_ns - start_ns, 1)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(label, total=span_ns, visible=False)
        for number, item in enumerate(items):
            if number % _REFRESH_EVERY == 0:
                shown = time.monotonic() - started_s > _PATIENCE_S
                progress.update(task, completed=time_ns(item) - start_ns, visible=shown)
            yield item
