"""Progress of long work on stderr: share done and time left.

On a terminal one line is rewritten, and erased at the end. Elsewhere a line is written every ten seconds. Work of less
than two seconds shows nothing. Output on stdout is not touched.
"""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

_PATIENCE_S = 2.0
"""Nothing is shown before this time."""

_REWRITTEN_S = 0.25
"""Least time between two states of the line on a terminal."""

_LINE_EVERY_S = 10.0
"""Least time between two lines where stderr is no terminal."""

_LEAST_SHARE = 0.02
"""Share of the work that must be done before the time left is estimated."""

_ERASE = "\r\x1b[K"

_on_terminal: list["Progress"] = []
"""Progress whose line stands on the terminal now."""

Item = TypeVar("Item")


class Progress:
    """The progress of one piece of work; a context, at whose end the line is erased.

    Args:
        label: what is worked on, e.g. the name of a bag.
        clock: returns seconds of a steady clock.
    """

    def __init__(self, label: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._label, self._clock = label, clock
        self._stream: Any = sys.stderr
        self._is_terminal = self._stream.isatty()
        self._started_s = clock()
        self._next_s = self._started_s + (_PATIENCE_S if self._is_terminal else _LINE_EVERY_S)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def show(self, share: float) -> None:
        """Show the share of the work that is done, 0 to 1, unless something was shown a moment ago."""
        now_s = self._clock()
        if now_s < self._next_s:
            return
        text = progress_text(self._label, share, now_s - self._started_s)
        if self._is_terminal:
            self._next_s = now_s + _REWRITTEN_S
            if self not in _on_terminal:
                _on_terminal.append(self)
            self._stream.write(_ERASE + text)
        else:
            self._next_s = now_s + _LINE_EVERY_S
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
    for progress in _on_terminal:
        progress.end()


def progress_text(label: str, share: float, elapsed_s: float) -> str:
    """Return a line of progress: "night.mcap: 42 %, 1 min 20 s left"."""
    share = min(max(share, 0.0), 1.0)
    if share < _LEAST_SHARE:
        return f"{label}: {100.0 * share:.0f} %, {_length(elapsed_s)} so far"
    return f"{label}: {100.0 * share:.0f} %, {_length(elapsed_s * (1.0 - share) / share)} left"


def with_progress(
    items: Iterable[Item], label: str, start: float, end: float, place: Callable[[Item], float]
) -> Iterator[Item]:
    """Yield items in their order, and show how far they are from start to end.

    Args:
        items: are yielded.
        label: what is worked on.
        start: place of the beginning, e.g. a time in ns.
        end: place of the end.
        place: returns the place of an item.
    """
    length = max(end - start, 1)
    with Progress(label) as progress:
        for item in items:
            progress.show((place(item) - start) / length)
            yield item


def with_count(items: Iterable[Item], label: str, count: int) -> Iterator[Item]:
    """Yield items, and show how many of them are done."""
    with Progress(label) as progress:
        for number, item in enumerate(items):
            progress.show(number / max(count, 1))
            yield item


def _length(seconds: float) -> str:
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
