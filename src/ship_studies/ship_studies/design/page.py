"""Design study as one self-contained HTML page with text, tables and embedded figures."""

from collections.abc import Mapping
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from ship_geometry.ros_axes import ENU_FROM_HORIZON
from ship_node.pages.html_page import STYLE, arcsec_texts, image, table
from ship_studies.design.study import DesignStudy

_WORTH_MOVING = 0.05
"""Relative gain of accuracy below which the advised positions are reported as a small improvement."""
_COMPONENTS = ("azimuth · cos E [″]", "elevation [″]", "on the sky [″]")


def page_text(study: DesignStudy, figures: Mapping[str, Path], title: str) -> str:
    """Return the page.

    Args:
        study: the study to show.
        figures: PNG files by name, which the page embeds.
        title: title of the study, for the heading.
    """
    template = Template(resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    config, exposures = study.config, study.config.optical_axis.escort.exposures
    return template.substitute(
        title=escape(title),
        style=STYLE,
        pointing=f"{config.azimuth_deg:g}° from the bow, {config.elevation_deg:g}° up",
        result=_result(study),
        advice=_advice(study),
        field_figure=image(figures["field"], "Lights in the field of the telescope", "small"),
        places_table=_places_table(study),
        budget_table=_budget_table(study),
        sweeps_figure=image(figures["sweeps"], "Error of the pointing over the quantities of the design"),
        exposures="one exposure" if exposures == 1 else f"{exposures} exposures at the same places",
    )


def _result(study: DesignStudy) -> str:
    azimuth, elevation, on_sky = study.given_arcsec
    largest = max(study.budget, key=lambda source: source.given_arcsec[2])
    required_arcsec = study.config.required_arcsec
    requirement_text = ""
    if required_arcsec > 0.0:
        word = "is met" if study.meets_requirement else "is <b>not</b> met"
        requirement_text = f" The {required_arcsec:g}″ required {word}."
    return (
        f"The given lights give the pointing to <b>{on_sky:.2f}″</b> on the sky ({azimuth:.2f}″ in azimuth · cos E, "
        f"{elevation:.2f}″ in elevation); encoders and ship alone give {study.unaided_arcsec:.3g}″. The largest error "
        f"source is {_words(largest.source)} with {largest.given_arcsec[2]:.2f}″.{requirement_text}"
    )


def _advice(study: DesignStudy) -> str:
    reached = "; ".join(study.advice.limits_reached)
    if not np.isfinite(study.advice.sigma_advised):
        return f"<p>No position of the drones is within the limits: {escape(reached)} leaves none.</p>"
    given, best = study.given_arcsec[2], study.advised_arcsec[2]
    gain = 1.0 - best / given
    if gain < 0.0:
        words = "The given lights are better: they are beyond the limits of escort."
    elif gain < _WORTH_MOVING:
        words = f"The improvement of {100.0 * gain:.1f} % is small: other needs of the flight may decide."
    else:
        words = f"They reduce the error by {100.0 * gain:.0f} %."
    limits = f" Limits reached: {escape(reached)}." if reached else ""
    return f"<p>The best positions within the limits give <b>{best:.2f}″</b>. {words}{limits}</p>"


def _places_table(study: DesignStudy) -> str:
    rows = []
    both = (("as given", study.given_n), ("best", study.advice.places_n))
    for number, (words, places_n) in enumerate(both):
        for light, name in enumerate(study.config.names):
            angles = arcsec_texts(study.places_deg[number, light])
            lengths = arcsec_texts(
                np.append(study.distances_m[number, light], ENU_FROM_HORIZON @ places_n[light]), digits=0
            )
            rows.append([words, name, *angles, *lengths])
    header = ["places", "drone", "right [°]", "up [°]", "distance [m]", "East [m]", "North [m]", "Up [m]"]
    return table(header, rows, style="words")


def _budget_table(study: DesignStudy) -> str:
    rows = [
        [_words(source.source), *arcsec_texts(source.given_arcsec), *arcsec_texts(source.advised_arcsec)]
        for source in study.budget
    ]
    rows.append(["root sum of squares", *arcsec_texts(study.given_arcsec), *arcsec_texts(study.advised_arcsec)])
    header = ["source", *_COMPONENTS, *(f"best: {component}" for component in _COMPONENTS)]
    return table(header, rows, last_is_sum=True)


def _words(source: str) -> str:
    return source.replace("_", " ")
