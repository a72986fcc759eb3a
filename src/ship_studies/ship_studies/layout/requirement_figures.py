"""Figures of the requirement: admissible directions of sensors, effect of elevation, obstructions.

Only ``figures`` imports this module, because matplotlib loads slowly.
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MultipleLocator

from ship_geometry.rotations import FloatArray
from ship_node.pages.figure_files import legend_below
from ship_stars.sky.deck_masks import DeckMasks
from ship_studies.layout.allocation import requirement_use
from ship_studies.layout.installation_model import SHIP_ANGLES
from ship_studies.layout.joint_error import Layout
from ship_studies.layout.requirement import AdmissibleMap, RequirementResult
from ship_studies.layout.study import LayoutStudy

GIVEN, BEST = "#0b3c6f", "#c1440e"
# Readable in print and for the colour-blind (Okabe and Ito, 2008).
ANGLE_STYLES = (("#0072b2", "-"), ("#d55e00", "--"), ("#009e73", "-."))
_ADMISSIBLE, _TOO_NEAR, _MASK = "#a6dcc4", "#d9d9d9", "0.35"
_USES = (0.5, 0.7, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0)
_MAX_USE = 3.0


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
