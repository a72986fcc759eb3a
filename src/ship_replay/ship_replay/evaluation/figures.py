"""Figures of a run: attitude errors and residuals with their ±3σ, and UTC time axes with gaps.

The ticks of a UTC axis stand at round times, and lines are interrupted at gaps.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, Locator

from ship_bags.errors import BadInput
from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.figure_files import COMMON_STYLE, MAX_ROWS, settled_slice, short_name
from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.evaluation.statistics import AttitudeErrors, SourceInnovations
from ship_watch.orientations import channel_name

_STEPS_S = (
    *(1, 2, 5, 10, 20, 30), *(60 * minutes for minutes in (1, 2, 5, 10, 20, 30)),
    *(3600 * hours for hours in (1, 2, 3, 6, 12, 24)),
)
"""Steps between ticks, s: divisors of a day, so that ticks lie at round times."""

_GAP_PERIODS = 3.0
"""Number of periods without a value above which a line is interrupted."""

_STYLE = {**COMMON_STYLE, "font.size": 12, "axes.titlesize": 14, "grid.color": "0.85", "legend.fontsize": 11}
_BAND_COLOUR = "#bcd4ea"
_LINE_COLOUR = "#0b3c6f"
# Readable in print and with colour blindness (Okabe and Ito).
_OTHER_COLOURS = ("#d55e00", "#009e73", "#cc79a7", "#e69f00")
_MARGIN = 1.3


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


def evaluation_figure(evaluation: Evaluation, title: str) -> Figure:
    """Return a figure of the errors if the truth is known, else of the residuals."""
    if evaluation.errors:
        return attitude_error_figure(evaluation.errors, title)
    return innovation_figure(evaluation.innovations, title)


def attitude_error_figure(
    series: Sequence[AttitudeErrors], title: str, colours: Mapping[str, str] | None = None
) -> Figure:
    """Return a figure of errors over time, one row per channel.

    Args:
        series: errors by source. The first source of each orientation is drawn with its ±3σ band on its own scale. If
            there are other sources, a further column shows all together, except parts such as ``pointing.encoder``.
        title: title of the figure.
        colours: colour of each source; None for the default colours.
    """
    panels = [(group, together) for group in _by_orientation(series) for together in (False, True)[: len(group)]]
    start_ns = min(int(errors.time_ns[0]) for errors in series)
    with plt.rc_context(_STYLE):
        figure, grid = plt.subplots(
            3, len(panels), figsize=(7.5 * len(panels), 9), sharex=True, squeeze=False, layout="constrained"
        )
        figure.suptitle(title)
        for column, (group, together) in zip(grid.T, panels, strict=True):
            for row, axes in enumerate(column):
                if together:
                    _draw_together(axes, group, row, start_ns, colours or {})
                else:
                    _draw_band(axes, group[0], row, start_ns)
                    name = channel_name(group[0].channels[row])
                    axes.set_ylabel(f"{name}\nerror [arcsec]")
            column[-1].set_xlabel("time [s]")
            _legend_below(column[-1], together)
            if len(panels) > 1:
                column[0].set_title("all sources" if together else group[0].label)
    return figure


def innovation_figure(
    innovations: Mapping[str, SourceInnovations], title: str, colours: Mapping[str, str] | None = None
) -> Figure:
    """Return a figure of the residuals of accepted measurements with their predicted ±3σ, a row per component.

    Each residual, also of a single star or light, is one dot, and the band shows the predicted ±3σ of this residual. A
    source without accepted measurements has no row; the title names the source.

    Raises:
        BadInput: no source has an accepted measurement.
    """
    rows = [(source, part, component) for source, part in innovations.items() for component in part.components()]
    if not rows:
        raise BadInput(f"{title}: no figure: no measurement was accepted")
    empty = [source for source, part in innovations.items() if not part.components()]
    if empty:
        title = f"{title}\nnothing accepted of: {', '.join(map(short_name, empty[:MAX_ROWS]))}"
    if len(rows) > MAX_ROWS:
        title = f"{title}\nthe first {MAX_ROWS} of {len(rows)} components"
    rows = rows[:MAX_ROWS]
    start_ns = min(min(part.accepted) for _, part, _ in rows)
    with plt.rc_context(_STYLE):
        figure, grid = plt.subplots(
            len(rows), 1, figsize=(9, 2.4 * len(rows) + 1), sharex=True, squeeze=False, layout="constrained"
        )
        figure.suptitle(title)
        for (source, part, component), axes in zip(rows, grid[:, 0], strict=True):
            stamps, residuals, sigmas = part.series(component)
            time_s = (stamps - start_ns) / NS_PER_S
            band = 3.0 * sigmas / ARCSEC
            axes.fill_between(time_s, -band, band, color=_BAND_COLOUR, label="±3σ predicted")
            colour = (colours or {}).get(source, _LINE_COLOUR)
            axes.plot(time_s, residuals / ARCSEC, ".", color=colour, ms=3, label="residual")
            # The label is horizontal, because a source's name may be longer than its row is high.
            label = f"{short_name(source)}\n{short_name(component)} [arcsec]"
            axes.set_ylabel(label, rotation="horizontal", ha="right", va="center")
            later = settled_slice(sigmas)
            _set_limits(axes, np.concatenate([residuals[later] / ARCSEC, band[later]]), percentile=100.0)
        grid[-1, 0].set_xlabel("time [s]")
        _legend_below(grid[-1, 0], with_points=False)
    return figure


def _by_orientation(series: Sequence[AttitudeErrors]) -> list[list[AttitudeErrors]]:
    """Return the series grouped by channels; a part of a group's first series, as ``pointing.encoder``, is omitted."""
    groups: dict[tuple[str, str, str], list[AttitudeErrors]] = {}
    for errors in series:
        group = groups.setdefault(errors.channels, [])
        if not group or not errors.label.startswith(group[0].label + "."):
            group.append(errors)
    return list(groups.values())


def _draw_band(axes: Axes, errors: AttitudeErrors, column: int, start_ns: int) -> None:
    time_s = (errors.time_ns - start_ns) / NS_PER_S
    band = 3.0 * errors.sigma_arcsec[:, column]
    axes.fill_between(time_s, -band, band, color=_BAND_COLOUR, label="±3σ predicted")
    axes.plot(time_s, errors.error_arcsec[:, column], color=_LINE_COLOUR, lw=0.8, label="error")
    later = settled_slice(band)
    _set_limits(axes, np.concatenate([errors.error_arcsec[later, column], band[later]]))


def _legend_below(axes: Axes, with_points: bool) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=3, markerscale=5 if with_points else 1)


def _draw_together(
    axes: Axes, series: Sequence[AttitudeErrors], column: int, start_ns: int, colours: Mapping[str, str]
) -> None:
    settled_errors = [errors.error_arcsec[settled_slice(errors.sigma_arcsec[:, column]), column] for errors in series]
    _set_limits(axes, np.concatenate(settled_errors))
    top, beyond = axes.get_ylim()[1], 0
    for number, errors in enumerate(series):
        time_s = (errors.time_ns - start_ns) / NS_PER_S
        by_order = _LINE_COLOUR if number == 0 else _OTHER_COLOURS[(number - 1) % len(_OTHER_COLOURS)]
        colour = colours.get(errors.label, by_order)
        # Points, not lines, because sources have gaps. The first source is drawn on top of the noisier sources.
        axes.plot(
            time_s, errors.error_arcsec[:, column], ".", color=colour, ms=2.5, label=errors.label, zorder=3 - number
        )
        median = float(np.nanmedian(np.abs(errors.error_arcsec[:, column])))
        if not median <= top:
            words = f"{errors.label}: beyond the scale, median {median:.3g} arcsec"
            axes.text(0.02, 0.96 - 0.1 * beyond, words, color=colour, transform=axes.transAxes, va="top")
            beyond += 1


def _set_limits(axes: Axes, values: FloatArray, percentile: float = 98.0) -> None:
    """Set symmetric limits. By default rare large values lie outside, so that the rest is visible."""
    values = np.abs(values[np.isfinite(values)])
    top = float(np.percentile(values, percentile)) * _MARGIN if len(values) else 0.0
    if top > 0.0:
        axes.set_ylim(-top, top)
