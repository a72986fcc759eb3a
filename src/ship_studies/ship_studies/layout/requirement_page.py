"""The requirement as a section of the page: ranking, admissible directions, maximum size of each error."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_node.pages.html_page import decimal_text
from ship_studies.layout.requirement import RequirementResult
from ship_studies.layout.requirement_text import binding_error_text, limits_text, nearest_miss_text, placements_text


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
