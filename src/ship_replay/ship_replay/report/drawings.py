"""Figures of a report as inline SVG: few points, no references to other files, reproducible bytes.

The figures of errors and residuals come from ``evaluation/figures.py``.
"""

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory

from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.figure_files import MAX_ROWS, short_name
from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.evaluation.figures import attitude_error_figure, gap_times, innovation_figure, utc_axis, with_gaps
from ship_replay.evaluation.statistics import AttitudeErrors, SourceInnovations
from ship_replay.report.recording import RecordedHistory
from ship_watch.history.history import BudgetPoint, extreme_rows
from ship_watch.suite_state import ANGLES, Safety
from ship_watch.topics import source_of_name, source_of_topic

MAX_POINTS = 1200
"""Maximum number of points of a line."""

STATE_STYLES = {
    Safety.SAFE: ("#cfe8dc", ""),
    Safety.CAUTION: ("#ffc53d", "//"),
    Safety.UNSAFE: ("#d8352b", "xx"),
}
"""Fill colour and hatch of each safety state, distinguishable in black and white."""

_ROUND_NUMBERS = [digit * 10.0**power for power in range(-4, 7) for digit in (1, 2, 5)]
"""Tick values of a logarithmic axis."""

MARK_ID_PREFIX = "mark-"
"""Prefix of the id of the line that marks a second in the status figure; the POSIX second follows.

:func:`svg` adds ``status-`` in front.
"""

_SERIES = ("#0b3c6f", "#7a5fa8", "#1f8a82", "#8a9bb0", "#b08d57", "#c9cfd6")
_SOURCE_COLOURS = ("#0b3c6f", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5fa8", "#8a6d3b")
_FIRST_SOURCES = ("fused", "pointing", "ins")
SVG_STYLE = {"svg.hashsalt": "ship report", "svg.fonttype": "none", "font.size": 10, "hatch.linewidth": 0.6,
             "text.parse_math": False}
"""Style of all figures of a page; "$" in a name is printed literally."""
_STRIPPED = re.compile(r"<\?xml.*?\?>|<!DOCTYPE.*?>|<metadata>.*?</metadata>|\s+xmlns(:\w+)?=\"[^\"]*\"", re.DOTALL)


def svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element and close the figure.

    Args:
        figure: the finished figure.
        name: prefix of all ids in the figure, so that the figures of one page have different ids.
    """
    stream = io.StringIO()
    with plt.rc_context(SVG_STYLE):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    text = _STRIPPED.sub("", stream.getvalue())
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


def source_colours(recording: RecordedHistory, evaluation: Evaluation) -> dict[str, str]:
    """Return the colour of each source, the same in all figures of a report; colours repeat after eight sources."""
    named = [errors.label for errors in evaluation.errors]
    named += [*evaluation.innovations, *(source_of(refusal.source) for refusal in recording.rejections)]
    first = [name for name in _FIRST_SOURCES if name in named]
    names = [*first, *sorted({*named} - {*first})]
    return {name: _SOURCE_COLOURS[number % len(_SOURCE_COLOURS)] for number, name in enumerate(names)}


def source_of(name: str) -> str:
    """Return the source that an innovation's name or an input topic belongs to; the given name if it has no source."""
    return source_of_name(name) or source_of_topic(name) or name


def status_svg(recording: RecordedHistory, marked: Iterable[int] = ()) -> str:
    """Return the figure of each angle's safety state, second by second, with the 95 % accuracy below.

    The text is empty if no angle was published.

    Args:
        recording: the recording.
        marked: POSIX seconds to which links lead. The line at a second is visible only after its link is
            followed.
    """
    shown = [name for name in ANGLES if recording.safety_states.get(name)]
    if not shown:
        return ""
    with plt.rc_context(SVG_STYLE):
        figure, grid = plt.subplots(
            2, 1, figsize=(9.2, 1.2 + 0.34 * len(shown) + 2.3), sharex=True, layout="constrained",
            height_ratios=(0.34 * len(shown), 2.0),
        )
        start_ns = recording.start_utc_ns
        for row, name in enumerate(shown):
            draw_ribbon(grid[0], row, recording.safety_states[name], start_ns)
        grid[0].set_yticks(range(len(shown)), shown)
        grid[0].invert_yaxis()
        grid[0].tick_params(length=0)
        lines = [
            (recording, name, {"color": _SERIES[number % 5], "ls": ("-", "--", "-.", ":", "-")[number], "label": name})
            for number, name in enumerate(shown)
        ]
        draw_accuracies(grid[1], lines, start_ns, {recording.limits.angle_limit(name) for name in shown})
        grid[1].set_ylabel("95 % [arcsec]")
        grid[1].legend(ncols=5, fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        grid[1].set_xlim(0.0, (recording.end_ns - recording.start_ns) / NS_PER_S)
        style_axes(grid)
        utc_axis(grid[1], start_ns)
        across = blended_transform_factory(grid[0].transData, figure.transFigure)
        for second in sorted(set(marked)):
            place_s = second - start_ns / NS_PER_S
            line = Line2D([place_s, place_s], [0.14, 1.0], color="#1b2430", lw=2.0, transform=across)
            line.set_in_layout(False)
            line.set_gid(f"{MARK_ID_PREFIX}{second}")
            figure.add_artist(line)
    return svg(figure, "status")


def errors_svg(evaluation: Evaluation, colours: Mapping[str, str]) -> list[str]:
    """Return figures of the errors with their ±3σ, one figure for each group of sources with the same channels.

    Without errors, the list contains one figure of the innovations with their ±3σ. The list is empty if no innovation
    was accepted either.
    """
    groups: dict[tuple[str, ...], list[AttitudeErrors]] = {}
    for errors in evaluation.errors:
        groups.setdefault(errors.channels, []).append(decimate_errors(errors))
    figures = [
        (attitude_error_figure(series, "", colours), min(int(errors.time_ns[0]) for errors in series))
        for series in groups.values()
    ]
    innovations = {name: decimate_innovations(part) for name, part in evaluation.innovations.items()}
    if not figures and any(part.components() for part in innovations.values()):
        start_ns = min(min(part.accepted) for part in innovations.values() if part.accepted)
        figures = [(innovation_figure(innovations, "", colours), start_ns)]
    for figure, start_ns in figures:
        last_row = {axes: place.rowspan.stop for axes in figure.axes if (place := axes.get_subplotspec()) is not None}
        for axes, row in last_row.items():
            if row == max(last_row.values()):
                utc_axis(axes, start_ns)
    return [svg(figure, f"errors{number}") for number, (figure, _) in enumerate(figures)]


def budget_svg(topic: str, points: Sequence[BudgetPoint], start_ns: int) -> str:
    """Return the figure of each angle's variances, stacked by source of error; empty text without points of the budget.

    The axis shows the square roots of the variances.
    """
    points = [point for point in points if point.by_angle]
    if not points:
        return ""
    angles = list(points[-1].by_angle)
    colours = _budget_colours(points)
    with plt.rc_context(SVG_STYLE):
        figure, grid = plt.subplots(
            len(angles), 1, figsize=(9.2, 1.75 * len(angles) + 0.3), sharex=True, squeeze=False, layout="constrained"
        )
        for axes, angle in zip(grid[:, 0], angles, strict=True):
            _draw_budget(axes, points, angle, start_ns, colours)
        style_axes(grid[:, 0])
        utc_axis(grid[-1, 0], start_ns)
    return svg(figure, "budget-" + topic.partition("/")[0])


def rejections_svg(recording: RecordedHistory, colours: Mapping[str, str]) -> str:
    """Return the figure of the seconds with unused measurements, a row for each source and place (node or filter)."""
    rows: dict[str, set[int]] = {}
    for refusal in recording.rejections:
        if not refusal.is_note:
            rows.setdefault(f"{refusal.source} ({refusal.by})", set()).add(refusal.utc_ns // NS_PER_S)
    if not rows:
        return ""
    start_s, count = recording.start_utc_ns / NS_PER_S, len(rows)
    rows = dict(sorted(rows.items())[:MAX_ROWS])
    with plt.rc_context(SVG_STYLE):
        figure, axes = plt.subplots(figsize=(9.2, 0.7 + 0.27 * len(rows)), layout="constrained")
        if count > MAX_ROWS:
            axes.set_title(f"the first {MAX_ROWS} of {count} sources", fontsize=8)
        for row, (name, seconds) in enumerate(rows.items()):
            colour = colours.get(source_of(name.rpartition(" (")[0]), _SERIES[0])
            bars = [(start - start_s, max(length, 1)) for start, length in _runs(sorted(seconds))]
            axes.broken_barh(bars, (row - 0.35, 0.7), facecolor=colour, lw=0)
        axes.set_yticks(range(len(rows)), [short_name(name) for name in rows], fontsize=8)
        axes.invert_yaxis()
        axes.set_xlim(0.0, (recording.end_ns - recording.start_ns) / NS_PER_S)
        style_axes([axes])
        utc_axis(axes, recording.start_utc_ns)
    return svg(figure, "refusals")


def draw_ribbon(axes: Axes, row: int, words: Sequence[tuple[int, Safety]], start_ns: int) -> None:
    """Draw the states of an angle as bars at the height of a row, in seconds since `start_ns`."""
    for word, (fill, hatch) in STATE_STYLES.items():
        spans = _runs([second for second, state in words if state is word])
        bars = [(start - start_ns / NS_PER_S, length) for start, length in spans]
        axes.broken_barh(bars, (row - 0.4, 0.8), facecolor=fill, hatch=hatch, edgecolor="white", lw=0)


def draw_accuracies(
    axes: Axes, lines: Iterable[tuple[RecordedHistory, str, dict[str, Any]]], start_ns: int, limits: Iterable[float]
) -> None:
    """Draw 95 % accuracies on a logarithmic axis, arcsec, over seconds since `start_ns`.

    Args:
        axes: the axes.
        lines: recording, angle, and look of the line.
        start_ns: zero of the time axis, UTC.
        limits: limits of the angles, rad.
    """
    drawn = 0
    for recording, name, look in lines:
        accuracy = np.array(recording.accuracy.get(name, []), dtype=float).reshape(-1, 2)
        accuracy = accuracy[accuracy[:, 1] > 0.0]  # zero if no covariance was given
        drawn += len(accuracy)
        kept = np.flatnonzero(decimation_mask(accuracy[:, 1:], MAX_POINTS))
        time_ns, (value,) = with_gaps(accuracy[kept, 0], gap_times(accuracy[:, 0]), accuracy[kept, 1])
        axes.plot((time_ns - start_ns) / NS_PER_S, value / ARCSEC, lw=1.0, **look)
    axes.set_yscale("log" if drawn else "linear")
    for limit in sorted(limit / ARCSEC for limit in limits):
        axes.axhline(limit, color="#888888", lw=0.7, ls=(0, (6, 3)))
        axes.annotate(f"{limit:g}″", (1.0, limit), xycoords=("axes fraction", "data"), xytext=(3, 0),
                      textcoords="offset points", va="center", fontsize=8, color="#666666")
    if drawn:
        axes.yaxis.set_major_locator(FixedLocator(_ROUND_NUMBERS))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def decimation_mask(values: FloatArray, most: int) -> np.ndarray:
    """Return a mask of the rows of a decimated line: minimum and maximum of each column in each of several equal parts.

    Args:
        values: shape (n, columns); non-finite values are ignored.
        most: maximum number of rows kept; all rows are kept if their number is at most this value.

    Returns:
        True for the rows kept, shape (n,).
    """
    count, columns = values.shape
    if count <= most:
        return np.ones(count, dtype=bool)
    parts = max(most // (2 * columns), 1)
    kept = np.zeros(count, dtype=bool)
    kept[extreme_rows(values, [part * count // parts for part in range(parts)])] = True
    return kept


def decimate_errors(errors: AttitudeErrors) -> AttitudeErrors:
    """Return errors decimated to their extremes; NaN where the output was INVALID or missing."""
    together = np.hstack([errors.error_arcsec, errors.sigma_arcsec])
    kept = decimation_mask(together, MAX_POINTS)
    kept[0] = True
    thin = errors.select(kept, errors.label)
    columns = thin.error_arcsec, thin.sigma_arcsec, thin.nees
    time_ns, (error, sigma, nees) = with_gaps(thin.time_ns, gap_times(errors.time_ns), *columns)
    return replace(thin, time_ns=time_ns, error_arcsec=error, sigma_arcsec=sigma, nees=nees)


def decimate_innovations(part: SourceInnovations) -> SourceInnovations:
    """Return decimated innovations.

    The extremes over time of two values of each stamp are kept: the largest absolute residual and the least residual.
    """
    stamps = np.array(sorted(part.accepted))
    if len(stamps) <= MAX_POINTS:
        return part
    # All residuals are in one array, because one numpy call per stamp would be far slower. A zero precedes the
    # residuals of each stamp.
    residuals: list[float] = []
    starts: list[int] = []
    for stamp in stamps.tolist():
        starts.append(len(residuals))
        residuals += [0.0, *part.accepted[stamp].residual]
    values = np.array(residuals)
    worst, least = np.fmax.reduceat(np.abs(values), starts), np.fmin.reduceat(values, starts)
    kept = decimation_mask(np.column_stack([worst, least]), MAX_POINTS)
    return SourceInnovations({stamp: part.accepted[stamp] for stamp in stamps[kept].tolist()}, part.rejected)


def _budget_colours(points: Sequence[BudgetPoint]) -> dict[str, str]:
    """Return one colour for each source of error, the same for all angles; the largest sources come first."""
    totals: dict[str, float] = {}
    for angle in points[-1].by_angle:
        found = [point.by_angle.get(angle, {}) for point in points]
        for name in dict.fromkeys(name for one in found for name in one):
            median = float(np.median([one.get(name, 0.0) for one in found]))
            totals[name] = max(totals.get(name, 0.0), median)
    names = sorted(totals, key=lambda name: -totals[name])
    return {name: _SOURCE_COLOURS[number % len(_SOURCE_COLOURS)] for number, name in enumerate(names)}


def _draw_budget(
    axes: Axes, points: Sequence[BudgetPoint], angle: str, start_ns: int, colours: Mapping[str, str]
) -> None:
    names = list(dict.fromkeys(name for point in points for name in point.by_angle.get(angle, {})))
    values = np.array([[point.by_angle.get(angle, {}).get(name, 0.0) for name in names] for point in points])
    variances = values / ARCSEC**2
    order = np.argsort(-np.median(variances, axis=0), kind="stable")
    top, rest = order[:5], order[5:]
    stack = [variances[:, index] for index in top] + ([variances[:, rest].sum(axis=1)] if len(rest) else [])
    labels = [short_name(names[index]) for index in top] + (["other"] if len(rest) else [])
    kept = decimation_mask(np.sum(stack, axis=0)[:, None], MAX_POINTS)
    stamps_ns = np.array([point.utc_ns for point in points])
    time_ns, bands = with_gaps(stamps_ns[kept], gap_times(stamps_ns), *[part[kept] for part in stack])
    drawn = [*(colours[names[index]] for index in top), _SERIES[-1]]
    axes.stackplot((time_ns - start_ns) / NS_PER_S, bands, colors=drawn, labels=labels, lw=0)
    total = np.sum(stack, axis=0)
    high = float(np.percentile(total, 95.0)) * 1.3
    axes.set_ylim(0.0, high if high > 0.0 else 1.0)
    if (peak := float(np.sqrt(total.max()))) ** 2 > high:
        axes.annotate(f"peak {peak:.3g}″", (0.01, 0.86), xycoords="axes fraction", fontsize=8)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{np.sqrt(max(value, 0.0)):.2g}"))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.set_ylabel(f"{angle}\nσ [arcsec]")
    handles, texts = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], texts[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _runs(seconds: Sequence[int]) -> list[tuple[int, int]]:
    """Return first second and length in s of each uninterrupted series of seconds."""
    runs: list[tuple[int, int]] = []
    for second in seconds:
        if runs and second == runs[-1][0] + runs[-1][1]:
            runs[-1] = runs[-1][0], runs[-1][1] + 1
        else:
            runs.append((second, 1))
    return runs


def style_axes(grid: Iterable[Axes]) -> None:
    """Show grid lines at the ticks of time, and no frame at top and right."""
    for axes in grid:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", color="0.9", lw=0.6)
        axes.set_axisbelow(True)
