"""Design study as one self-contained HTML page with text, tables and embedded figures."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ship_geometry.ros_axes import ENU_FROM_HORIZON
from ship_node.pages.html_page import decimal_text, render
from ship_studies.design.study import DesignStudy

_WORTH_MOVING = 0.05
"""Relative gain of accuracy below which the advised positions are reported as a small improvement."""


def page_text(study: DesignStudy, figures: Mapping[str, Path], title: str) -> str:
    """Return the page.

    Args:
        study: the study to show.
        figures: PNG files by name, which the page embeds.
        title: title of the study, for the heading.
    """
    return render(
        Path(__file__).with_name("page.html.j2"),
        title=title,
        study=study,
        figures=figures,
        largest=max(study.budget, key=lambda source: source.given_arcsec[2]),
        is_possible=np.isfinite(study.advice.sigma_advised),
        gain=_gain_text(study),
        reached="; ".join(study.advice.limits_reached),
        places=list(_places(study)),
        budget=[
            *([one.source.replace("_", " "), *one.given_arcsec, *one.advised_arcsec] for one in study.budget),
            ["root sum of squares", *study.given_arcsec, *study.advised_arcsec],
        ],
        exposures=study.config.optical_axis.escort.exposures,
    )


def _gain_text(study: DesignStudy) -> str:
    gain = 1.0 - study.advised_arcsec[2] / study.given_arcsec[2]
    if gain < 0.0:
        return "The given lights are better: they are beyond the limits of escort."
    if gain < _WORTH_MOVING:
        return f"The improvement of {100.0 * gain:.1f} % is small: other needs of the flight may decide."
    return f"They reduce the error by {100.0 * gain:.0f} %."


def _places(study: DesignStudy) -> Iterator[list[Any]]:
    both = (("as given", study.given_n), ("best", study.advice.places_n))
    for number, (words, places_n) in enumerate(both):
        for light, name in enumerate(study.config.names):
            lengths_m = study.distances_m[number, light], *(ENU_FROM_HORIZON @ places_n[light])
            yield [words, name, *study.places_deg[number, light], *(decimal_text(one, 0) for one in lengths_m)]
