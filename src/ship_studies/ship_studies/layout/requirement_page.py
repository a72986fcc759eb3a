"""The requirement as a section of the page: ranking, admissible directions, maximum size of each error."""

from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from ship_node.pages.html_page import arcsec_texts, collapsible, image, table
from ship_studies.layout.allocation import Allocation
from ship_studies.layout.installation_model import SHIP_ANGLES
from ship_studies.layout.requirement import RequirementResult
from ship_studies.layout.requirement_text import binding_error_text, nearest_miss_text, placements_text
from ship_studies.layout.study import LayoutStudy


def required_section(study: LayoutStudy, figures: Mapping[str, Path]) -> str:
    """Return the section; empty without a requirement."""
    required = study.requirement_result
    if required is None:
        return ""
    return (
        f"<h2>Requirement</h2><p>{_summary(required)}</p>"
        f'<div class="table">{_ranking_table(required)}</div>'
        "<p>The use of a layout is 1σ / requirement of its worst angle. The ranking contains the layouts of the file, "
        "the recommended azimuths, each sensor moved alone, and all sensors moved together over a grid of 5°, which is "
        "searched from several starts.</p>"
        f"{image(figures['requirement'], 'Admissible directions of each sensor')}"
        + collapsible(
            "Effect of elevation",
            "<p>At low elevation refraction grows with the cotangent of the elevation, and the field reaches the "
            "horizon as the ship rolls. At high elevation all boresights are nearly parallel, and the error about them "
            f"becomes heading. {_best_elevation(required)}</p>"
            f"{image(figures['elevation'], 'Requirement use over elevation')}",
        )
        + collapsible(
            "Maximum size of each error",
            "<p><i>Together</i>: all errors scaled by one factor. <i>Alone</i>: the other errors unchanged, with the "
            "best combination of the sensors. Any size: another sensor compensates the error. The share is the "
            "part of the variance, for the angle that uses most of its limit.</p>"
            + "".join(_allocation(name, rows) for name, rows in required.allocations.items()),
        )
    )


def _summary(required: RequirementResult) -> str:
    limits_text = ", ".join(
        f"{name} {limit:g}″"
        for name, limit in zip(SHIP_ANGLES, required.limits_arcsec, strict=True)
        if np.isfinite(limit)
    )
    if not required.is_met:
        miss = escape(nearest_miss_text(required))
        return f"Required (1σ): {limits_text}. <b>No layout is admissible.</b> Nearest miss: {miss}."
    given, best = required.given_layout, required.ranking[0]
    as_given = "The layout as given is admissible" if given.is_admissible else "The layout as given is not admissible"
    return (
        f"Required (1σ): {limits_text}. {as_given}. Least use of an admissible layout: “{escape(best.name)}” with "
        f"{100.0 * best.requirement_use:.1f} % ({escape(placements_text(best.layout))})."
    )


def _ranking_table(required: RequirementResult) -> str:
    rows = [
        [
            one.name,
            "yes" if one.is_admissible else "no",
            "–" if np.isnan(one.requirement_use) else f"{100.0 * one.requirement_use:.1f} %",
            *arcsec_texts(one.sigmas_arcsec),
            placements_text(one.layout),
            "; ".join(one.obstacles),
        ]
        for one in required.ranking
    ]
    header = ["layout", "admissible", "use", *(f"{angle} [″]" for angle in SHIP_ANGLES)]
    return table([*header, "azimuth/elevation [°]", "obstructions"], rows)


def _best_elevation(required: RequirementResult) -> str:
    free = [one for one in required.trade if not one.candidate.obstacles and np.isfinite(one.candidate.requirement_use)]
    if not free:
        return "At no elevation are the fields of all sensors clear."
    best = min(free, key=lambda one: one.candidate.requirement_use)
    met = [one.elevation_deg for one in free if one.candidate.is_admissible]
    between = f"elevations that meet the requirement: {met[0]:g}° to {met[-1]:g}°" if met else "no elevation meets it"
    return f"The use is least with all sensors at {best.elevation_deg:g}°; {between}."


def _allocation(name: str, allocations: list[Allocation]) -> str:
    kinds: dict[str, float] = {}
    for row in allocations:
        kinds[row.kind] = kinds.get(row.kind, 0.0) + row.share
    by_kind = ", ".join(f"{kind} {100.0 * share:.1f} %" for kind, share in sorted(kinds.items(), key=lambda k: -k[1]))
    rows = [
        [row.key, row.kind, *arcsec_texts(np.array([row.sigma_arcsec])), f"{100.0 * row.share:.1f} %",
         *arcsec_texts(np.array([row.together_arcsec])), _alone_text(row.alone_arcsec)]
        for row in allocations
    ]  # fmt: skip
    header = ["error", "kind", "1σ now [″]", "share", "together [″]", "alone [″]"]
    return (
        f"<p><b>{escape(name)}</b>: {escape(binding_error_text(allocations))}. By kind: {by_kind}.</p>"
        f'<div class="table">{table(header, rows, style="words")}</div>'
    )


def _alone_text(alone_arcsec: float) -> str:
    if np.isnan(alone_arcsec):
        return "not achievable even at 0″"
    return "any size" if np.isinf(alone_arcsec) else arcsec_texts(np.array([alone_arcsec]))[0]
