"""Time axes of a report: UTC ticks at round times, and lines interrupted at gaps."""

from datetime import datetime, timezone

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, Locator

from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import FloatArray

_STEPS_S = (
    *(1, 2, 5, 10, 20, 30), *(60 * minutes for minutes in (1, 2, 5, 10, 20, 30)),
    *(3600 * hours for hours in (1, 2, 3, 6, 12, 24)),
)
"""Steps between ticks, s: divisors of a day, so that ticks lie at round times."""

_GAP_PERIODS = 3.0
"""Number of periods without a value above which a line is interrupted."""


class UtcTicks(Locator):
    """Ticks at round UTC times, on an axis of seconds since a start time.

    Args:
        start_ns: zero of the axis, UTC in ns.
        most: maximum number of ticks.
    """

    def __init__(self, start_ns: int, most: int) -> None:
        self._start_s, self._most = start_ns / NS_PER_S, most

    def __call__(self) -> list[float]:
        """Return the positions of the ticks within the limits of the axis."""
        assert self.axis is not None
        return self.tick_values(*self.axis.get_view_interval())

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        """Return the positions of the ticks from vmin to vmax."""
        low, high = self._start_s + min(vmin, vmax), self._start_s + max(vmin, vmax)
        days = _STEPS_S[-1] * np.arange(1, 1000)
        step = next((step for step in (*_STEPS_S, *days) if (high - low) / step < self._most), days[-1])
        first, last = int(np.ceil(low / step)), int(np.floor(high / step))
        return [float(number * step - self._start_s) for number in range(first, last + 1)]


def utc_axis(axes: Axes, start_ns: int, most_labels: int = 8) -> None:
    """Label an axis of seconds by UTC: hours and minutes, with seconds where ticks are closer than a minute."""

    def text(value: float, _: int | None) -> str:
        seconds = round(start_ns / NS_PER_S + value)
        low, high = axes.get_xlim()
        places = ticks.tick_values(low, high)
        is_fine = len(places) < 2 or places[1] - places[0] < 60.0
        form = "%H:%M:%S" if is_fine else "%H:%M"
        return datetime.fromtimestamp(seconds, tz=timezone.utc).strftime(form)

    ticks = UtcTicks(start_ns, most_labels)
    axes.xaxis.set_major_locator(ticks)
    axes.xaxis.set_major_formatter(FuncFormatter(text))
    axes.set_xlabel("UTC")


def gap_times(time_ns: np.ndarray) -> np.ndarray:
    """Return the middle of each gap that is longer than three median periods, shape (k,).

    Args:
        time_ns: stamps in ascending order, shape (n,).
    """
    steps = np.diff(time_ns)
    if len(steps) < 2:
        return np.zeros(0, dtype=np.int64)
    wide = np.flatnonzero(steps > _GAP_PERIODS * np.median(steps))
    middle: np.ndarray = (time_ns[wide] + steps[wide] // 2).astype(np.int64)
    return middle


def with_gaps(
    time_ns: np.ndarray, gaps_ns: np.ndarray, *columns: FloatArray
) -> tuple[np.ndarray, tuple[FloatArray, ...]]:
    """Return stamps and values with a NaN at each gap, so that no line is drawn through the gap.

    Args:
        time_ns: stamps, shape (n,).
        gaps_ns: times of the gaps, shape (k,).
        columns: values at the stamps, each of shape (n, ...).
    """
    times = np.concatenate([time_ns, gaps_ns]).astype(np.int64)
    order = np.argsort(times, kind="stable")
    extended = [
        np.concatenate([values, np.full((len(gaps_ns), *values.shape[1:]), np.nan)])[order] for values in columns
    ]
    return times[order], tuple(extended)
