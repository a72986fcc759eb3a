"""Figures of a run: attitude errors and residuals with their ±3σ."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ship_bags.errors import BadInput
from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.figure_files import COMMON_STYLE, MAX_ROWS, settled_slice, short_name
from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.evaluation.statistics import AttitudeErrors, SourceInnovations
from ship_watch.orientations import channel_name

_STYLE = {**COMMON_STYLE, "font.size": 12, "axes.titlesize": 14, "grid.color": "0.85", "legend.fontsize": 11}
_BAND_COLOUR = "#bcd4ea"
_LINE_COLOUR = "#0b3c6f"
# Readable in print and with colour blindness (Okabe and Ito).
_OTHER_COLOURS = ("#d55e00", "#009e73", "#cc79a7", "#e69f00")
_MARGIN = 1.3


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
    """Place the legend below the axes."""
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
