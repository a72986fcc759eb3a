"""Figures of a layout study: layouts, scans, maps, the six figures of [Z14], and the figures of the requirement.

The command imports this module only when it draws, because matplotlib loads slowly.
"""

from collections.abc import Iterator
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import FixedLocator, MultipleLocator, NullFormatter, ScalarFormatter

from ship_geometry.rotations import FloatArray
from ship_node.pages.figure_files import legend_below
from ship_stars.sky.deck_masks import DeckMasks
from ship_studies.layout.error_budget import ErrorMap, Layout, requirement_use, total_arcsec
from ship_studies.layout.installation_model import SHIP_ANGLES, SWEEPS, Curve, InstallationConvention, Sweep
from ship_studies.layout.requirement import AdmissibleMap, RequirementResult
from ship_studies.layout.study import AzimuthScan, LayoutStudy

GIVEN, BEST = "#0b3c6f", "#c1440e"
# Readable in print and for the colour-blind (Okabe and Ito, 2008).
ANGLE_STYLES = (("#0072b2", "-"), ("#d55e00", "--"), ("#009e73", "-."))
_ADMISSIBLE, _TOO_NEAR, _MASK = "#a6dcc4", "#d9d9d9", "0.35"
_USES = (0.5, 0.7, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0)
_MAX_USE = 3.0

_ARCSEC_TICKS = (1, 2, 3, 4, 5, 7, 10, 20, 30, 50, 100, 200, 300, 500, 1000)
_FEW_LINES = (1, 3, 10, 30, 100, 300, 1000)
_MORE_LINES = (1, 2, 3, 4, 5, 6, 8, 10, 30, 100, 300, 1000)
# Ratio of the largest to the smallest value of a panel above which fewer lines are drawn.
_STEEP_RATIO = 25.0

_MERGE_DISTANCE = 0.15
"""Distance of arrow tips below which their numbers share one place, in radii of the plan."""
_NUMBER_OFFSET = 0.2
"""Distance from a tip to its number, in lengths of the arrow."""

_SYMBOLS = ("dK", "dψ", "dθ")
_READING_TITLES = {InstallationConvention.PHYSICAL: "physical convention", InstallationConvention.PAPER: "as in [Z14]"}
# Wide pale curves lie below narrow dark curves, so that coinciding curves are both visible. Blue: ahead or astern;
# orange: abeam.
_CURVE_STYLES = {
    0.0: ("#8fbfe6", "-", 5.0),
    90.0: ("#fbb982", "-", 5.0),
    180.0: ("#08306b", "--", 1.8),
    270.0: ("#a63603", ":", 2.2),
}
_ONLY_COLOUR = "#0b3c6f"
_MARGIN = 0.08


def admissible_figure(study: LayoutStudy, required: RequirementResult) -> Figure:
    """Return the figure of each sensor's admissible directions, other sensors as given, with masks and horizon."""
    count = len(required.maps)
    figure, grid = plt.subplots(count, 1, figsize=(9.5, 3.9 * count + 0.8), squeeze=False, layout="constrained")
    for number, (allowed, axes) in enumerate(zip(required.maps, grid[:, 0], strict=True)):
        _draw_admissible(axes, study, allowed, number)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    handles += [Patch(color=_ADMISSIBLE), Patch(color=_TOO_NEAR)]
    labels += ["requirement met, field clear", "field in a mask or too near to the horizon"]
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle("Requirement use of the worst angle: 1σ / requirement")
    return figure


def _draw_admissible(axes: Axes, study: LayoutStudy, allowed: AdmissibleMap, number: int) -> None:
    moved = study.maps[number]
    directions = moved.azimuths_deg, moved.elevations_deg
    blocked = ~(allowed.is_clear & allowed.is_above_horizon)
    for region, colour in ((blocked, _TOO_NEAR), (allowed.is_admissible(), _ADMISSIBLE)):
        shown = np.ma.masked_where(~region, np.ones(region.shape))
        axes.pcolormesh(*directions, shown, cmap=ListedColormap([colour]), shading="nearest", rasterized=True)
    lines = axes.contour(
        *directions,
        allowed.requirement_use,
        _USES,
        colors="black",
        linewidths=[1.8 if u == 1.0 else 0.6 for u in _USES],
    )
    axes.clabel(lines, fmt=lambda use: f"{100.0 * use:.0f} %", fontsize=9)
    draw_masks(axes, study.obstructions.masks)
    mark_sensors(axes, study.layout, number)
    axes.xaxis.set_major_locator(MultipleLocator(30.0))
    axes.set(
        title=f"Sensor “{allowed.sensor}” anywhere" + (", the others as given" if len(study.layout.names) > 1 else ""),
        xlabel="azimuth from the bow [°]",
        ylabel="elevation above the deck [°]",
        xlim=(0.0, 360.0),
        ylim=(moved.elevations_deg[0], moved.elevations_deg[-1]),
    )


def elevation_figure(required: RequirementResult) -> Figure:
    """Return the figure of the requirement use over elevation, for all errors and for refraction alone.

    Errors are large at low elevations due to refraction, and at high elevations due to nearly parallel boresights.
    """
    elevations_deg = np.array([one.elevation_deg for one in required.trade])
    figure, axes = plt.subplots(figsize=(8.5, 4.6), layout="constrained")
    sigmas = np.array([one.candidate.sigmas_arcsec for one in required.trade])
    refraction = np.array([one.refraction_arcsec for one in required.trade])
    for angle in np.flatnonzero(np.isfinite(required.limits_arcsec)):
        colour, line = ANGLE_STYLES[angle]
        use = sigmas[:, angle] / required.limits_arcsec[angle]
        axes.plot(elevations_deg, use, color=colour, ls=line, lw=1.8, label=SHIP_ANGLES[angle])
    by_refraction = requirement_use(refraction, required.limits_arcsec)
    axes.plot(elevations_deg, by_refraction, color="0.5", lw=1.8, ls=":", label="refraction only")
    axes.axhline(1.0, color="black", lw=1.3, label="requirement")
    _shade_blocked(axes, elevations_deg, np.array([bool(one.candidate.obstacles) for one in required.trade]))
    axes.set(
        xlim=(elevations_deg[0], elevations_deg[-1]),
        ylim=(0.0, _MAX_USE),
        xlabel="elevation of all sensors above the deck [°]",
        ylabel="requirement use: 1σ / requirement",
        title="All sensors at one elevation, at their best azimuths",
    )
    legend_below(figure, axes, 3)
    return figure


def _shade_blocked(axes: Axes, elevations_deg: FloatArray, blocked: FloatArray) -> None:
    half = 0.5 * (elevations_deg[1] - elevations_deg[0])
    for number, elevation_deg in enumerate(elevations_deg[blocked]):
        label = "field in a mask or too near to the horizon" if number == 0 else None
        axes.axvspan(elevation_deg - half, elevation_deg + half, color=_TOO_NEAR, lw=0.0, zorder=0, label=label)


def draw_masks(axes: Axes, masks: DeckMasks) -> None:
    """Draw masks into a map over azimuth and elevation (deg), repeated at azimuths shifted by 360°."""
    look: dict[str, Any] = {"facecolor": "none", "edgecolor": _MASK, "hatch": "////", "lw": 1.2, "zorder": 3}
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for name, corners in zip(masks.names, masks.corners, strict=True):
        for turn_deg in (-720.0, -360.0, 0.0, 360.0):
            places = np.rad2deg(corners) + np.array([turn_deg, 0.0])
            if places[:, 0].max() < 0.0 or places[:, 0].min() > 360.0:
                continue
            axes.add_patch(Polygon(places, **look))
            middle = np.clip(places, [0.0, low], [360.0, high]).mean(axis=0)
            axes.text(middle[0], middle[1], name, ha="center", va="center", clip_on=True, zorder=4,
                      bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0})  # fmt: skip
    axes.set(xlim=(left, right), ylim=(low, high))


def mark_sensors(axes: Axes, layout: Layout, moved: int) -> None:
    """Mark the sensors' boresights in a map; the moved sensor as a star."""
    directions_deg = np.rad2deg(layout.angles[:, :2]) % 360.0
    others = np.delete(directions_deg, moved, axis=0)
    look: dict[str, Any] = {"ls": "", "markeredgecolor": "white", "clip_on": False, "zorder": 5}
    axes.plot(*directions_deg[moved], "*", ms=17, color=GIVEN, label="the sensor as given", **look)
    if others.size:
        axes.plot(others[:, 0], others[:, 1], "o", ms=10, color=BEST, label="other sensors", **look)


def study_figures(study: LayoutStudy) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of every figure of the study."""
    yield "layout", plan_figure(study.layout, study.best)
    yield "azimuth", _scan_figure(study)
    for number, moved in enumerate(study.maps):
        yield f"map_{moved.sensor}", _map_figure(moved, study, number)
    if study.requirement_result is not None:
        yield "requirement", admissible_figure(study, study.requirement_result)
        yield "elevation", elevation_figure(study.requirement_result)
    yield from sweep_figures(study.curves)


def sweep_figures(curves: list[Curve]) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure of the six figures of [Z14], each in both conventions, from the curves of all figures."""
    for sweep in SWEEPS:
        yield f"figure_{sweep.number}", _sweep_figure(sweep, [curve for curve in curves if curve.sweep is sweep])


def plan_figure(given: Layout, best: Layout) -> Figure:
    """Return the plan of the boresights from above; arrows of higher elevations are shorter."""
    figure, axes = plt.subplots(figsize=(6.2, 6.5 + 0.25 * len(given.names)), layout="constrained")
    _draw_hull(axes)
    circle = np.linspace(0.0, 2.0 * np.pi, 181)
    axes.plot(np.sin(circle), np.cos(circle), color="0.6", lw=1)
    for azimuth_deg in range(0, 360, 30):
        azimuth = np.deg2rad(azimuth_deg)
        axes.plot(*np.outer([np.sin(azimuth), np.cos(azimuth)], [0.97, 1.0]), color="0.6", lw=1)
        axes.text(1.09 * np.sin(azimuth), 1.09 * np.cos(azimuth), f"{azimuth_deg}°", ha="center", va="center")
    moved = not np.array_equal(given.angles, best.angles)
    tips = [_draw_boresight(axes, angles, GIVEN, "-") for angles in given.angles]
    _number_boresights(axes, tips, GIVEN, 1.0 + _NUMBER_OFFSET)
    if moved:
        tips = [_draw_boresight(axes, angles, BEST, "--") for angles in best.angles]
        _number_boresights(axes, tips, BEST, 1.0 - _NUMBER_OFFSET)
    axes.plot([], [], color=GIVEN, lw=2.2, label="as given")
    if moved:
        axes.plot([], [], color=BEST, ls="--", lw=2.2, label="recommended")
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal", title="Boresights seen from above, bow up")
    axes.set_axis_off()
    for number, name in enumerate(given.names, start=1):
        azimuth_deg, elevation_deg = np.rad2deg(given.angles[number - 1, :2])
        turned = f", recommended {np.rad2deg(best.angles[number - 1, 0]) % 360.0:.0f}°" if moved else ""
        axes.plot([], [], ls="", label=f"{number} {name}: {azimuth_deg:.0f}°, {elevation_deg:.0f}° up{turned}")
    legend_below(figure, axes, 1)
    return figure


def _draw_boresight(axes: Axes, angles: FloatArray, colour: str, line: str) -> tuple[float, float]:
    """Draw an arrow in the plan; return its tip."""
    tip = (float(np.cos(angles[1]) * np.sin(angles[0])), float(np.cos(angles[1]) * np.cos(angles[0])))
    look = {"arrowstyle": "-|>,head_width=0.35,head_length=0.7", "color": colour, "lw": 2.2, "ls": line}
    axes.annotate("", tip, (0.0, 0.0), arrowprops={**look, "shrinkA": 0, "shrinkB": 0})
    return tip


def _number_boresights(axes: Axes, tips: list[tuple[float, float]], colour: str, reach: float) -> None:
    """Write the sensors' numbers at the tips; tips that are too near to each other share one place."""
    places: list[tuple[tuple[float, float], list[str]]] = []
    for number, tip in enumerate(tips, start=1):
        near = [
            numbers for place, numbers in places if np.hypot(place[0] - tip[0], place[1] - tip[1]) < _MERGE_DISTANCE
        ]
        if near:
            near[0].append(str(number))
        else:
            places.append((tip, [str(number)]))
    for place, numbers in places:
        axes.text(
            reach * place[0], reach * place[1], ", ".join(numbers),
            color=colour, weight="bold", ha="center", va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
        )  # fmt: skip


def _draw_hull(axes: Axes) -> None:
    side = np.array([[0.0, 0.62], [0.07, 0.45], [0.12, 0.25], [0.13, -0.1], [0.12, -0.5], [0.09, -0.58]])
    outline = np.concatenate([side, side[::-1] * [-1.0, 1.0]])
    axes.fill(outline[:, 0], outline[:, 1], facecolor="0.93", edgecolor="0.5")


def _scan_figure(study: LayoutStudy) -> Figure:
    count = len(study.scans)
    figure, grid = plt.subplots(count, 1, figsize=(8.5, 3.8 * count + 0.5), squeeze=False, layout="constrained")
    for turned, axes in zip(study.scans, grid[:, 0], strict=True):
        _draw_scan(axes, turned, study)
    if len(study.layout.names) > 1:
        figure.suptitle(f"Sensor “{study.layout.names[0]}” keeps its azimuth")
    legend_below(figure, grid[0, 0])
    return figure


def _draw_scan(axes: Axes, turned: AzimuthScan, study: LayoutStudy) -> None:
    number = study.layout.names.index(turned.sensor)
    own_deg, best_deg = (np.rad2deg(layout.angles[number, 0]) % 360.0 for layout in (study.layout, study.best))
    for column, (colour, line) in enumerate(ANGLE_STYLES):
        sigmas_arcsec = turned.sigmas_arcsec[:, column]
        axes.plot(turned.azimuths_deg, sigmas_arcsec, color=colour, ls=line, lw=1.8, label=SHIP_ANGLES[column])
    axes.plot(turned.azimuths_deg, total_arcsec(turned.sigmas_arcsec), color="black", lw=2.6, label="total")
    axes.axvline(own_deg, color=GIVEN, lw=1.3, label="as given")
    if len(study.layout.names) > 1:
        axes.axvline(best_deg, color=BEST, lw=1.3, ls="--", label="recommended")
    axes.set_yscale("log")
    _arcsec_ticks(axes)
    axes.xaxis.set_major_locator(MultipleLocator(30.0))
    others = "" if len(study.layout.names) == 1 else ", the others at their recommended azimuths"
    axes.set(
        xlim=(0.0, 360.0),
        xlabel=f"azimuth of sensor “{turned.sensor}” from the bow [°]",
        ylabel="attitude error of the ship, 1σ [″]",
        title=f"Rotating sensor “{turned.sensor}” in azimuth{others}",
    )


def _arcsec_ticks(axes: Axes) -> None:
    axes.yaxis.set_major_locator(FixedLocator(_ARCSEC_TICKS))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())


def _map_figure(moved: ErrorMap, study: LayoutStudy, number: int) -> Figure:
    layout = study.layout
    panels = [*np.moveaxis(moved.sigmas_arcsec, -1, 0), total_arcsec(moved.sigmas_arcsec)]
    low, high = np.nanmin(panels), np.nanmax(panels)
    levels = np.geomspace(low * 0.999, max(high, low * 1.05) * 1.001, 25)
    figure, grid = plt.subplots(2, 2, figsize=(11, 6.6), sharex=True, sharey=True, layout="constrained")
    for axes, values, title in zip(grid.flat, panels, (*SHIP_ANGLES, "total"), strict=True):
        filled = axes.contourf(
            moved.azimuths_deg, moved.elevations_deg, values, levels, norm=LogNorm(levels[0], levels[-1]), cmap="YlOrBr"
        )
        least, most = np.nanmin(values), np.nanmax(values)
        # A line too near to the least value would be fragmented and is not drawn.
        lines = [
            line for line in (_FEW_LINES if most > _STEEP_RATIO * least else _MORE_LINES) if 1.02 * least < line < most
        ]
        drawn = axes.contour(moved.azimuths_deg, moved.elevations_deg, values, lines, colors="black", linewidths=0.7)
        axes.clabel(drawn, fmt="%g″", fontsize=9)
        draw_masks(axes, study.obstructions.masks)
        mark_sensors(axes, layout, number)
        axes.set_title(f"{title} [″]")
        axes.xaxis.set_major_locator(MultipleLocator(60.0))
    for axes in grid[-1]:
        axes.set_xlabel("azimuth from the bow [°]")
    for axes in grid[:, 0]:
        axes.set_ylabel("elevation above the deck [°]")
    colours = figure.colorbar(filled, ax=grid, shrink=0.8, label="attitude error of the ship, 1σ [″]")
    colours.set_ticks([tick for tick in _ARCSEC_TICKS if levels[0] <= tick <= levels[-1]])
    colours.ax.yaxis.set_major_formatter(ScalarFormatter())
    colours.ax.minorticks_off()
    figure.suptitle(
        f"Mounting sensor “{moved.sensor}” anywhere" + (", the others as given" if len(layout.names) > 1 else "")
    )
    legend_below(figure, grid[0, 0])
    return figure


# -- the six figures of [Z14] ---------------------------------------------------------------------------------


def _sweep_figure(sweep: Sweep, curves: list[Curve]) -> Figure:
    """Return one figure: three errors side by side, the physical convention above that of [Z14]."""
    figure, grid = plt.subplots(2, 3, figsize=(12, 6.6), sharex=True, layout="constrained")
    for row, (reading, words) in zip(grid, _READING_TITLES.items(), strict=True):
        drawn = [curve for curve in curves if curve.convention is reading]
        for column, axes in enumerate(row):
            for curve in drawn:
                _draw_curve(axes, curve, column)
            _set_limits(axes, [curve.errors_arcsec[:, column] for curve in drawn])
            axes.set_title(f"{SHIP_ANGLES[column]} {_SYMBOLS[column]}, {words}")
            axes.set_xlim(*sweep.range_deg)
            axes.xaxis.set_major_locator(MultipleLocator(90.0 if sweep.range_deg[1] > 90.0 else 30.0))
        row[0].set_ylabel("error [″]")
    for axes in grid[-1]:
        axes.set_xlabel(f"{sweep.symbol}, {sweep.meaning} [°]")
    errors = "all six errors, added with their signs" if sweep.all_errors else "error of the sensor's roll γs only"
    figure.suptitle(f"Figure {sweep.number} of [Z14]: {errors}, over {sweep.symbol}")
    if len(curves) > len(InstallationConvention):
        legend_below(figure, grid[0, 0])
    return figure


def _draw_curve(axes: Axes, curve: Curve, column: int) -> None:
    values = curve.errors_arcsec[:, column]
    if curve.azimuth_deg is None:
        axes.plot(curve.swept_deg, values, color=_ONLY_COLOUR, lw=2.2, label="error")
        return
    colour, line, width = _CURVE_STYLES[curve.azimuth_deg]
    axes.plot(curve.swept_deg, values, color=colour, ls=line, lw=width, label=f"A0 = {curve.azimuth_deg:g}°")


def _set_limits(axes: Axes, series: list[FloatArray]) -> None:
    """Set limits that contain zero and omit errors that grow without bound near a pitch of ±90°."""
    values = np.concatenate(series)
    values = values[np.isfinite(values)]
    size = np.abs(values)
    most = max(4.0 * float(np.median(size)), float(np.percentile(size, 80.0)), 1.0)
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    low, high = max(low, -most), min(high, most)
    margin = _MARGIN * max(high - low, 1.0)
    axes.set_ylim(low - margin, high + margin)
