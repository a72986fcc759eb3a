"""One of the six figures of [Z14] drawn in both readings."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from ship_attitude_star.layout.installation_model import Reading
from ship_attitude_star.layout.sweeps import Curve, Sweep
from ship_geometry.rotations import FloatArray

_ANGLES = ("heading", "pitch", "roll")
_SYMBOLS = ("dK", "dψ", "dθ")
_READING_TITLES = {Reading.PHYSICAL: "physical reading", Reading.PAPER: "as in [Z14]"}
# Curves that coincide show each other: pale and wide below dark and narrow; ahead and astern are blue, abeam orange.
_CURVE_STYLES = {
    0.0: ("#8fbfe6", "-", 5.0),
    90.0: ("#fbb982", "-", 5.0),
    180.0: ("#08306b", "--", 1.8),
    270.0: ("#a63603", ":", 2.2),
}
_ONLY_COLOUR = "#0b3c6f"
_MARGIN = 0.08


def sweep_figure(sweep: Sweep, curves: list[Curve]) -> Figure:
    """One figure: three errors side by side, the physical reading above that of [Z14]."""
    figure, grid = plt.subplots(2, 3, figsize=(12, 6.6), sharex=True, layout="constrained")
    for row, (reading, words) in zip(grid, _READING_TITLES.items(), strict=True):
        drawn = [curve for curve in curves if curve.reading is reading]
        for column, axes in enumerate(row):
            for curve in drawn:
                _draw_curve(axes, curve, column)
            _limit(axes, [curve.errors_arcsec[:, column] for curve in drawn])
            axes.set_title(f"{_ANGLES[column]} {_SYMBOLS[column]}, {words}")
            axes.set_xlim(*sweep.range_deg)
            axes.xaxis.set_major_locator(MultipleLocator(90.0 if sweep.range_deg[1] > 90.0 else 30.0))
        row[0].set_ylabel("error [″]")
    for axes in grid[-1]:
        axes.set_xlabel(f"{sweep.symbol}, {sweep.meaning} [°]")
    errors = "all six errors, added with their signs" if sweep.all_errors else "error of the sensor's roll γs alone"
    figure.suptitle(f"Figure {sweep.number} of [Z14]: {errors}, over {sweep.symbol}")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _draw_curve(axes: Axes, curve: Curve, column: int) -> None:
    values = curve.errors_arcsec[:, column]
    if curve.azimuth_deg is None:
        axes.plot(curve.swept_deg, values, color=_ONLY_COLOUR, lw=2.2, label="error")
        return
    colour, line, width = _CURVE_STYLES[curve.azimuth_deg]
    axes.plot(curve.swept_deg, values, color=colour, ls=line, lw=width, label=f"A0 = {curve.azimuth_deg:g}°")


def _limit(axes: Axes, series: list[FloatArray]) -> None:
    """Limits that hold zero and leave out what grows without bound as the ship comes to stand on end."""
    values = np.concatenate(series)
    values = values[np.isfinite(values)]
    size = np.abs(values)
    most = max(4.0 * float(np.median(size)), float(np.percentile(size, 80.0)), 1.0)
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    low, high = max(low, -most), min(high, most)
    margin = _MARGIN * max(high - low, 1.0)
    axes.set_ylim(low - margin, high + margin)
