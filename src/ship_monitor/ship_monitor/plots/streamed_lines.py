"""Lines over time, whose new points are sent to the browsers, and the common time axis of all plots."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from bokeh.models import ColumnDataSource, Range1d

from ship_geometry.rotations import FloatArray
from ship_monitor.plots.curves import MAX_ROWS, first_pending_row, gap_rows, median_period_ns, rows_to_draw
from ship_watch.history.history import Point, points_after

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
