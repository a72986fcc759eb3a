"""The layout study as one self-contained HTML page for the naval architect: plain words, tables, embedded figures."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from ship_attitude_star.layout.config import READING_NAMES
from ship_attitude_star.layout.installation_model import Reading
from ship_attitude_star.layout.joint_error import total_arcsec
from ship_attitude_star.layout.study import LayoutStudy
from ship_attitude_star.layout.sweeps import CURVE_AZIMUTHS_DEG, SOURCES, SWEEPS, source_errors_arcsec
from ship_attitude_star.layout.words import advice, result, rule_in_numbers
from ship_geometry.rotations import FloatArray

_ANGLES = ("heading", "pitch", "roll")


def page_text(study: LayoutStudy, figures: Mapping[str, Path], title: str) -> str:
    """The page.

    Args:
        study: what it shows.
        figures: the PNG files by name, embedded.
        title: of the study, for the heading.
    """
    template = Template(resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    config = study.config
    return template.substitute(
        title=escape(title),
        result=result(study),
        advice=advice(study),
        rule_in_numbers=rule_in_numbers(study),
        ship="The ship is level."
        if config.ship_pitch_deg == config.ship_roll_deg == 0.0
        else f"The ship has pitch {config.ship_pitch_deg:g}°, roll {config.ship_roll_deg:g}°.",
        layout_table=_layout_table(study),
        layout_figure=_image(figures["layout"], "Boresights seen from above", "small"),
        azimuth_figure=_image(figures["azimuth"], "Joint error over the azimuth of a sensor"),
        maps="\n".join(_image(figures[f"map_{name}"], f"Joint error over {name}") for name in study.layout.names),
        sensor_table=_sensor_table(study),
        budget_table=_budget_table(study),
        point=_operating_point(study),
        source_tables="\n".join(_source_table(study, reading) for reading in Reading),
        sweeps="\n".join(_image(figures[f"figure_{s.number}"], f"Figure {s.number} of [Z14]") for s in SWEEPS),
    )


def _image(path: Path, words: str, style: str = "wide") -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img class="{style}" alt="{escape(words)}" src="data:image/png;base64,{data}">'


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], last_is_sum: bool = False, style: str = "") -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    return f'<table class="{style}"><thead><tr>{head}</tr></thead>{_body(rows, last_is_sum)}</table>'


def _body(rows: Iterable[Sequence[str]], last_is_sum: bool) -> str:
    lines = ["<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    if last_is_sum:
        lines[-1] = lines[-1].replace("<tr>", '<tr class="sum">')
    return f"<tbody>{''.join(lines)}</tbody>"


def _arcsec(values: FloatArray, digits: int = 2) -> list[str]:
    # Adding zero takes the sign from a rounded zero.
    texts = ("–" if np.isnan(value) else f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)
    return [text.replace("-", "−") for text in texts]


def _layout_table(study: LayoutStudy) -> str:
    rows = []
    for name, angles, sigmas in zip(study.layout.names, study.layout.angles, study.alone_arcsec, strict=True):
        azimuth_deg, elevation_deg, _ = np.rad2deg(angles)
        where = [f"{azimuth_deg % 360.0:g}°", f"{elevation_deg:g}°"]
        rows.append([f"{name} alone", *where, *_arcsec(sigmas), *_arcsec(total_arcsec(sigmas[None]))])
    joint = [("all, as given", study.joint_arcsec)]
    if len(study.layout.names) > 1:
        joint.append(("all, at the recommended azimuths", study.best_arcsec))
    rows += [[words, "", "", *_arcsec(sigmas), *_arcsec(total_arcsec(sigmas[None]))] for words, sigmas in joint]
    header = ["sensors", "azimuth", "elevation", *(f"{angle} [″]" for angle in _ANGLES), "total [″]"]
    return _table(header, rows, last_is_sum=True)


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
    return _table(header, rows)


def _budget_table(study: LayoutStudy) -> str:
    rows = [
        [source.sensor, source.source, f"{source.sigma_arcsec:g}", *_arcsec(source.errors_arcsec)]
        for source in study.budget
    ]
    rows.append(["all", "root sum of squares", "", *_arcsec(study.joint_arcsec)])
    return _table(["sensor", "source", "1σ [″]", "dK [″]", "dψ [″]", "dθ [″]"], rows, True, style="words")


def _operating_point(study: LayoutStudy) -> str:
    point = study.config.figures
    sizes = [*point.star_errors_arcsec(), *point.installation_errors_arcsec()]
    errors = ", ".join(f"{source} {size:g}″" for source, size in zip(SOURCES, sizes, strict=True))
    return (
        f"As {point.star_azimuth_deg:g}°, Es {point.star_elevation_deg:g}°, γs {point.star_roll_deg:g}°, "
        f"E0 {point.elevation_deg:g}°, γ0 {point.roll_deg:g}°; errors {errors}"
    )


def _source_table(study: LayoutStudy, reading: Reading) -> str:
    point = study.config.figures
    by_azimuth = [source_errors_arcsec(point, azimuth_deg, reading) for azimuth_deg in CURVE_AZIMUTHS_DEG]
    sizes = [*point.star_errors_arcsec(), *point.installation_errors_arcsec()]
    rows = [
        [f"{source} = {size:g}″", *_arcsec(np.concatenate([errors[number] for errors in by_azimuth]))]
        for number, (source, size) in enumerate(zip(SOURCES, sizes, strict=True))
    ]
    rows.append(["all, with signs", *_arcsec(np.concatenate([errors.sum(axis=0) for errors in by_azimuth]))])
    groups = "".join(f'<th colspan="3">A0 = {azimuth_deg:g}°</th>' for azimuth_deg in CURVE_AZIMUTHS_DEG)
    symbols = "<th>dK</th><th>dψ</th><th>dθ</th>" * len(CURVE_AZIMUTHS_DEG)
    head = f"<thead><tr><th>[″]</th>{groups}</tr><tr><th>source</th>{symbols}</tr></thead>"
    table = f'<table class="groups">{head}{_body(rows, last_is_sum=True)}</table>'
    return f"<h3>Reading: {escape(READING_NAMES[reading])}</h3>{table}"
