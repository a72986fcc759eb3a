"""Curves over time: reduction of many points, lines whose new points are sent to the browsers, common time axis.

Points are reduced to the minimum and maximum of each second. Times are UTC as POSIX time in ns; the browser uses ms.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import islice

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_watch.history.history import Point, Timed, extreme_rows, points_after

TimesNs = NDArray[np.int64]

MAX_ROWS = 1200
"""Maximum number of points of a line: two for each second of ten minutes."""

BUCKET_NS = 1_000_000_000
"""Interval for which a line contains only the minimum and the maximum, ns."""

MIN_GAP_NS = 2_000_000_000
"""Minimum length of a gap, ns."""

STEPS_ARCSEC = (15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)
"""Possible half widths of an axis, arcsec: fixed steps, so that small values look small."""


MS = 1e-6
"""Milliseconds, the browser's unit of time, per nanosecond."""

BAND = ("low", "high", "edge_low", "edge_high")
"""Columns of a band: two for its area, two for the lines at its edges."""


class StreamedLine:
    """Data of a line in the browsers: new points are streamed, and only the newest :data:`MAX_ROWS` rows are kept.

    Args:
        columns: names of the columns in addition to ``t``, the time in ms.
        by: column whose minima and maxima are kept where a line is drawn with fewer points.
        filled: columns that bound areas. In a gap these columns are 0, not NaN, because browsers fill across NaN.

    Attributes:
        source: data source of the glyphs.
    """

    def __init__(self, columns: Sequence[str], by: str, filled: Sequence[str] = ()) -> None:
        self.source = ColumnDataSource({name: np.empty(0) for name in ("t", *columns)})
        self._by, self._filled = by, frozenset(filled)
        self._streamed_ns: int | None = None
        self._last_row_ns: int | None = None
        self._oldest_ns = 0

    def stream_new(self, points: Sequence[Point], rows: Callable[[Sequence[Point]], Mapping[str, FloatArray]]) -> None:
        """Stream the new points of complete seconds; start again with the first point if the data have restarted.

        Args:
            points: points in the order of their times.
            rows: returns the columns of some points.
        """
        has_restarted = not points or points[-1].utc_ns < (self._streamed_ns or 0) or points[0].utc_ns < self._oldest_ns
        if self._streamed_ns is not None and has_restarted:
            self._streamed_ns = self._last_row_ns = None
            self.source.data = {name: np.empty(0) for name in self.source.data}
        self._oldest_ns = points[0].utc_ns if points else 0
        new = points_after(points, self._streamed_ns)
        time_ns = np.array([point.utc_ns for point in new], np.int64)
        over = first_pending_row(time_ns)
        if not over:
            return
        columns: dict[str, FloatArray] = {"t": MS * time_ns.astype(float), **rows(new)}
        kept = rows_to_draw(time_ns, columns[self._by])
        broken = gap_rows(time_ns[kept], self._last_row_ns, median_period_ns(points))
        self._streamed_ns = int(time_ns[over - 1])
        last_times = np.concatenate(([MS * (self._last_row_ns or 0)], columns["t"][kept]))[broken]
        gaps = np.repeat(broken, 2)  # one row right after the gap starts, one right before it ends
        streamed = {}
        for name, column in columns.items():
            known = np.nan_to_num(column[kept]) if name in self._filled else column[kept]
            streamed[name] = np.insert(known, gaps, 0.0 if name in self._filled else np.nan)
        streamed["t"][np.isnan(streamed["t"])] = np.column_stack(
            [last_times + 1.0, columns["t"][kept][broken] - 1.0]
        ).ravel()
        self._last_row_ns = int(time_ns[kept[-1]])
        self.source.stream({name: column[-MAX_ROWS:] for name, column in streamed.items()}, rollover=MAX_ROWS)


def three_sigma_band(sigma: FloatArray) -> dict[str, FloatArray]:
    """Return the columns of :data:`BAND` for ±3 sigma."""
    return {"low": -3.0 * sigma, "high": 3.0 * sigma, "edge_low": -3.0 * sigma, "edge_high": 3.0 * sigma}


class TimeAxis:
    """Common time axis of all plots of a page: the last ten minutes, unless the user zooms.

    Args:
        length_s: length of the axis, s.

    Attributes:
        range: range shared by the plots.
    """

    def __init__(self, length_s: float) -> None:
        self._length_ms = 1e3 * length_s
        self.range = Range1d(0.0, self._length_ms)
        self._live_range = self._latest_range = (self.range.start, self.range.end)

    @property
    def is_paused(self) -> bool:
        """True if the user has zoomed, so that the plots do not follow the time."""
        return (self.range.start, self.range.end) != self._live_range

    def update(self, utc_ns: int) -> None:
        """Show the time up to ``utc_ns``, unless paused."""
        paused, end = self.is_paused, MS * utc_ns
        self._latest_range = (end - self._length_ms, end)
        if not paused:
            self.go_live()

    def go_live(self) -> None:
        """End the zoom."""
        self._live_range = self._latest_range
        self.range.update(start=self._live_range[0], end=self._live_range[1])


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
