"""Design study as figures, and as one self-contained HTML page with text, tables and embedded figures.

Only the command imports this module, when it draws, because matplotlib takes long to load.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter

from ship_geometry.frames import ENU_FROM_HORIZON
from ship_node.pages.figure_files import legend_below
from ship_node.pages.html_page import decimal_text, render
from ship_studies.design.study import DesignStudy, DesignSweep

_GIVEN, _BEST = "#0b3c6f", "#c1440e"
_COLUMNS = 2
_FINE, _COARSE, _WIDE = (1.0, 2.0, 5.0), (1.0, 3.0), 100.0
"""Labelled values of a decade, fine and coarse, and the ratio of an axis' ends above which coarse labels are used."""
_HIGHEST = 8.0
"""Largest upper end of the error axis, as a multiple of the given design's error."""

_WORTH_MOVING = 0.05
"""Relative gain of accuracy below which the advised positions are reported as a small improvement."""


def study_figures(study: DesignStudy) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of every figure of the study."""
    yield "field", _field_figure(study)
    yield "sweeps", _sweeps_figure(study)


def _field_figure(study: DesignStudy) -> Figure:
    """Return the figure of the beacons in the telescope's field."""
    figure, axes = plt.subplots(figsize=(6.2, 6.8), layout="constrained")
    radius = study.config.optical_axis.escort.field_deg
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.5", lw=1, label="field")
    axes.plot(0.0, 0.0, "+", color="0.3", ms=12)
    kinds = (("as given", _GIVEN, "o", "bottom"), ("best positions", _BEST, "^", "top"))
    for (words, colour, mark, side), places_deg, distances_m in zip(
        kinds, study.places_deg, study.distances_m, strict=True
    ):
        axes.plot(*places_deg.T, mark, color=colour, ms=9, label=words)
        for name, (right, up), distance_m in zip(study.config.names, places_deg, distances_m, strict=True):
            if np.isfinite(distance_m):
                text = f"{name}, {distance_m:.0f} m"
                align = "right" if right > 0.0 else "left"
                axes.annotate(
                    text, (right, up), xytext=(0, 8 if side == "bottom" else -8), textcoords="offset points",
                    color=colour, ha=align, va=side,
                )  # fmt: skip
    axes.set(
        aspect="equal", xlabel="to the right of the axis [°]", ylabel="above the axis [°]", title="Lights in the field"
    )
    legend_below(figure, axes)
    return figure


def _sweeps_figure(study: DesignStudy) -> Figure:
    rows = -(-len(study.sweeps) // _COLUMNS)
    figure, grid = plt.subplots(rows, _COLUMNS, figsize=(10.5, 3.3 * rows + 0.5), squeeze=False, layout="constrained")
    for axes in grid.ravel()[len(study.sweeps) :]:
        axes.set_axis_off()
    for sweep, axes in zip(study.sweeps, grid.ravel(), strict=False):
        _draw_sweep(axes, sweep, study)
    legend_below(figure, grid[0, 0], 4)
    return figure


def _draw_sweep(axes: Axes, sweep: DesignSweep, study: DesignStudy) -> None:
    given_arcsec, required_arcsec = study.given_arcsec[2], study.config.required_arcsec
    axes.loglog(sweep.values, sweep.sigma_arcsec, color=_GIVEN, lw=2, label="given lights")
    is_evaluated = np.isfinite(sweep.best_arcsec)
    axes.loglog(sweep.values[is_evaluated], sweep.best_arcsec[is_evaluated], "^", color=_BEST, label="best positions")
    if sweep.given > 0.0:
        axes.plot(sweep.given, given_arcsec, "o", color=_GIVEN, ms=8, label="this design")
    if required_arcsec > 0.0:
        axes.axhline(required_arcsec, color="0.3", ls=":", lw=1.5, label="required")
    shown = [*sweep.sigma_arcsec, *sweep.best_arcsec[is_evaluated], required_arcsec or given_arcsec]
    axes.set(
        xlabel=sweep.label if sweep.unit == "m" else f"{sweep.label} [{sweep.unit}]",
        ylabel="error [″]",
        ylim=(0.8 * np.nanmin(shown), min(1.25 * np.nanmax(shown), _HIGHEST * given_arcsec)),
    )
    plain, in_units = FuncFormatter(lambda value, _: f"{value:g}"), EngFormatter(unit=sweep.unit, sep="\u2009")
    for axis, words in ((axes.xaxis, in_units if sweep.unit == "m" else plain), (axes.yaxis, plain)):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=_FINE if high < _WIDE * low else _COARSE))
        axis.set_major_formatter(words)
        axis.set_minor_formatter(NullFormatter())


def page_text(study: DesignStudy, figures: Mapping[str, Path], title: str) -> str:
    """Return the page.

    Args:
        study: the study to show.
        figures: PNG files by name, which the page embeds.
        title: title of the study, for the heading.
    """
    return render(
        Path(__file__).with_name("page.html.j2"),
        title=title,
        study=study,
        figures=figures,
        largest=max(study.budget, key=lambda source: source.given_arcsec[2]),
        is_possible=np.isfinite(study.advice.sigma_advised),
        gain=_gain_text(study),
        reached="; ".join(study.advice.limits_reached),
        places=list(_places(study)),
        budget=[
            *([one.source.replace("_", " "), *one.given_arcsec, *one.advised_arcsec] for one in study.budget),
            ["root sum of squares", *study.given_arcsec, *study.advised_arcsec],
        ],
        exposures=study.config.optical_axis.escort.exposures,
    )


def _gain_text(study: DesignStudy) -> str:
    gain = 1.0 - study.advised_arcsec[2] / study.given_arcsec[2]
    if gain < 0.0:
        return "The given lights are better: they are beyond the limits of escort."
    if gain < _WORTH_MOVING:
        return f"The improvement of {100.0 * gain:.1f} % is small: other needs of the flight may decide."
    return f"They reduce the error by {100.0 * gain:.0f} %."


def _places(study: DesignStudy) -> Iterator[list[Any]]:
    both = (("as given", study.given_n), ("best", study.advice.places_n))
    for number, (words, places_n) in enumerate(both):
        for light, name in enumerate(study.config.names):
            lengths_m = study.distances_m[number, light], *(ENU_FROM_HORIZON @ places_n[light])
            yield [words, name, *study.places_deg[number, light], *(decimal_text(one, 0) for one in lengths_m)]
