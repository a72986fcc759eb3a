"""Stanford diagram: counts of epochs by error and protection level, with the regions named."""

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from ship_bags.errors import BadInput
from ship_geometry.rotations import FloatArray
from ship_node.pages.figure_files import COMMON_STYLE
from ship_replay.evaluation.stanford import Epochs, Region
from ship_watch.orientations import channel_name

_STYLE = {
    **COMMON_STYLE,
    "axes.grid": False,
    "font.size": 13,
    "axes.titlesize": 15,
    "axes.labelsize": 14,
    "hatch.linewidth": 1.0,
    "hatch.color": "0.55",
}
_BINS_PER_DECADE = 16
_LEAST_ARCSEC = 1e-3
_ERRORS_BELOW_LEVEL = 300.0
"""Ratio of the smallest level to the smallest error drawn; smaller errors are drawn at the left edge."""
_MARGIN = 2.0
_IN_FIRST_CELL = 1.001
_MISLEADING_COLOUR = "#d55e00"
_NAME_BOX = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2.0}


def stanford_figure(epochs: Sequence[Epochs], title: str) -> Figure:
    """Return a figure with one row for each orientation and one panel for each of its angles."""
    with plt.rc_context(_STYLE):
        figure, grid = plt.subplots(
            len(epochs), 3, figsize=(20, 7.6 * len(epochs) + 0.6), squeeze=False, layout="constrained"
        )
        figure.suptitle(title, fontsize=17)
        for row, part in zip(grid, epochs, strict=True):
            for axis, axes in enumerate(row):
                _draw(axes, part, axis)
    return figure


def _draw(axes: Axes, epochs: Epochs, axis: int) -> None:
    channel = epochs.orientation.channels[axis]
    name = channel_name(channel)
    error, level = epochs.error_arcsec[:, axis], epochs.level_arcsec[:, axis]
    limits = epochs.limit_arcsec[:, axis]
    limit = _common_limit(limits[np.isfinite(level)], name)
    # An output that is unusable although its level is within the limit is not drawn.
    drawn = np.isfinite(error) & np.isfinite(level) & (epochs.is_usable | (level > limits))
    axes.set(xscale="log", yscale="log", xlabel="size of the error [arcsec]", ylabel="protection level [arcsec]")
    axes.set_title(_title(name, epochs, channel))
    if not drawn.any():
        axes.text(0.5, 0.5, "no epoch with a protection level", transform=axes.transAxes, ha="center")
        return
    bounds = _bounds(error[drawn], level[drawn], limit)
    _draw_regions(axes, bounds, limit)
    misleading = (error > level) & (level <= limits)
    _draw_counts(axes, error[drawn], level[drawn], misleading[drawn], bounds)
    _name_regions(axes, bounds, limit, epochs.counts()[channel])
    axes.set(xlim=bounds[:2], ylim=bounds[2:])
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for scale in (axes.xaxis, axes.yaxis):
        scale.set_major_formatter(FuncFormatter(lambda value, _position: f"{value:g}"))
        scale.set_minor_formatter(NullFormatter())


def _common_limit(limits: FloatArray, name: str) -> float:
    """Return the alert limit of all epochs, arcsec; infinite if there is none.

    Raises:
        BadInput: the limit changes, so no line can be drawn.
    """
    different = np.unique(limits)
    if len(different) > 1:
        limits_text = " and ".join(f"{limit:g}" for limit in different[:3])
        raise BadInput(
            f"no figure: the alert limit of {name} is {limits_text} arcsec: set a common one by --alert-limit"
        )
    return float(different[0]) if len(different) else math.inf


def _title(name: str, epochs: Epochs, channel: str) -> str:
    counts = epochs.counts()[channel]
    total = sum(counts.values())
    available = 1.0 - counts[Region.UNAVAILABLE] / total
    return f"{name}: {_with_digit_groups(total)} epochs, {100.0 * available:.2f} % available"


def _bounds(error: FloatArray, level: FloatArray, limit: float) -> tuple[float, float, float, float]:
    """Return minimum and maximum error, minimum and maximum level of a panel, arcsec."""
    least = max(float(np.min(level)), _LEAST_ARCSEC)
    known_limit = limit if math.isfinite(limit) else 0.0
    top = _MARGIN * max(float(np.max(level)), known_limit)
    right = max(top, 1.2 * float(np.max(error)))
    bottom = min(least, known_limit or least) / (2.0 * _MARGIN)
    return least / _ERRORS_BELOW_LEVEL, right, bottom, top


def _draw_regions(axes: Axes, bounds: tuple[float, float, float, float], limit: float) -> None:
    """Draw lines and hatches, which remain visible in grey print."""
    left, right, bottom, top = bounds
    on_line = np.geomspace(max(left, bottom), right, 200)
    capped = np.minimum(on_line, min(limit, top))
    axes.fill_between(on_line, bottom, capped, facecolor="0.93", edgecolor="0.6", hatch="//", linewidth=0.0, zorder=1)
    axes.plot([left, right], [left, right], color="black", lw=2.0, zorder=3)
    if math.isfinite(limit):
        axes.axhline(limit, color="black", lw=2.0, ls="--", zorder=3)
        axes.plot([limit, limit], [bottom, limit], color="black", lw=2.0, ls="--", zorder=3)
        axes.fill_between([limit, right], bottom, limit, facecolor="0.8", edgecolor="0.3", hatch="xx", lw=0.0, zorder=1)
        axes.fill_between([left, right], limit, top, facecolor="0.97", edgecolor="0.8", hatch="..", lw=0.0, zorder=0)


def _draw_counts(
    axes: Axes,
    error: FloatArray,
    level: FloatArray,
    misleading: NDArray[np.bool_],
    bounds: tuple[float, float, float, float],
) -> None:
    """Draw the number of epochs in each cell, darker for more, and a mark on each cell with a misleading epoch."""
    left, right, bottom, top = bounds
    edges = [
        np.geomspace(least, most, max(round(_BINS_PER_DECADE * math.log10(most / least)), 2))
        for least, most in ((left, right), (bottom, top))
    ]
    error = np.maximum(error, left * _IN_FIRST_CELL)
    counts, *_ = np.histogram2d(error[~misleading], level[~misleading], bins=edges)
    # The order of the colours is kept in grey print. The lightest colours, invisible on white paper, are not used.
    colours = ListedColormap(matplotlib.colormaps["cividis_r"](np.linspace(0.12, 1.0, 256)))
    norm = LogNorm(1, max(counts.max(), 10))
    mesh = axes.pcolormesh(*edges, np.ma.masked_equal(counts.T, 0), cmap=colours, norm=norm, zorder=2)
    axes.figure.colorbar(mesh, ax=axes, label="epochs", pad=0.02)
    cells = np.nonzero(np.histogram2d(error[misleading], level[misleading], bins=edges)[0])
    x, y = (np.sqrt(edge[:-1] * edge[1:])[cell] for edge, cell in zip(edges, cells, strict=True))
    axes.scatter(x, y, s=36, marker="o", facecolor=_MISLEADING_COLOUR, edgecolor="black", linewidth=1.2, zorder=5)


def _name_regions(
    axes: Axes, bounds: tuple[float, float, float, float], limit: float, counts: dict[Region, int]
) -> None:
    left, right, bottom, top = bounds
    limited = math.isfinite(limit)

    def name(region: Region, x: float, y: float, remark: str = "", **how: Any) -> None:
        words = f"{region.label}\n{_with_digit_groups(counts[region])}{remark}".replace("hazardously ", "hazardously\n")
        axes.annotate(words, xytext=(x, y), fontsize=13, fontweight="bold", bbox=_NAME_BOX, zorder=6, **how)

    foot, corner = bottom * 1.1, (left, bottom)
    name(Region.NOMINAL, left * 1.2, foot, xy=corner, ha="left", va="bottom")
    remark = "" if limited else ", not drawn"
    name(Region.UNAVAILABLE, left * 1.2, top / 1.1, remark, xy=corner, ha="left", va="top")
    if not limited:
        name(Region.MISLEADING, right / 1.1, foot, xy=corner, ha="right", va="bottom")
        return
    name(Region.HAZARDOUS, right / 1.1, foot, xy=corner, ha="right", va="bottom")
    # The region is too narrow for its name: an arrow points to it.
    middle = math.sqrt(bottom * limit)
    arrow = {"arrowstyle": "-|>", "color": "black", "lw": 1.5}
    where = middle, math.sqrt(bottom * middle)
    name(Region.MISLEADING, bottom / 1.3, bottom * 1.8, xy=where, ha="right", va="bottom", arrowprops=arrow)


def _with_digit_groups(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")
