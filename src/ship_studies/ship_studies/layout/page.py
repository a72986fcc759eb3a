"""The layout study as one self-contained HTML page for the naval architect: text, tables, embedded figures."""

from collections.abc import Mapping
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_node.pages.html_page import STYLE, arcsec_texts, collapsible, image, table, table_body
from ship_studies.layout.installation_model import (
    CURVE_AZIMUTHS_DEG,
    SHIP_ANGLES,
    SOURCES,
    SWEEPS,
    InstallationConvention,
    source_errors_arcsec,
)
from ship_studies.layout.joint_error import total_arcsec
from ship_studies.layout.optics import PERCENTILES
from ship_studies.layout.requirement_page import required_section
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
    template = Template(resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    config = study.config
    return template.substitute(
        title=escape(title),
        style=STYLE,
        result=_result(study),
        advice=_advice(study),
        rule_in_numbers=_rule_in_numbers(study),
        ship="The ship is level."
        if config.ship_pitch_deg == config.ship_roll_deg == 0.0
        else f"The ship has pitch {config.ship_pitch_deg:g}°, roll {config.ship_roll_deg:g}°.",
        required=required_section(study, figures),
        layout_table=_layout_table(study),
        layout_figure=image(figures["layout"], "Boresights seen from above", "small"),
        azimuth_figure=image(figures["azimuth"], "Joint error over the azimuth of a sensor"),
        maps="\n".join(
            collapsible(name, image(figures[f"map_{name}"], f"Joint error over {name}"), is_open=number == 0)
            for number, name in enumerate(study.layout.names)
        ),
        sensor_table=_sensor_table(study),
        optics=_optics_text(study),
        budget_table=_budget_table(study),
        point=_operating_point(study),
        source_tables="\n".join(_source_table(study, reading) for reading in InstallationConvention),
        sweeps="\n".join(image(figures[f"figure_{s.number}"], f"Figure {s.number} of [Z14]") for s in SWEEPS),
    )


def _layout_table(study: LayoutStudy) -> str:
    rows = []
    for name, angles, sigmas in zip(study.layout.names, study.layout.angles, study.alone_arcsec, strict=True):
        azimuth_deg, elevation_deg, _ = np.rad2deg(angles)
        where = [f"{azimuth_deg % 360.0:g}°", f"{elevation_deg:g}°"]
        rows.append([f"{name} alone", *where, *arcsec_texts(sigmas), *arcsec_texts(total_arcsec(sigmas[None]))])
    joint = [("all, as given", study.joint_arcsec)]
    if len(study.layout.names) > 1:
        joint.append(("all, at the recommended azimuths", study.best_arcsec))
    rows += [
        [words, "", "", *arcsec_texts(sigmas), *arcsec_texts(total_arcsec(sigmas[None]))] for words, sigmas in joint
    ]
    header = ["sensors", "azimuth", "elevation", *(f"{angle} [″]" for angle in SHIP_ANGLES), "total [″]"]
    return table(header, rows, last_is_sum=True)


def _sensor_table(study: LayoutStudy) -> str:
    header = ["sensor", "noise about boresight / up / right [″]", "installation about boresight / up / right [″]"]
    rows = []
    for name, sensor in study.config.sensors.items():
        noise = (sensor.sigma_forward_arcsec, sensor.sigma_up_arcsec, sensor.sigma_right_arcsec)
        installation = (
            sensor.installation_sigma_forward_arcsec,
            sensor.installation_sigma_up_arcsec,
            sensor.installation_sigma_right_arcsec,
        )
        rows.append([name, *(" / ".join(f"{sigma:g}" for sigma in sigmas) for sigmas in (noise, installation))])
    return table(header, rows)


def _optics_text(study: LayoutStudy) -> str:
    """Return text and table of the noise from the sensors' optics, with Liebe's values; empty without optics."""
    if not study.optics:
        return ""
    rows = []
    for name, found in study.optics.items():
        stars = [f"{count:.0f}" for count in found.star_count_percentiles().values()]
        field = f"{found.field_deg[0]:.1f}° × {found.field_deg[1]:.1f}°"
        sigmas = [" / ".join(arcsec_texts(triple)) for triple in (found.quantile_arcsec, found.liebe_arcsec)]
        share = f"{100.0 * study.config.optics[name].sky_share:g} %"
        star = f"{found.star_sigma_arcsec:.2f}"
        rows.append([name, field, star, f"{found.stars.mean():.1f}", *stars, share, *sigmas])
    header = ["sensor", "field", "one star [″]", "stars, mean", *(f"in {percent} %" for percent in PERCENTILES)]
    header += ["share of sky", "about boresight / up / right [″]", "by Liebe [″]"]
    return (
        "<p>The noise of these sensors follows from their optics and the Hipparcos-2 stars in the field. The table "
        "gives the mean number of stars and its percentiles over the sky, the noise not exceeded in the required share "
        "of the sky, and the noise by Liebe's formulas with the mean number of stars (C. C. Liebe, Accuracy "
        "performance of star trackers, 2002). The magnitude limit is as given. Lens errors are not included.</p>"
        f'<div class="table">{table(header, rows)}</div>'
    )


def _budget_table(study: LayoutStudy) -> str:
    rows = [
        [source.sensor, source.source, f"{source.sigma_arcsec:g}", *arcsec_texts(source.errors_arcsec)]
        for source in study.budget
    ]
    rows.append(["all", "root sum of squares", "", *arcsec_texts(study.joint_arcsec)])
    return table(["sensor", "source", "1σ [″]", "dK [″]", "dψ [″]", "dθ [″]"], rows, True, style="words")


def _operating_point(study: LayoutStudy) -> str:
    point = study.config.figures
    sizes = [*point.star_errors_arcsec(), *point.installation_errors_arcsec()]
    errors = ", ".join(f"{source} {size:g}″" for source, size in zip(SOURCES, sizes, strict=True))
    return (
        f"As {point.star_azimuth_deg:g}°, Es {point.star_elevation_deg:g}°, γs {point.star_roll_deg:g}°, "
        f"E0 {point.elevation_deg:g}°, γ0 {point.roll_deg:g}°; errors {errors}"
    )


def _source_table(study: LayoutStudy, reading: InstallationConvention) -> str:
    point = study.config.figures
    by_azimuth = [source_errors_arcsec(point, azimuth_deg, reading) for azimuth_deg in CURVE_AZIMUTHS_DEG]
    sizes = [*point.star_errors_arcsec(), *point.installation_errors_arcsec()]
    rows = [
        [f"{source} = {size:g}″", *arcsec_texts(np.concatenate([errors[number] for errors in by_azimuth]))]
        for number, (source, size) in enumerate(zip(SOURCES, sizes, strict=True))
    ]
    rows.append(["all, with signs", *arcsec_texts(np.concatenate([errors.sum(axis=0) for errors in by_azimuth]))])
    groups = "".join(f'<th colspan="3">A0 = {azimuth_deg:g}°</th>' for azimuth_deg in CURVE_AZIMUTHS_DEG)
    symbols = "<th>dK</th><th>dψ</th><th>dθ</th>" * len(CURVE_AZIMUTHS_DEG)
    head = f"<thead><tr><th>[″]</th>{groups}</tr><tr><th>source</th>{symbols}</tr></thead>"
    of_reading = f'<table class="groups">{head}{table_body(rows, last_is_sum=True)}</table>'
    return f"<h3>Reading: {escape(_READING_NAMES[reading])}</h3>{of_reading}"


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


def _advice(study: LayoutStudy) -> str:
    """Return the recommended azimuths with their tolerances; for a single sensor, the effect of its azimuth."""
    if len(study.layout.names) == 1:
        return (
            "<p>With one sensor the total error is the same at every azimuth: rotating the sensor only moves the error "
            "from roll to pitch. Mount it along the keel if pitch matters, abeam if roll matters. For both, and for "
            "heading, add a second sensor at about a right angle to it.</p>"
        )
    given, best = (float(total_arcsec(sigmas)) for sigmas in (study.joint_arcsec, study.best_arcsec))
    first_deg = np.rad2deg(study.best.angles[0, 0]) % 360.0
    items = [f"<li>“{study.best.names[0]}”: {first_deg:g}° from the bow (fixed; the others are rotated)</li>"]
    for number, turned in enumerate(study.scans, start=1):
        best_deg, given_deg = (np.rad2deg(layout.angles[number, 0]) % 360.0 for layout in (study.best, study.layout))
        items.append(
            f"<li>“{escape(turned.sensor)}”: <b>{best_deg:.0f}°</b> from the bow (given: {given_deg:g}°); "
            f"{_tolerance_text(turned)}</li>"
        )
    total = f"Total error at these azimuths {best:.2f}″, as given {given:.2f}″. {_gain_text(given, best)}"
    return f"<ul>{''.join(items)}</ul><p>{total}</p>"


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
        return "The layout as given is the best one in azimuth."
    if gain < _WORTH_MOVING:
        return f"The gain of {100.0 * gain:.1f} % is small: other needs of the ship may decide."
    return f"The recommended azimuths reduce the total error by {100.0 * gain:.0f} %."
