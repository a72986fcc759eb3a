"""Figures of docs/reproduction.md."""

from collections.abc import Iterator

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ship_studies.layout.figures import sweep_figures
from ship_studies.layout.installation_model import all_curves
from tools.papers import w18
from tools.papers.z14_conclusions import POINT

_DRAWN = 500
_DOTS, _PRINTED, _BARS = "#0072b2", "#d55e00", "#8fbfe6"


def figures() -> Iterator[tuple[str, Figure]]:
    """Yield name of the file and figure, for the six figures of [Z14] and the figure of [W18]."""
    for name, figure in sweep_figures(all_curves(POINT)):
        yield f"z14_{name}", figure
    yield "w18_figure_4", _axis_figure()


def _axis_figure() -> Figure:
    """Draw errors of the axis by [W18]'s method, by epoch and as a histogram; one row for each reading."""
    figure, grid = plt.subplots(
        2, 2, figsize=(11, 6.8), width_ratios=(2.2, 1.0), sharex="col", sharey="row", layout="constrained"
    )
    for row, reading in zip(grid, (w18.UNSURVEYED, w18.SURVEYED), strict=True):
        sizes = w18.axis_errors(reading).triads
        mean, sigma, total = w18.summary(sizes)
        row[0].plot(np.arange(_DRAWN), sizes[:_DRAWN], ".", ms=4, color=_DOTS)
        row[0].set_title(f"{reading.name}: mean {mean:.2f}″, σ {sigma:.2f}″, total {total:.2f}″")
        row[0].set(ylabel="error of the axis [″]", ylim=(0.0, 15.0), xlim=(0, _DRAWN))
        edges = np.arange(0.0, 15.01, 0.5)
        shares = np.full(sizes.size, 100.0 / sizes.size)
        row[1].hist(sizes, edges, weights=shares, orientation="horizontal", color=_BARS)
        row[1].set_title("frequency")
        for axes in row:
            _draw_printed(axes)
    grid[-1, 0].set_xlabel("epoch")
    grid[-1, 1].set_xlabel("epochs [% per 0.5″]")
    figure.suptitle("Figure 4 of [W18] in two readings: the paper's method, two lights at 2 km")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _draw_printed(axes: Axes) -> None:
    mean, sigma = w18.PRINTED_MEAN_ARCSEC, w18.PRINTED_SIGMA_ARCSEC
    axes.axhline(mean, color=_PRINTED, lw=1.8, label=f"printed mean, {mean:.2f}″")
    axes.axhspan(mean - sigma, mean + sigma, color=_PRINTED, alpha=0.15, lw=0, label=f"printed mean ± σ, {sigma:.2f}″")
