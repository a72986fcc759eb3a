"""Figures of a fit. Only the command imports this module, because matplotlib takes longer to load than the fit."""

from collections.abc import Iterator
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.figure_files import legend_below
from ship_studies.axis_fit.robust_fit import AxisFit, rms
from ship_studies.axis_fit.sightings import Sightings, azimuth_and_elevation

_GOOD, _OUTLIER = "#0b3c6f", "#c1440e"
_HALO = (withStroke(linewidth=3.0, foreground="white"),)
_SIDES = ("to the right", "up")
_ROOM = 1.12
"""Ratio of the axis limit to the farthest point."""
_STEEP = 20.0
"""Ratio above which residuals without and with the model get separate scales, and a term's value lies off the scale."""
_ARROW = 0.05
"""Length of the arrow for a residual as large as ``AxisFit.scale``, in radii of the sky."""
_ARROW_LOOK: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.003, "zorder": 3}
_CORRELATION_COLOURS = "RdBu_r"
_DARK_CELL = 0.6
"""Correlation above which a cell is dark, so that its number is white."""


def fit_figures(fit: AxisFit, sightings: Sightings) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of every figure of the fit."""
    yield "residuals", _before_and_after(fit, sightings)
    yield "over_angles", _over_angles(fit, sightings)
    yield "sky", _sky(fit, sightings)
    yield "terms", _terms(fit)


def _before_and_after(fit: AxisFit, sightings: Sightings) -> Figure:
    """Return the figure of residuals without and with the model, on one scale unless their ratio exceeds _STEEP."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 6.6), layout="compressed")
    limits = [_ROOM * float(np.max(np.abs(part))) / ARCSEC for part in (fit.before, fit.residuals)]
    if limits[0] < _STEEP * limits[1]:
        limits = [max(limits)] * 2
    words = ("without a model", f"with {len(fit.fitted)} fitted terms")
    for axes, residuals, title, limit in zip(panels, (fit.before, fit.residuals), words, limits, strict=True):
        circle = np.linspace(0.0, 2.0 * np.pi, 181)
        radius = rms(residuals) / ARCSEC
        axes.plot(radius * np.cos(circle), radius * np.sin(circle), color="0.4", ls="--", lw=1.2, label="RMS")
        _draw_points(axes, residuals[:, 0] / ARCSEC, residuals[:, 1] / ARCSEC, fit.outliers)
        axes.set(title=f"{title}: RMS {radius:.1f}″", xlabel=f"{_SIDES[0]} [″]", aspect="equal")
        axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
        # Long numbers need room.
        axes.xaxis.set_major_locator(MaxNLocator(8 if limit < 1000.0 else 4))
        axes.axhline(0.0, color="0.6", lw=0.8, zorder=1)
        axes.axvline(0.0, color="0.6", lw=0.8, zorder=1)
        _name_outliers(axes, residuals / ARCSEC, fit.outliers, sightings.labels)
    panels[0].set_ylabel(f"{_SIDES[1]} [″]")
    legend_below(figure, panels[0])
    figure.suptitle("True direction minus the model's, on the sky")
    return figure


def _over_angles(fit: AxisFit, sightings: Sightings) -> Figure:
    """Return the figure of the residuals over both angles; a missing term appears as a bend or a wave."""
    azimuth_deg, elevation_deg = np.rad2deg(azimuth_and_elevation(sightings.direction_d))
    residuals = fit.residuals / ARCSEC
    limit = _ROOM * max(float(np.max(np.abs(residuals[~fit.outliers]), initial=0.0)), 3.5 * fit.scale / ARCSEC)
    figure, grid = plt.subplots(2, 2, figsize=(11, 6.6), sharex="col", sharey=True, layout="constrained")
    angles = ((elevation_deg, "elevation [°]", 15.0), (azimuth_deg, "azimuth [°]", 45.0))
    for side, row in enumerate(grid):
        for axes, (angle_deg, _, tick_deg) in zip(row, angles, strict=True):
            axes.axhspan(-fit.scale / ARCSEC, fit.scale / ARCSEC, color="#bcd4ea", label="±1σ of a sighting")
            shown = np.clip(residuals[:, side], -limit, limit)
            _draw_points(axes, angle_deg, shown, fit.outliers)
            _draw_beyond(axes, angle_deg, residuals[:, side], limit)
            axes.xaxis.set_major_locator(MultipleLocator(tick_deg))
            axes.set_ylim(-limit, limit)
        row[0].set_ylabel(f"{_SIDES[side]} [″]")
    for axes, (_, words, _) in zip(grid[-1], angles, strict=True):
        axes.set_xlabel(words)
    legend_below(figure, grid[0, 0])
    figure.suptitle("Residuals of the fitted model")
    return figure


def _sky(fit: AxisFit, sightings: Sightings) -> Figure:
    """Return the figure of the sightings on the sky, the zenith in the middle, with residuals as arrows."""
    figure, axes = plt.subplots(figsize=(7.2, 7.2), layout="constrained")
    azimuth, elevation = azimuth_and_elevation(sightings.direction_d)
    lowest_deg = min(0.0, 15.0 * np.floor(np.rad2deg(elevation.min()) / 15.0))
    _draw_sky(axes, lowest_deg)
    outward = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    clockwise = np.stack([np.cos(azimuth), -np.sin(azimuth)], axis=-1)
    place = ((90.0 - np.rad2deg(elevation)) / (90.0 - lowest_deg))[:, None] * outward
    arrow = (fit.residuals[:, :1] * clockwise - fit.residuals[:, 1:] * outward) * _ARROW / fit.scale
    for part, colour in ((~fit.outliers, _GOOD), (fit.outliers, _OUTLIER)):
        axes.quiver(*place[part].T, *arrow[part].T, color=colour, **_ARROW_LOOK)
    _draw_points(axes, place[:, 0], place[:, 1], fit.outliers)
    _name_outliers(axes, place + arrow, fit.outliers, sightings.labels)
    axes.quiver(-1.1, -1.12, 3.0 * _ARROW, 0.0, color="0.25", **_ARROW_LOOK)
    axes.text(-1.1 + 3.4 * _ARROW, -1.12, f"{3.0 * fit.scale / ARCSEC:.0f}″ (3σ)", va="center")
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal")
    axes.axis("off")
    axes.set_title("Sightings on the sky, and residuals of the fitted model")
    axes.legend(loc="lower right")
    return figure


def _terms(fit: AxisFit) -> Figure:
    """Return the figure of the fitted terms with their sigmas and correlations."""
    count = len(fit.fitted)
    figure, (bars, matrix) = plt.subplots(1, 2, figsize=(12, 1.8 + 0.6 * count), layout="constrained")
    rows = np.arange(count)
    values = np.array([getattr(fit.errors, name) for name in fit.fitted]) / ARCSEC
    sigmas = fit.sigmas / ARCSEC
    others = (np.abs(values) + sigmas)[~np.isin(fit.fitted, ["g", "h"])]
    shown = np.abs(values) < _STEEP * np.max(others) if len(others) else np.full(count, True)
    bars.axvline(0.0, color="0.4", lw=1)
    lengths = 2.0 * sigmas[shown] if fit.sigmas_known else None
    bars.errorbar(values[shown], rows[shown], xerr=lengths, fmt="o", color=_GOOD, capsize=4)
    for row, value, sigma, inside in zip(rows, values, sigmas, shown, strict=True):
        uncertainty = f"± {sigma:.1f}″" if fit.sigmas_known else "″, σ unknown"
        text = f"{value:.1f} {uncertainty}".replace("-", "−").replace(" ″", "″")
        text += "" if inside else " (off the scale)"
        place = (value if inside else 0.0, row)
        bars.annotate(text, place, xytext=(0, 9), textcoords="offset points", ha="center", size=10)
    bars.set(yticks=rows, yticklabels=fit.fitted, ylim=(count - 0.5, -0.7), xlabel="[″]")
    bars.set_title("Fitted terms, ±2σ" if fit.sigmas_known else "Fitted terms, σ unknown")

    correlation = fit.correlation
    matrix.imshow(correlation, cmap=_CORRELATION_COLOURS, vmin=-1.0, vmax=1.0, aspect="auto")
    for i, j in np.ndindex(correlation.shape):
        colour = "white" if abs(correlation[i, j]) > _DARK_CELL else "black"
        text = f"{round(float(correlation[i, j]), 2) + 0.0:.2f}".replace("-", "−")
        matrix.text(j, i, text, ha="center", va="center", color=colour, size=10)
    matrix.set(xticks=rows, xticklabels=fit.fitted, yticks=rows, yticklabels=fit.fitted, title="Correlation")
    matrix.grid(visible=False)
    return figure


def _draw_points(axes: Axes, x: FloatArray, y: FloatArray, outliers: NDArray[np.bool_]) -> None:
    axes.plot(x[~outliers], y[~outliers], "o", color=_GOOD, ms=4, label="sighting")
    if np.any(outliers):
        axes.plot(x[outliers], y[outliers], "D", color=_OUTLIER, ms=6, label="outlier, with its number", zorder=4)


def _draw_beyond(axes: Axes, x: FloatArray, y: FloatArray, limit: float) -> None:
    """Write the values of points that exceed the limit and were drawn at the edge."""
    for number in np.flatnonzero(np.abs(y) > limit):
        axes.annotate(
            f"{y[number]:+.0f}″".replace("-", "−"), (x[number], np.clip(y[number], -limit, limit)),
            xytext=(0, -18 if y[number] > 0.0 else 9), textcoords="offset points", color=_OUTLIER, ha="center",
        )  # fmt: skip


def _name_outliers(axes: Axes, places: FloatArray, outliers: NDArray[np.bool_], labels: tuple[str, ...]) -> None:
    for number in np.flatnonzero(outliers):
        axes.annotate(
            labels[number], (places[number, 0], places[number, 1]), xytext=(0, -8), textcoords="offset points",
            color=_OUTLIER, weight="bold", ha="center", va="top", path_effects=_HALO, zorder=5,
        )  # fmt: skip


def _draw_sky(axes: Axes, lowest_deg: float) -> None:
    """Draw circles of elevation and rays of azimuth, clockwise from the top."""
    circle = np.linspace(0.0, 2.0 * np.pi, 181)
    for elevation_deg in np.arange(lowest_deg, 90.0, 15.0):
        radius = (90.0 - elevation_deg) / (90.0 - lowest_deg)
        axes.plot(radius * np.sin(circle), radius * np.cos(circle), color="0.82", lw=1, zorder=1)
        axes.text(0.0, radius, f"{elevation_deg:g}°", color="0.35", size=9, ha="center", va="center", zorder=2,
                  bbox={"facecolor": "white", "edgecolor": "none", "pad": 1})  # fmt: skip
    for azimuth_deg in range(0, 360, 30):
        ray = np.array([np.sin(np.deg2rad(azimuth_deg)), np.cos(np.deg2rad(azimuth_deg))])
        axes.plot(*np.outer(ray, [0.0, 1.0]), color="0.9", lw=1, zorder=1)
        axes.text(1.08 * ray[0], 1.08 * ray[1], f"{azimuth_deg}°", ha="center", va="center")
