"""What is required, as a section of the page: the ranking, where the sensors may be, how large each error may be."""

from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from ship_attitude_star.layout.allocation import Allocation
from ship_attitude_star.layout.installation_model import SHIP_ANGLES
from ship_attitude_star.layout.requirement import JudgedLayouts
from ship_attitude_star.layout.requirement_told import binding, nearest_miss, places
from ship_attitude_star.layout.study import LayoutStudy
from ship_node.documents.html_page import arcsec_texts, folded, image, table


def required_section(study: LayoutStudy, figures: Mapping[str, Path]) -> str:
    """The section; nothing where nothing is required."""
    required = study.required
    if required is None:
        return ""
    return (
        f"<h2>What is required</h2><p>{_verdict(required)}</p>"
        f'<div class="table">{_ranking_table(required)}</div>'
        "<p>A layout uses the share 1σ / requirement of its worst angle. Judged are the layouts of the file, the "
        "recommended azimuths, each sensor moved alone, and all sensors moved together over a grid of 5°, which is "
        "searched from several starts.</p>"
        f"{image(figures['requirement'], 'Where each sensor may be')}"
        + folded(
            "What elevation costs",
            "<p>Low down refraction grows with the cotangent of the elevation, and the field meets the horizon as the "
            "ship rolls. High up all sensors look the same way, and the error about their common line of sight becomes "
            f"heading. {_best_elevation(required)}</p>"
            f"{image(figures['elevation'], 'Share of the requirement over elevation')}",
        )
        + folded(
            "How large each error may be",
            "<p><i>Together</i>: if all errors are scaled alike. <i>Alone</i>: while the others stay as they are, "
            "sensors combined anew. Any size: another sensor covers it. The share is of the variance of the angle that "
            "uses most.</p>" + "".join(_allocation(name, rows) for name, rows in required.allocations.items()),
        )
    )


def _verdict(required: JudgedLayouts) -> str:
    asked = ", ".join(
        f"{name} {limit:g}″"
        for name, limit in zip(SHIP_ANGLES, required.limits_arcsec, strict=True)
        if np.isfinite(limit)
    )
    if not required.met:
        return f"Required (1σ): {asked}. <b>No layout meets it.</b> The nearest miss: {escape(nearest_miss(required))}."
    given, best = required.given, required.ranking[0]
    as_given = "The layout as given meets it" if given.admissible else "The layout as given does not meet it"
    return (
        f"Required (1σ): {asked}. {as_given}. Of the layouts judged “{escape(best.name)}” uses least: "
        f"{100.0 * best.use:.1f} % ({escape(places(best.layout))})."
    )


def _ranking_table(required: JudgedLayouts) -> str:
    rows = [
        [
            one.name,
            "yes" if one.admissible else "no",
            "–" if np.isnan(one.use) else f"{100.0 * one.use:.1f} %",
            *arcsec_texts(one.sigmas_arcsec),
            places(one.layout),
            "; ".join(one.obstacles),
        ]
        for one in required.ranking
    ]
    header = ["layout", "meets it", "uses", *(f"{angle} [″]" for angle in SHIP_ANGLES)]
    return table([*header, "azimuth/elevation [°]", "in the way"], rows)


def _best_elevation(required: JudgedLayouts) -> str:
    free = [one for one in required.trade if not one.judged.obstacles and np.isfinite(one.judged.use)]
    if not free:
        return "At no elevation the sight of all sensors is free."
    best = min(free, key=lambda one: one.judged.use)
    met = [one.elevation_deg for one in free if one.judged.admissible]
    between = f"it is met between {met[0]:g}° and {met[-1]:g}°" if met else "it is met at none"
    return f"Least is used with all sensors at {best.elevation_deg:g}°; of the elevations {between}."


def _allocation(name: str, allocations: list[Allocation]) -> str:
    kinds: dict[str, float] = {}
    for row in allocations:
        kinds[row.kind] = kinds.get(row.kind, 0.0) + row.share
    by_kind = ", ".join(f"{kind} {100.0 * share:.1f} %" for kind, share in sorted(kinds.items(), key=lambda k: -k[1]))
    rows = [
        [row.key, row.kind, *arcsec_texts(np.array([row.sigma_arcsec])), f"{100.0 * row.share:.1f} %",
         *arcsec_texts(np.array([row.together_arcsec])), _alone(row.alone_arcsec)]
        for row in allocations
    ]  # fmt: skip
    header = ["error", "kind", "1σ now [″]", "share", "together [″]", "alone [″]"]
    return (
        f"<p><b>{escape(name)}</b>: {escape(binding(allocations))}. By kind: {by_kind}.</p>"
        f'<div class="table">{table(header, rows, style="words")}</div>'
    )


def _alone(alone_arcsec: float) -> str:
    if np.isnan(alone_arcsec):
        return "not even none"
    return "any size" if np.isinf(alone_arcsec) else arcsec_texts(np.array([alone_arcsec]))[0]
