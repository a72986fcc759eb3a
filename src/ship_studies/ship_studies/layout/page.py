"""The layout study as one self-contained HTML page for the naval architect: text, tables, embedded figures."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_node.pages.html_page import decimal_text, render
from ship_studies.layout.config import LayoutSensor
from ship_studies.layout.installation_model import (
    CURVE_AZIMUTHS_DEG,
    SOURCES,
    SWEEPS,
    InstallationConvention,
    source_errors_arcsec,
)
from ship_studies.layout.joint_error import total_arcsec
from ship_studies.layout.optics import PERCENTILES
from ship_studies.layout.requirement_page import requirement_values
from ship_studies.layout.study import AzimuthScan, LayoutStudy

_READING_NAMES = {
    InstallationConvention.PHYSICAL: "physical: R(A0, E0, γ0) rotates the sensor's axes into the deck's",
    InstallationConvention.PAPER: "as computed in [Z14]: R(A0, E0, γ0) rotates the deck's axes into the sensor's",
}


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

_WORTH_MOVING = 0.1
"""Relative reduction of the total error below which moving the sensors is not worthwhile."""


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
