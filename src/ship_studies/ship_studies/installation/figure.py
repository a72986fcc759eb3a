"""Figure of the installation angles over a session. The import of matplotlib takes longer than many sessions."""

from collections.abc import Iterator

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_node.pages.figure_files import legend_below, settled_slice
from ship_studies.installation.result import InstallationCalibration, InstalledAngle

_BAND_COLOUR = "#bcd4ea"
_LINE_COLOUR = "#0b3c6f"
_CONFIGURED_COLOUR = "#d55e00"
_MARGIN = 1.15


def calibration_figures(calibration: InstallationCalibration) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of the only figure."""
    yield "installation", _history_figure(calibration)


def _history_figure(calibration: InstallationCalibration) -> Figure:
    """Return the correction of every angle over the session, one row per sensor, with the last values as titles."""
    rows = len(calibration.sensors)
    figure, grid = plt.subplots(rows, 3, figsize=(14, 3.2 * rows + 1), sharex=True, squeeze=False, layout="constrained")
    figure.suptitle(f"{calibration.session.name}: correction of the installation angles, with its ±1σ")
    for number, angle in enumerate(calibration.angles):
        _draw_history(grid[divmod(number, 3)], calibration, angle)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    for sensor, axes in zip(calibration.sensors, grid[:, 0], strict=True):
        axes.set_ylabel(f"{sensor} [arcsec]")
    legend_below(figure, grid[0, 0])
    return figure


def _draw_history(axes: Axes, calibration: InstallationCalibration, angle: InstalledAngle) -> None:
    time_s = calibration.session.times_s
    history = calibration.session.history[f"star.{angle.sensor}.{angle.angle}"]
    values, sigmas = history.T
    value, sigma = wrap_pi(values - angle.configured) / ARCSEC, sigmas / ARCSEC
    axes.axhline(0.0, color=_CONFIGURED_COLOUR, lw=1.2, ls="--", label="configured")
    axes.fill_between(time_s, value - sigma, value + sigma, color=_BAND_COLOUR, label="±1σ")
    axes.plot(time_s, value, color=_LINE_COLOUR, lw=1.2, label="correction")
    axes.set_title(
        f"{angle.angle} {angle.correction_arcsec:+.2f} ± {angle.sigma / ARCSEC:.2f}″, "
        f"before ± {angle.sigma_before / ARCSEC:.4g}″"
    )
    # The wide band at the start may lie outside the axes limits, so that the rest is visible.
    later = settled_slice(sigma)
    edges = np.concatenate([value[later] - sigma[later], value[later] + sigma[later]])
    edges = edges[np.isfinite(edges)]
    if len(edges):
        middle, half = 0.5 * (edges.max() + edges.min()), 0.5 * (edges.max() - edges.min())
        axes.set_ylim(middle - _MARGIN * half, middle + _MARGIN * half)
