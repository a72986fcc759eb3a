"""Progress of long work on stderr: percentage done and time left.

On a terminal one line is rewritten and erased at the end; work of less than two seconds shows nothing. Without a
terminal a line is written every ten seconds. stdout is not used.
"""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

_FIRST_SHOWN_S = 2.0
"""Time before which nothing is shown on a terminal, s."""

_MIN_REWRITE_PERIOD_S = 0.25
"""Minimum time between two updates of the line on a terminal, s."""

_LINE_PERIOD_S = 10.0
"""Minimum time between two lines without a terminal, s."""

_MIN_SHARE = 0.02
"""Minimum ratio of work done for an estimate of the time left."""

_ERASE = "\r\x1b[K"

_on_terminal: list["Progress"] = []
"""Progress objects whose line is on the terminal."""

Item = TypeVar("Item")


class Progress:
    """Progress of one task; as a context manager it erases the line at the end.

    Args:
        label: the task, e.g. the name of a bag.
        clock: returns the time of a steady clock, s.
    """

    def __init__(self, label: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._label, self._clock = label, clock
        self._stream: Any = sys.stderr
        self._is_terminal = self._stream.isatty()
        self._started_s = clock()
        self._next_s = self._started_s + (_FIRST_SHOWN_S if self._is_terminal else _LINE_PERIOD_S)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def show(self, share: float) -> None:
        """Show the ratio of work done, 0 to 1, if the next update is due."""
        now_s = self._clock()
        if now_s < self._next_s:
            return
        text = progress_text(self._label, share, now_s - self._started_s)
        if self._is_terminal:
            self._next_s = now_s + _MIN_REWRITE_PERIOD_S
            if self not in _on_terminal:
                _on_terminal.append(self)
            self._stream.write(_ERASE + text)
        else:
            self._next_s = now_s + _LINE_PERIOD_S
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Erase the line on a terminal."""
        if self in _on_terminal:
            _on_terminal.remove(self)
            self._stream.write(_ERASE)
            self._stream.flush()


def erase_progress() -> None:
    """Erase a line of progress that an interruption has left on the terminal."""
    for progress in tuple(_on_terminal):  # end() removes it
        progress.end()


def progress_text(label: str, share: float, elapsed_s: float) -> str:
    """Return a line of progress: "voyage.mcap: 42 %, 1 min 20 s left"."""
    share = min(max(share, 0.0), 1.0)
    if share < _MIN_SHARE:
        return f"{label}: {100.0 * share:.0f} %, {_length(elapsed_s)} so far"
    return f"{label}: {100.0 * share:.0f} %, {_length(elapsed_s * (1.0 - share) / share)} left"


def with_progress(
    items: Iterable[Item], label: str, start: float, end: float, place: Callable[[Item], float]
) -> Iterator[Item]:
    """Yield items in their order, and show the progress from start to end.

    Args:
        items: the items.
        label: the task.
        start: position of the beginning, e.g. a time in ns.
        end: position of the end.
        place: returns the position of an item.
    """
    length = max(end - start, 1)
    with Progress(label) as progress:
        for item in items:
            progress.show((place(item) - start) / length)
            yield item


def with_count(items: Iterable[Item], label: str, count: int) -> Iterator[Item]:
    """Yield items, and show how many of ``count`` are done."""
    with Progress(label) as progress:
        for number, item in enumerate(items):
            progress.show(number / max(count, 1))
            yield item


def _length(seconds: float) -> str:
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
