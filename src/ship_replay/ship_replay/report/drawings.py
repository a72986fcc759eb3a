"""The figures of a report as SVG that stands inside a page: few points, no names of other files, the same bytes always.

The figures of errors and residuals are those of ``evaluation/figures.py``.
"""

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.documents.figure_files import MOST_ROWS, short_name
from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.evaluation.figures import attitude_error_figure, innovation_figure
from ship_replay.evaluation.statistics import AttitudeErrors, SourceInnovations
from ship_replay.report.night import Night
from ship_watch.history import BudgetPoint, extremes
from ship_watch.picture import ANGLES, Safety

MOST_POINTS = 1200
"""A line has no more points than this."""

STATE_LOOKS = {
    Safety.SAFE: ("#cfe8dc", ""),
    Safety.CAUTION: ("#ffc53d", "//"),
    Safety.UNSAFE: ("#d8352b", "xx"),
}
"""Fill and hatch of each word: told apart in black and white, too."""

_SERIES = ("#0b3c6f", "#7a5fa8", "#1f8a82", "#8a9bb0", "#b08d57", "#c9cfd6")
SVG_STYLE = {"svg.hashsalt": "ship report", "svg.fonttype": "none", "font.size": 10, "hatch.linewidth": 0.6,
             "text.parse_math": False}
"""How every figure of a page is drawn; a name with $ is a name."""
_STRIPPED = re.compile(r"<\?xml.*?\?>|<!DOCTYPE.*?>|<metadata>.*?</metadata>|\s+xmlns(:\w+)?=\"[^\"]*\"", re.DOTALL)


def svg(figure: Figure, name: str) -> str:
    """A figure as an element of a page; it forgets the figure.

    Args:
        figure: drawn.
        name: its ids begin with this, so that figures of one page do not meddle with each other.
    """
    stream = io.StringIO()
    with plt.rc_context(SVG_STYLE):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    text = _STRIPPED.sub("", stream.getvalue())
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


def status_svg(night: Night) -> str:
    """A ribbon for each angle, a second a point, and below it how accurate it was; empty where none was ever told."""
    shown = [name for name in ANGLES if night.words.get(name)]
    if not shown:
        return ""
    with plt.rc_context(SVG_STYLE):
        figure, grid = plt.subplots(
            2, 1, figsize=(9.2, 1.2 + 0.34 * len(shown) + 2.3), sharex=True, layout="constrained",
            height_ratios=(0.34 * len(shown), 2.0),
        )
        start_ns = night.start_utc_ns
        for row, name in enumerate(shown):
            draw_ribbon(grid[0], row, night.words[name], start_ns)
        grid[0].set_yticks(range(len(shown)), shown)
        grid[0].invert_yaxis()
        grid[0].tick_params(length=0)
        drawn = 0
        for number, name in enumerate(shown):
            told = np.array(night.accuracy.get(name, []), dtype=float).reshape(-1, 2)
            told = told[told[:, 1] > 0.0]  # a covariance of zeros was not given
            drawn += len(told)
            kept = np.flatnonzero(thinned(told[:, 1:], MOST_POINTS))
            time_s = (told[kept, 0] - start_ns) / NS_PER_S
            grid[1].plot(time_s, told[kept, 1] / ARCSEC, color=_SERIES[number % 5], lw=1.0,
                         ls=("-", "--", "-.", ":", "-")[number], label=name)
        grid[1].set_yscale("log" if drawn else "linear")
        grid[1].set_ylabel("95 % [arcsec]")
        for limit in sorted({night.limits.of_angle(name) / ARCSEC for name in shown}):
            grid[1].axhline(limit, color="#888888", lw=0.7, ls=(0, (6, 3)))
            grid[1].annotate(f"{limit:g}″", (1.0, limit), xycoords=("axes fraction", "data"), xytext=(3, 0),
                             textcoords="offset points", va="center", fontsize=8, color="#666666")
        for set_formatter in (grid[1].yaxis.set_major_formatter, grid[1].yaxis.set_minor_formatter):
            set_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        grid[1].legend(ncols=5, fontsize=8, frameon=False, loc="upper right")
        grid[1].set_xlim(0.0, (night.end_ns - night.start_ns) / NS_PER_S)
        plain(grid)
        utc_axis(grid[1], start_ns)
    return svg(figure, "status")


def errors_svg(evaluation: Evaluation) -> list[str]:
    """Errors inside their ±3σ where the truth is known, a figure an orientation; innovations inside theirs elsewhere.

    Empty without either.
    """
    groups: dict[tuple[str, ...], list[AttitudeErrors]] = {}
    for errors in evaluation.errors:
        groups.setdefault(errors.channels, []).append(thin_errors(errors))
    figures = [
        (attitude_error_figure(series, ""), min(int(errors.time_ns[0]) for errors in series))
        for series in groups.values()
    ]
    innovations = {name: thin_innovations(part) for name, part in evaluation.innovations.items()}
    if not figures and any(part.components() for part in innovations.values()):
        start_ns = min(min(part.compared) for part in innovations.values() if part.compared)
        figures = [(innovation_figure(innovations, ""), start_ns)]
    for figure, start_ns in figures:
        last_row = {axes: place.rowspan.stop for axes in figure.axes if (place := axes.get_subplotspec()) is not None}
        for axes, row in last_row.items():
            if row == max(last_row.values()):
                utc_axis(axes, start_ns)
    return [svg(figure, f"errors{number}") for number, (figure, _) in enumerate(figures)]


def budget_svg(topic: str, points: Sequence[BudgetPoint], start_ns: int) -> str:
    """Variances of the largest sources, stacked for each angle; the axis is labelled by their roots."""
    points = [point for point in points if point.by_angle]
    if not points:
        return ""
    angles = list(points[-1].by_angle)
    with plt.rc_context(SVG_STYLE):
        figure, grid = plt.subplots(
            len(angles), 1, figsize=(9.2, 1.75 * len(angles) + 0.3), sharex=True, squeeze=False, layout="constrained"
        )
        for axes, angle in zip(grid[:, 0], angles, strict=True):
            _draw_budget(axes, points, angle, start_ns)
        plain(grid[:, 0])
        utc_axis(grid[-1, 0], start_ns)
    return svg(figure, "budget-" + topic.partition("/")[0])


def refusals_svg(night: Night) -> str:
    """When which source was refused: a row a source, a tick a second."""
    rows: dict[str, set[int]] = {}
    for refusal in night.refusals:
        if not refusal.is_note:
            rows.setdefault(f"{refusal.source} ({refusal.by})", set()).add(refusal.utc_ns // NS_PER_S)
    if not rows:
        return ""
    start_s, count = night.start_utc_ns / NS_PER_S, len(rows)
    rows = dict(sorted(rows.items())[:MOST_ROWS])
    with plt.rc_context(SVG_STYLE):
        figure, axes = plt.subplots(figsize=(9.2, 0.7 + 0.27 * len(rows)), layout="constrained")
        if count > MOST_ROWS:
            axes.set_title(f"the first {MOST_ROWS} of {count} sources", fontsize=8)
        for row, seconds in enumerate(rows.values()):
            bars = [(start - start_s, max(length, 1)) for start, length in _runs(sorted(seconds))]
            axes.broken_barh(bars, (row - 0.35, 0.7), facecolor="#0b3c6f", lw=0)
        axes.set_yticks(range(len(rows)), [short_name(name) for name in rows], fontsize=8)
        axes.invert_yaxis()
        axes.set_xlim(0.0, (night.end_ns - night.start_ns) / NS_PER_S)
        plain([axes])
        utc_axis(axes, night.start_utc_ns)
    return svg(figure, "refusals")


def draw_ribbon(axes: Axes, row: int, words: Sequence[tuple[int, Safety]], start_ns: int) -> None:
    """The words of an angle as bars at the height of a row, in seconds since a time."""
    for word, spans in _spans(words).items():
        fill, hatch = STATE_LOOKS[word]
        bars = [(start - start_ns / NS_PER_S, length) for start, length in spans]
        axes.broken_barh(bars, (row - 0.4, 0.8), facecolor=fill, hatch=hatch, edgecolor="white", lw=0)


def thinned(values: FloatArray, most: int) -> np.ndarray:
    """Which of the rows a line keeps: the least and largest of each column in stretches as long as one another.

    Args:
        values: shape (n, columns); what is not finite is neither.
        most: so many rows are kept at the most; all where there are no more.

    Returns:
        Booleans, shape (n,).
    """
    count, columns = values.shape
    if count <= most:
        return np.ones(count, dtype=bool)
    parts = max(most // (2 * columns), 1)
    kept = np.zeros(count, dtype=bool)
    kept[extremes(values, [part * count // parts for part in range(parts)])] = True
    return kept


def thin_errors(errors: AttitudeErrors) -> AttitudeErrors:
    """Errors with their extremes, few enough to be drawn."""
    together = np.hstack([errors.error_arcsec, errors.sigma_arcsec])
    kept = thinned(together, MOST_POINTS)
    kept[0] = True
    return errors.where(kept, errors.label)


def thin_innovations(part: SourceInnovations) -> SourceInnovations:
    """Innovations with the extremes of each component, few enough to be drawn."""
    stamps = np.array(sorted(part.compared))
    if len(stamps) <= MOST_POINTS:
        return part
    # One row of numbers, a zero before those of each stamp: a call of numpy for each stamp takes longer than all else.
    residuals: list[float] = []
    starts: list[int] = []
    for stamp in stamps.tolist():
        starts.append(len(residuals))
        residuals += [0.0, *part.compared[stamp].residual]
    values = np.array(residuals)
    worst, least = np.fmax.reduceat(np.abs(values), starts), np.fmin.reduceat(values, starts)
    kept = thinned(np.column_stack([worst, least]), MOST_POINTS)
    return SourceInnovations({stamp: part.compared[stamp] for stamp in stamps[kept].tolist()}, part.refused)


def _draw_budget(axes: Axes, points: Sequence[BudgetPoint], angle: str, start_ns: int) -> None:
    names = list(dict.fromkeys(name for point in points for name in point.by_angle.get(angle, {})))
    values = np.array([[point.by_angle.get(angle, {}).get(name, 0.0) for name in names] for point in points])
    variances = values / ARCSEC**2
    order = np.argsort(-np.median(variances, axis=0), kind="stable")
    top, rest = order[:5], order[5:]
    stack = [variances[:, index] for index in top] + ([variances[:, rest].sum(axis=1)] if len(rest) else [])
    labels = [short_name(names[index]) for index in top] + (["other"] if len(rest) else [])
    kept = thinned(np.sum(stack, axis=0)[:, None], MOST_POINTS)
    time_s = np.array([(point.utc_ns - start_ns) / NS_PER_S for point in points])[kept]
    axes.stackplot(time_s, [part[kept] for part in stack], colors=_SERIES, labels=labels, lw=0)
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


def _spans(words: Sequence[tuple[int, Safety]]) -> Mapping[Safety, list[tuple[int, int]]]:
    """Word → (first second, length in s) of each run of seconds in which it stood."""
    return {word: _runs([second for second, told in words if told is word]) for word in Safety}


def _runs(seconds: Sequence[int]) -> list[tuple[int, int]]:
    runs: list[tuple[int, int]] = []
    for second in seconds:
        if runs and second == runs[-1][0] + runs[-1][1]:
            runs[-1] = runs[-1][0], runs[-1][1] + 1
        else:
            runs.append((second, 1))
    return runs


def plain(grid: Iterable[Axes]) -> None:
    """Axes with a grid of times and without a frame."""
    for axes in grid:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", color="0.9", lw=0.6)
        axes.set_axisbelow(True)


def utc_axis(axes: Axes, start_ns: int, most_labels: int = 6) -> None:
    """Label seconds since a time by their UTC."""

    def text(value: float, _: int | None) -> str:
        return datetime.fromtimestamp(start_ns // NS_PER_S + value, tz=timezone.utc).strftime("%H:%M:%S")

    axes.xaxis.set_major_locator(MaxNLocator(most_labels, steps=[1, 2, 3, 6, 10]))
    axes.xaxis.set_major_formatter(FuncFormatter(text))
    axes.set_xlabel("UTC")
