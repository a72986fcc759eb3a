"""Reduction of many points for a plot: minimum and maximum of each second, gaps, and positions of labels.

All functions are pure. Times are UTC as POSIX time in ns; the browser uses ms.
"""

import math
from collections.abc import Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_watch.history.history import Timed, extreme_rows

TimesNs = NDArray[np.int64]

MAX_ROWS = 1200
"""Maximum number of points of a line: two for each second of ten minutes."""

BUCKET_NS = 1_000_000_000
"""Interval for which a line contains only the minimum and the maximum, ns."""

MIN_GAP_NS = 2_000_000_000
"""Minimum length of a gap, ns."""

STEPS_ARCSEC = (15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)
"""Possible half widths of an axis, arcsec: fixed steps, so that small values look small."""


def rows_to_draw(time_ns: TimesNs, value: FloatArray) -> NDArray[np.intp]:
    """Return the rows of a line: minimum and maximum of each second, in the order of their times.

    Rows of the newest, incomplete interval of one second are left for the next call.

    Args:
        time_ns: rising times, shape (n,).
        value: values, shape (n,). NaN is ignored; for an interval with only NaN one row is returned, so that the
            line has a gap.
    """
    ends = np.flatnonzero(np.diff(time_ns // BUCKET_NS)) + 1
    # The last interval is incomplete.
    return extreme_rows(value[: ends[-1], None], [0, *ends[:-1]]) if len(ends) else np.empty(0, np.intp)


def first_pending_row(time_ns: TimesNs) -> int:
    """Return the first row that :func:`rows_to_draw` leaves for the next call."""
    return int(np.searchsorted(time_ns // BUCKET_NS, time_ns[-1] // BUCKET_NS)) if len(time_ns) else 0


def median_period_ns(points: Sequence[Timed]) -> float:
    """Return the median time between the newest points, ns; 0 if unknown."""
    times = [point.utc_ns for point in islice(reversed(points), 60)]
    return float(np.median(-np.diff(times))) if len(times) > 1 else 0.0


def gap_rows(time_ns: TimesNs, previous_ns: int | None, period_ns: float) -> NDArray[np.intp]:
    """Return the rows that follow a gap. A gap is longer than three periods and longer than 2 s.

    Args:
        time_ns: rising times, shape (n,).
        previous_ns: time of the row before the first row; None if there is no such row.
        period_ns: usual time between two points, ns.
    """
    first = time_ns[0] if previous_ns is None else previous_ns
    return np.flatnonzero(np.diff(time_ns, prepend=first) > max(MIN_GAP_NS, 3.0 * period_ns))


def next_step(largest: float, steps: Sequence[float] = STEPS_ARCSEC) -> float:
    """Return the smallest step that is at least ``largest``; the first step for NaN, the last if all are too small."""
    return next((step for step in steps if not largest > step), steps[-1])


def label_positions(wanted: Sequence[float], spacing: float, low: float, high: float) -> list[float]:
    """Return positions of labels near the wanted positions, without overlap, in the order of ``wanted``.

    Args:
        wanted: best positions.
        spacing: minimum distance of two labels; it is reduced if there are too many labels.
        low: lowest position.
        high: highest position.
    """
    if not wanted:
        return []
    spacing = min(spacing, (high - low) / max(len(wanted) - 1, 1))
    order = sorted(range(len(wanted)), key=lambda index: wanted[index])
    places = [0.0] * len(wanted)
    below = low - spacing
    for index in order:
        places[index] = below = max(min(wanted[index], high), below + spacing)
    above = high + spacing
    for index in reversed(order):
        places[index] = above = min(places[index], above - spacing)
    return places


def signed_text(value: float, digits: int = 1) -> str:
    """Return a number with its sign, with "−" (U+2212) as minus; "unknown" if it is not finite."""
    if not math.isfinite(value):
        return "unknown"
    text = f"{value:+.{digits}f}"
    return ("+" + text[1:] if float(text) == 0.0 else text).replace("-", "−")
