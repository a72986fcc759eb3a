"""The layout study as one self-contained HTML page for the naval architect: text, tables, embedded figures.

A requirement has a section of its own: ranking, admissible directions, maximum size of each error.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_node.pages.html_page import decimal_text, render
from ship_studies.layout.config import LayoutSensor
from ship_studies.layout.error_budget import total_arcsec
from ship_studies.layout.field_of_view import PERCENTILES
from ship_studies.layout.installation_model import (
    CURVE_AZIMUTHS_DEG,
    SOURCES,
    SWEEPS,
    InstallationConvention,
    source_errors_arcsec,
)
from ship_studies.layout.requirement import RequirementResult
from ship_studies.layout.requirement_text import binding_error_text, limits_text, nearest_miss_text, placements_text
from ship_studies.layout.study import AzimuthScan, LayoutStudy

_READING_NAMES = {
    InstallationConvention.PHYSICAL: "physical: R(A0, E0, γ0) rotates the sensor's axes into the deck's",
    InstallationConvention.PAPER: "as computed in [Z14]: R(A0, E0, γ0) rotates the deck's axes into the sensor's",
}

_WORTH_MOVING = 0.1
"""Relative reduction of the total error below which moving the sensors is not worthwhile."""


def requirement_values(required: RequirementResult) -> dict[str, Any]:
    """Return the values for the section of the page."""
    return {
        "limits": limits_text(required, "″"),
        "nearest_miss": "" if required.is_met else nearest_miss_text(required),
        "placements": placements_text,
        "ranking": [
            [
                one.name,
                "yes" if one.is_admissible else "no",
                "–" if np.isnan(one.requirement_use) else f"{100.0 * one.requirement_use:.1f} %",
                *one.sigmas_arcsec,
                placements_text(one.layout),
                "; ".join(one.obstacles),
            ]
            for one in required.ranking
        ],
        "best_elevation": _best_elevation(required),
        "allocations": list(_allocations(required)),
    }


def _best_elevation(required: RequirementResult) -> str:
    free = [one for one in required.trade if not one.candidate.obstacles and np.isfinite(one.candidate.requirement_use)]
    if not free:
        return "At no elevation are the fields of all sensors clear."
    best = min(free, key=lambda one: one.candidate.requirement_use)
    met = [one.elevation_deg for one in free if one.candidate.is_admissible]
    between = f"elevations that meet the requirement: {met[0]:g}° to {met[-1]:g}°" if met else "no elevation meets it"
    return f"The use is least with all sensors at {best.elevation_deg:g}°; {between}."


def _allocations(required: RequirementResult) -> Iterator[tuple[str, str, str, list[list[Any]]]]:
    """Yield name, dominant error, shares by kind and table of each layout."""
    for name, allocations in required.allocations.items():
        kinds: dict[str, float] = {}
        for row in allocations:
            kinds[row.kind] = kinds.get(row.kind, 0.0) + row.share
        by_kind = sorted(kinds.items(), key=lambda k: -k[1])
        kinds_text = ", ".join(f"{kind} {100.0 * share:.1f} %" for kind, share in by_kind)
        rows = [
            [row.key, row.kind, row.sigma_arcsec, f"{100.0 * row.share:.1f} %", row.together_arcsec,
             _alone_text(row.alone_arcsec)]
            for row in allocations
        ]  # fmt: skip
        yield name, binding_error_text(allocations), kinds_text, rows


def _alone_text(alone_arcsec: float) -> str:
    if np.isnan(alone_arcsec):
        return "not achievable even at 0″"
    return "any size" if np.isinf(alone_arcsec) else decimal_text(alone_arcsec)


def page_text(study: LayoutStudy, figures: Mapping[str, Path], title: str) -> str:
    """Return the page.

    Args:
        study: the study that the page shows.
        figures: PNG files by name, which the page embeds.
        title: title of the study, for the heading.
    """
    given_deg, best_deg = (np.rad2deg(layout.angles[:, 0]) % 360.0 for layout in (study.layout, study.best))
    return render(
        Path(__file__).with_name("page.html.j2"),
        title=title,
        study=study,
        figures=figures,
        result=_result(study),
        joined=len(study.layout.names),
        given_deg=given_deg,
        best_deg=best_deg,
        tolerance=_tolerance_text,
        gain=_gain_text(float(total_arcsec(study.joint_arcsec)), float(total_arcsec(study.best_arcsec))),
        rule_in_numbers=_rule_in_numbers(study),
        layouts=list(_layouts(study)),
        sensors=[
            [name, _triple_text(sensor, ""), _triple_text(sensor, "installation_")]
            for name, sensor in study.config.sensors.items()
        ],
        percentiles=[f">in {percent} %" for percent in PERCENTILES],
        optics=list(_optics(study)),
        budget=[
            *([one.sensor, one.source, f"{one.sigma_arcsec:g}", *one.errors_arcsec] for one in study.budget),
            ["all", "root sum of squares", "", *study.joint_arcsec],
        ],
        point=_operating_point(study),
        azimuths=[(f"A0 = {azimuth_deg:g}°", 3) for azimuth_deg in CURVE_AZIMUTHS_DEG],
        sources=[(words, _sources(study, reading)) for reading, words in _READING_NAMES.items()],
        sweeps=[sweep.number for sweep in SWEEPS],
        required=study.requirement_result,
        **({} if study.requirement_result is None else requirement_values(study.requirement_result)),
    )


def _layouts(study: LayoutStudy) -> Iterator[list[Any]]:
    for name, angles, sigmas in zip(study.layout.names, study.layout.angles, study.alone_arcsec, strict=True):
        azimuth_deg, elevation_deg, _ = np.rad2deg(angles)
        where = [f"{azimuth_deg % 360.0:g}°", f"{elevation_deg:g}°"]
        yield [f"{name} alone", *where, *sigmas, total_arcsec(sigmas)]
    yield ["all, as given", "", "", *study.joint_arcsec, total_arcsec(study.joint_arcsec)]
    if len(study.layout.names) > 1:
        yield ["all, at the recommended azimuths", "", "", *study.best_arcsec, total_arcsec(study.best_arcsec)]


def _triple_text(sensor: LayoutSensor, kind: str) -> str:
    return " / ".join(f"{getattr(sensor, f'{kind}sigma_{axis}_arcsec'):g}" for axis in ("forward", "up", "right"))


def _optics(study: LayoutStudy) -> Iterator[list[Any]]:
    for name, found in study.optics.items():
        field = f"{found.field_deg[0]:.1f}° × {found.field_deg[1]:.1f}°"
        stars = [f"{found.stars.mean():.1f}", *(f"{count:.0f}" for count in found.star_count_percentiles().values())]
        share = f"{100.0 * study.config.optics[name].sky_share:g} %"
        sigmas = [" / ".join(map(decimal_text, triple)) for triple in (found.quantile_arcsec, found.liebe_arcsec)]
        yield [name, field, float(found.star_sigma_arcsec), *stars, share, *sigmas]


def _operating_point(study: LayoutStudy) -> str:
    point = study.config.figures
    sizes = [*point.star_errors_arcsec(), *point.installation_errors_arcsec()]
    errors = ", ".join(f"{source} {size:g}″" for source, size in zip(SOURCES, sizes, strict=True))
    return (
        f"As {point.star_azimuth_deg:g}°, Es {point.star_elevation_deg:g}°, γs {point.star_roll_deg:g}°, "
        f"E0 {point.elevation_deg:g}°, γ0 {point.roll_deg:g}°; errors {errors}"
    )


def _sources(study: LayoutStudy, reading: InstallationConvention) -> list[list[Any]]:
    point = study.config.figures
    errors = np.concatenate(
        [source_errors_arcsec(point, azimuth_deg, reading) for azimuth_deg in CURVE_AZIMUTHS_DEG], axis=1
    )
    sizes = [*point.star_errors_arcsec(), *point.installation_errors_arcsec()]
    rows: list[list[Any]] = [
        [f"{source} = {size:g}″", *row] for source, size, row in zip(SOURCES, sizes, errors, strict=True)
    ]
    return [*rows, ["all, with signs", *errors.sum(axis=0)]]


# -- texts, with every number computed from the layout ---------------------------------------------------------


def _result(study: LayoutStudy) -> str:
    """Return a sentence on the accuracy of the layout as given."""
    count = len(study.layout.names)
    if count == 1:
        return f"The one sensor, “{study.layout.names[0]}”, gives {_errors(study.joint_arcsec)} (1σ)."
    totals = total_arcsec(study.alone_arcsec)
    # Totals are rounded, so that the first of equally good sensors is named on every processor.
    best = int(np.argmin(np.round(totals, 6)))
    joint = float(total_arcsec(study.joint_arcsec))
    return (
        f"The {count} sensors together give {_errors(study.joint_arcsec)} (1σ). The best of them alone, "
        f"“{study.layout.names[best]}”, gives {_errors(study.alone_arcsec[best])}: the total error of all sensors "
        f"is {totals[best] / joint:.3g} times smaller."
    )


def _rule_in_numbers(study: LayoutStudy) -> str:
    """Return the engineering rule in numbers, for the first sensor's elevation and error about the boresight."""
    layout = study.layout
    elevation = layout.angles[0, 1]
    sensor = next(iter(study.config.sensors.values()))
    size = float(np.hypot(sensor.sigma_forward_arcsec, sensor.installation_sigma_forward_arcsec))
    return (
        f"Sensor “{layout.names[0]}” at {np.rad2deg(elevation):g}° elevation, with {size:.3g}″ about its boresight "
        f"(noise and installation together): {size * np.sin(elevation):.3g}″ of heading, and "
        f"{size * np.cos(elevation):.3g}″ of roll if it looks along the keel or of pitch if it looks abeam."
    )


def _errors(sigmas_arcsec: FloatArray) -> str:
    heading, pitch, roll = (f"{sigma:.3g}″" for sigma in sigmas_arcsec)
    return f"heading {heading}, pitch {pitch}, roll {roll}"


def _tolerance_text(turned: AzimuthScan) -> str:
    if turned.good_deg is None:
        return "any other azimuth increases the error by more than a tenth"
    low, high = turned.good_deg
    if high - low == 360.0:
        return "any azimuth increases the error by less than a tenth"
    return f"from {low:.0f}° clockwise to {high:.0f}° the error increases by less than a tenth"


def _gain_text(given: float, best: float) -> str:
    gain = 1.0 - best / given
    if gain < 1e-6:
        advice = "The layout as given is the best one in azimuth."
    elif gain < _WORTH_MOVING:
        advice = f"The gain of {100.0 * gain:.1f} % is small: other needs of the ship may decide."
    else:
        advice = f"The recommended azimuths reduce the total error by {100.0 * gain:.0f} %."
    return f"Total error at these azimuths {best:.2f}″, as given {given:.2f}″. {advice}"
