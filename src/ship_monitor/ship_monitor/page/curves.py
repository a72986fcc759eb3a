"""What a plot draws of many points: the least and largest of each second, gaps left open, labels apart.

All of it is pure. Times are UTC as POSIX time in ns, as everywhere; the browser counts in ms.
"""

import math
from collections.abc import Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_watch.history import Timed, extremes

TimesNs = NDArray[np.int64]

ROWS_KEPT = 1200
"""A line has no more points than this: two for each second of ten minutes."""

BUCKET_NS = 1_000_000_000
"""Of each such stretch of time, ns, a line keeps the least and the largest value."""

LEAST_GAP_NS = 2_000_000_000
"""Nothing shorter is a gap, ns."""

STEPS_ARCSEC = (15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)
"""Half widths that an axis may have, arcsec: fixed, so that small looks small."""


def thinned(time_ns: TimesNs, value: FloatArray) -> NDArray[np.intp]:
    """Which rows a line keeps: of each second the least and the largest value, in the order of their times.

    The second of the newest row is not over yet: its rows wait for the next call.

    Args:
        time_ns: rising, shape (n,).
        value: NaN is neither least nor largest, but a second of nothing else keeps one row, so that a gap stays.
    """
    ends = np.flatnonzero(np.diff(time_ns // BUCKET_NS)) + 1
    # The last stretch is that of the second that is not over.
    return extremes(value[: ends[-1], None], [0, *ends[:-1]]) if len(ends) else np.empty(0, np.intp)


def waits_from(time_ns: TimesNs) -> int:
    """First of the rows that :func:`thinned` leaves for the next call: those of the newest second."""
    return int(np.searchsorted(time_ns // BUCKET_NS, time_ns[-1] // BUCKET_NS)) if len(time_ns) else 0


def usual_period_ns(points: Sequence[Timed]) -> float:
    """The usual time between two of the newest points, ns; 0 where it is not known."""
    times = [point.utc_ns for point in islice(reversed(points), 60)]
    return float(np.median(-np.diff(times))) if len(times) > 1 else 0.0


def gaps_before(time_ns: TimesNs, taken_ns: int | None, usual_ns: float) -> NDArray[np.intp]:
    """Rows before which a line is broken: nothing came for more than three times the usual, 2 s at least.

    Args:
        time_ns: rising, shape (n,).
        taken_ns: time of the row before the first; None where there is none.
        usual_ns: usual time between two points.
    """
    first = time_ns[0] if taken_ns is None else taken_ns
    return np.flatnonzero(np.diff(time_ns, prepend=first) > max(LEAST_GAP_NS, 3.0 * usual_ns))


def fixed_step(largest: float, steps: Sequence[float] = STEPS_ARCSEC) -> float:
    """The smallest step that holds a size; the first where it is not known, the last where none holds it."""
    return next((step for step in steps if not largest > step), steps[-1])


def placed(wanted: Sequence[float], apart: float, low: float, high: float) -> list[float]:
    """Places of labels as near to the wanted as they can be without covering one another, in the order given.

    Args:
        wanted: where they would best be.
        apart: least distance of two.
        low: no label is below it; where there are too many, they stand closer.
        high: none is above it.
    """
    if not wanted:
        return []
    apart = min(apart, (high - low) / max(len(wanted) - 1, 1))
    order = sorted(range(len(wanted)), key=lambda index: wanted[index])
    places = [0.0] * len(wanted)
    below = low - apart
    for index in order:
        places[index] = below = max(min(wanted[index], high), below + apart)
    above = high + apart
    for index in reversed(order):
        places[index] = above = min(places[index], above - apart)
    return places


def signed(value: float, digits: int = 1) -> str:
    """A number with its sign, the minus a real one."""
    if not math.isfinite(value):
        return "unknown"
    text = f"{value:+.{digits}f}"
    return ("+" + text[1:] if float(text) == 0.0 else text).replace("-", "−")
