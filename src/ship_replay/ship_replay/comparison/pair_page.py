"""The page of two recordings side by side, with its figures.

The figures show both recordings on one time axis, or side by side with the same scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ship_bags.stamps import NS_PER_S
from ship_estimation.integrity.protection_levels import NORMAL_95
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.figure_files import MAX_ROWS, short_name
from ship_node.pages.html_page import render
from ship_replay.comparison.pair import OutputDifference, Pair
from ship_replay.comparison.pair_summary import pair_summary, pair_warnings
from ship_replay.comparison.pair_tables import (
    alerts_of_one,
    alignment_tables,
    budget_tables,
    consistency_rows,
    difference_rows,
    error_rows,
    events_of_one,
    parameter_differences,
    rejection_rows_of_both,
    text_differences,
)
from ship_replay.evaluation.figures import gap_times, utc_axis, with_gaps
from ship_replay.report.drawings import (
    MAX_POINTS,
    SVG_STYLE,
    decimate_errors,
    decimate_innovations,
    decimation_mask,
    draw_accuracies,
    draw_ribbon,
    style_axes,
    svg,
)
from ship_replay.report.page import metadata_texts, period_texts, recorded_versions, versions
from ship_replay.report.recording import RecordedHistory, ReportData
from ship_replay.report.tables import number, shares, utc
from ship_watch.orientations import ORIENTATIONS, channel_name
from ship_watch.suite_state import ANGLES, Safety

_A, _B = ("#0b3c6f", "-"), ("#d55e00", "--")
"""Colour and line style of each run, distinguishable in black and white."""

_PALE = "#cfdceb"

PAIR_SECTIONS = (
    ("verdict", "Summary"),
    ("states", "States"),
    ("difference", "Output differences"),
    ("errors", "Errors with their ±3σ"),
    ("budget", "Error budget"),
    ("consistency", "NIS and NEES"),
    ("alignment", "Alignment at the end"),
    ("alerts", "Alerts in one run only"),
    ("events", "Events in one run only"),
    ("refusals", "Rejections by reason"),
    ("configuration", "Configuration"),
    ("provenance", "Versions and hashes"),
)
"""Ids and titles of the sections, in order."""

_DATE_TIME = "%Y-%m-%d %H:%M:%S"


def states_svg(pair: Pair) -> str:
    """Return the figure of both runs: the safety states, then one row per angle with its 95 % accuracy.

    The text is empty if no angle was published.
    """
    shown = [name for name in ANGLES if any(recording.safety_states.get(name) for recording in pair.recordings)]
    if not shown:
        return ""
    start_ns, end_ns = pair.span_ns
    with plt.rc_context(SVG_STYLE):
        ribbons = 2 * len(shown)
        figure, grid = plt.subplots(
            1 + len(shown), 1, figsize=(9.2, 0.6 + 0.2 * ribbons + 0.95 * len(shown)), sharex=True, squeeze=False,
            layout="constrained", height_ratios=(0.2 * ribbons, *[0.95] * len(shown)),
        )
        top, *others = grid[:, 0]
        for row, name in enumerate(shown):
            for below, night in enumerate(pair.recordings):
                draw_ribbon(top, 2 * row + below, night.safety_states.get(name, []), start_ns)
        top.set_yticks(range(ribbons), [f"{name} {one}" for name in shown for one in "AB"], fontsize=8)
        top.set_ylim(ribbons - 0.5, -0.5)
        top.tick_params(length=0)
        for axes, name in zip(others, shown, strict=True):
            lines = [
                (recording, name, {"color": colour, "ls": dash, "label": letter})
                for letter, recording, (colour, dash) in zip("AB", pair.recordings, (_A, _B), strict=True)
            ]
            draw_accuracies(axes, lines, start_ns, [pair.a.recording.limits.angle_limit(name)])
            axes.tick_params(axis="y", labelsize=8)
            axes.set_ylabel(f"{name}\n95 % [″]", fontsize=8)
        for axes in others[:1]:
            axes.legend(ncols=2, fontsize=8, frameon=False, loc="upper right")
        top.set_xlim(0.0, max((end_ns - start_ns) / NS_PER_S, 1.0))
        style_axes(grid[:, 0])
        utc_axis(grid[-1, 0], start_ns)
    return svg(figure, "states")


def difference_svg(difference: OutputDifference, span_ns: tuple[int, int]) -> str:
    """Return the figure of B minus A at equal stamps, one row per channel, with ±1.96σ of A and of B.

    Args:
        difference: difference of one output.
        span_ns: first and last time of the axis, UTC in ns.
    """
    start_ns, end_ns = span_ns
    with plt.rc_context(SVG_STYLE):
        channels = difference.orientation.channels
        figure, grid = plt.subplots(
            len(channels), 1, figsize=(9.2, 1.6 * len(channels) + 0.4), sharex=True, squeeze=False, layout="constrained"
        )
        drawn = np.hstack([difference.difference_arcsec, *difference.sigma_arcsec])
        kept = np.flatnonzero(decimation_mask(drawn, 4 * MAX_POINTS))
        columns = difference.difference_arcsec[kept], *(sigma[kept] for sigma in difference.sigma_arcsec)
        time_ns, (differences, *sigmas) = with_gaps(difference.time_ns[kept], gap_times(difference.time_ns), *columns)
        time_s = (time_ns - start_ns) / NS_PER_S
        for channel, axes in enumerate(grid[:, 0]):
            band_a, band_b = (NORMAL_95 * sigma[:, channel] for sigma in sigmas)
            axes.fill_between(time_s, -band_a, band_a, color=_PALE, lw=0, label="±1.96σ of A")
            for sign in (-1.0, 1.0):
                axes.plot(time_s, sign * band_b, color=_B[0], ls=_B[1], lw=0.8, label="±1.96σ of B" if sign > 0 else "")
            values = differences[:, channel]
            axes.plot(time_s, values, color="#1b2430", lw=0.9, label="B − A")
            _set_limits(axes, [values, band_a, band_b])
            axes.set_ylabel(f"{channel_name(channels[channel])}\n[arcsec]", fontsize=8)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), ncols=3, fontsize=8, frameon=False,
                      loc="outside upper right")
        grid[0, 0].set_xlim(0.0, max((end_ns - start_ns) / NS_PER_S, 1.0))
        style_axes(grid[:, 0])
        utc_axis(grid[-1, 0], start_ns)
    return svg(figure, "difference-" + difference.orientation.label)


@dataclass(frozen=True)
class _Series:
    """Residuals or errors with their sigmas, arcsec, and their stamps."""

    time_ns: np.ndarray
    value: FloatArray
    sigma: FloatArray


def sides_svg(pair: Pair) -> str:
    """Return the figure of the errors, or without truth of the innovations, with their ±3σ: A left, B right.

    Both sides of a row have the same scale. The text is empty if there are neither errors nor innovations.
    """
    sides = [_errors(report_data) if pair.a.evaluation.errors or pair.b.evaluation.errors else _innovations(report_data)
             for report_data in (pair.a, pair.b)]
    names = list(dict.fromkeys([*sides[0], *sides[1]]))
    if not names:
        return ""
    start_ns, end_ns = pair.span_ns
    count, names = len(names), names[:MAX_ROWS]
    with plt.rc_context(SVG_STYLE):
        figure, grid = plt.subplots(
            len(names), 2, figsize=(9.2, 1.25 * len(names) + 0.6), sharex=True, sharey="row", squeeze=False,
            layout="constrained",
        )
        for name, row in zip(names, grid, strict=True):
            found = [(axes, side[name]) for axes, side in zip(row, sides, strict=True) if name in side]
            for axes, line in found:
                time_s = (line.time_ns - start_ns) / NS_PER_S
                axes.fill_between(time_s, -3.0 * line.sigma, 3.0 * line.sigma, color=_PALE, lw=0)
                axes.plot(time_s, line.value, color=_A[0], lw=0.8)
            for axes, side in zip(row, sides, strict=True):
                if name not in side:
                    axes.text(0.5, 0.5, "no data", transform=axes.transAxes, ha="center", color="#888888")
            _set_limits(row[0], [part for _, line in found for part in (line.value, 3.0 * line.sigma)])
            label = "\n".join(map(short_name, name.split("\n")))
            row[0].set_ylabel(label, fontsize=8, rotation="horizontal", ha="right", va="center")
        if count > MAX_ROWS:
            figure.suptitle(f"the first {MAX_ROWS} of {count} sources", fontsize=8)
        for letter, axes in zip("AB", grid[0], strict=True):
            axes.set_title(letter, fontsize=10, fontweight="bold")
        grid[0, 0].set_xlim(0.0, max((end_ns - start_ns) / NS_PER_S, 1.0))
        style_axes(grid.ravel())
        for axes in grid[-1]:
            utc_axis(axes, start_ns, 3)
            axes.tick_params(axis="x", labelsize=8)
    return svg(figure, "sides")


def _errors(report_data: ReportData) -> dict[str, _Series]:
    lines = {}
    outputs = [orientation.label for orientation in ORIENTATIONS]
    for series in report_data.evaluation.errors:
        if series.label in outputs:
            thin = decimate_errors(series)
            for channel, name in enumerate(series.channels):
                lines[f"{series.label}\n{channel_name(name)}"] = _Series(
                    thin.time_ns, thin.error_arcsec[:, channel], thin.sigma_arcsec[:, channel]
                )
    return lines


def _innovations(report_data: ReportData) -> dict[str, _Series]:
    lines = {}
    for source, part in report_data.evaluation.innovations.items():
        thin = decimate_innovations(part)
        for component in thin.components():
            stamps, residual, sigma = thin.series(component)
            if len(stamps):
                lines[f"{source}\n{component}"] = _Series(stamps, residual / ARCSEC, sigma / ARCSEC)
    return lines


def _set_limits(axes: Axes, parts: Sequence[FloatArray]) -> None:
    """Set symmetric limits from the 99th percentile; larger values, as at the start, may lie outside."""
    sizes = [np.percentile(np.abs(part[np.isfinite(part)]), 99.0) for part in parts if np.isfinite(part).any()]
    high = 1.25 * max(sizes, default=0.0)
    axes.set_ylim(-high if high > 0.0 else -1.0, high if high > 0.0 else 1.0)


def pair_page(pair: Pair) -> str:
    """Return the comparison of two recordings as a single HTML file; the same recordings give the same text."""
    a, b = pair.recordings
    parameters, errors = parameter_differences(a, b), error_rows(pair)
    warnings = pair_warnings(pair, _problems(pair))
    warned = [warning.what for warning in warnings]
    return render(
        Path(__file__).with_name("compare.html.j2"),
        sections=PAIR_SECTIONS,
        a=a,
        b=b,
        title="A and B side by side",
        **period_texts(*pair.span_ns),
        differing=lambda rows: [row for row in rows if row[1::2] != row[2::2]],
        verdict=[text for text in pair_summary(pair, errors, parameters) if text not in warned],
        warnings=warnings,
        shares=_shares_of_both(a, b),
        states=states_svg(pair),
        differences=difference_rows(pair.differences),
        difference_drawings=[
            difference_svg(found, pair.span_ns) for found in pair.differences if not all(found.channels_equal)
        ],
        sides=sides_svg(pair),
        errors=[
            ["" if previous is not None and previous.label == row.label else row.label, row.name,
             *map(number, row.rms), f"{row.ratio:.2f}", *map(number, row.size_95), *row.samples]
            for previous, row in zip([None, *errors], errors, strict=False)
        ],
        budgets=budget_tables(pair),
        consistency=consistency_rows(pair),
        alignment=alignment_tables(pair),
        alerts=alerts_of_one(pair),
        events=events_of_one(pair),
        refusals=rejection_rows_of_both(pair),
        parameters=parameters,
        texts=text_differences(a, b),
        provenance=[
            ("bag", a.path.name, b.path.name),
            ("SHA-256", a.sha256, b.sha256),
            ("first and last message, UTC", *(
                f"{utc(night.start_ns, _DATE_TIME)} to {utc(night.end_ns, _DATE_TIME)}" for night in (a, b)
            )),
            *_rows_of_both(*map(metadata_texts, (a, b))),
            ("topics in this bag only", *(
                ", ".join(sorted(mine.topics.keys() - other.topics.keys())) or "none"
                for mine, other in ((a, b), (b, a))
            )),
        ],
        recorded_versions=_rows_of_both(*(dict(recorded_versions(night)) for night in (a, b))),
        versions=versions(),
    )


def _problems(pair: Pair) -> list[str]:
    """Return the problems of the bags, each preceded by the letters of the bags with this problem."""
    found: dict[str, str] = {}
    for letter, report_data in zip("AB", (pair.a, pair.b), strict=True):
        for problem in sorted({*report_data.recording.problems, *report_data.evaluation.problems}):
            found[problem] = f"{found[problem]} and {letter}" if problem in found else letter
    return [f"{letters}: {problem}" for problem, letters in found.items()]


def _shares_of_both(a: RecordedHistory, b: RecordedHistory) -> list[list[str]]:
    """Return angle, and shares of each safety state in A and in B; a dash where the angle was not published."""
    of_a, of_b = ({name: share for name, share, _ in shares(recording)} for recording in (a, b))
    return [
        [name, *(
            f"{100.0 * of_run[name][word.name]:.1f} %" if name in of_run else "–"
            for word in Safety for of_run in (of_a, of_b)
        )]
        for name in ANGLES if name in of_a or name in of_b
    ]


def _rows_of_both(a: Mapping[str, str], b: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return each name with its values in A and in B; a missing value is empty."""
    return [(name, a.get(name, ""), b.get(name, "")) for name in dict.fromkeys([*a, *b])]
