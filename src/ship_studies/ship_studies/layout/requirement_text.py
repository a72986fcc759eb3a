"""Results of a requirement, as lines on the terminal and as tables."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_node.pages.study_files import Table
from ship_studies.layout.error_budget import Allocation, Layout, binding_angle
from ship_studies.layout.installation_model import SHIP_ANGLES
from ship_studies.layout.requirement import Candidate, RequirementResult
from ship_studies.layout.study import LayoutStudy

REQUIREMENT_TABLES = ("ranking.csv", "allocation.csv", "elevation_trade.csv", "admissible_map.csv")
"""Names of the tables of a study with a requirement."""

_SIGMAS = ("heading_sigma_arcsec", "pitch_sigma_arcsec", "roll_sigma_arcsec")


def requirement_lines(required: RequirementResult) -> list[str]:
    """Return the ranking, the dominant errors and, if no layout meets the requirement, the nearest miss."""
    lines = [f"required [arcsec, 1 sigma]: {limits_text(required)}"]
    for place, one in enumerate(required.ranking, start=1):
        result = "meets it" if one.is_admissible else "does not"
        lines.append(f"{place:3d} {one.name:24}{result}: {candidate_text(one, required)}")
    if not required.is_met:
        lines.append(f"no layout meets the requirement; nearest miss: {nearest_miss_text(required)}")
    for name, allocations in required.allocations.items():
        lines.append(f"{name}: {binding_error_text(allocations)}")
    return lines


def limits_text(required: RequirementResult, unit: str = "") -> str:
    """Return the required errors, arcsec, each followed by the text of the unit."""
    limits = zip(SHIP_ANGLES, required.limits_arcsec, strict=True)
    return ", ".join(f"{name} {limit:g}{unit}" for name, limit in limits if np.isfinite(limit))


def candidate_text(one: Candidate, required: RequirementResult) -> str:
    """Return a description of one layout: requirement use, directions of the sensors, obstructions."""
    if np.isnan(one.requirement_use):
        uses = "a boresight is too near to the horizon"
    else:
        binding = SHIP_ANGLES[binding_angle(one.sigmas_arcsec, required.limits_arcsec)]
        uses = f"{binding} uses {100.0 * one.requirement_use:.1f} %"
    return "; ".join([uses, placements_text(one.layout), *one.obstacles])


def placements_text(layout: Layout) -> str:
    """Return azimuth and elevation of each sensor as text, degrees."""
    angles_deg = np.rad2deg(layout.angles[:, :2])
    return ", ".join(
        f"{name} {azimuth_deg % 360.0:g}/{elevation_deg:g}"
        for name, (azimuth_deg, elevation_deg) in zip(layout.names, angles_deg.round(3), strict=True)
    )


def nearest_miss_text(required: RequirementResult) -> str:
    """Return a description of the first layout of a ranking without admissible layouts: deficit or obstructions."""
    nearest = required.ranking[0]
    if nearest.obstacles or np.isnan(nearest.requirement_use):
        return f"'{nearest.name}': {candidate_text(nearest, required)}"
    angle = binding_angle(nearest.sigmas_arcsec, required.limits_arcsec)
    return (
        f"'{nearest.name}', {SHIP_ANGLES[angle]} {nearest.sigmas_arcsec[angle]:.2f} of "
        f"{required.limits_arcsec[angle]:g} arcsec ({placements_text(nearest.layout)}); with all errors "
        f"{100.0 * (1.0 - 1.0 / nearest.requirement_use):.1f} % smaller it would be met"
    )


def binding_error_text(allocations: list[Allocation]) -> str:
    """Return a text with the dominant error and its maximum size."""
    first = allocations[0]
    text = f"{first.key} = {first.sigma_arcsec:.3g} arcsec dominates with {100.0 * first.share:.0f} % of the variance; "
    if np.isnan(first.alone_arcsec):
        return text + "not met without this error either"
    if np.isinf(first.alone_arcsec):
        return text + "alone it may have any size"
    return text + f"alone it may be up to {first.alone_arcsec:.3g} arcsec"


def requirement_tables(study: LayoutStudy, required: RequirementResult) -> dict[str, Table]:
    """Return header and rows of each of :data:`REQUIREMENT_TABLES`."""
    evaluation = ("admissible", "share_used", *_SIGMAS)
    where = ("azimuths_and_elevations_deg", "obstacles")
    return {
        "ranking.csv": (("rank", "layout", *evaluation, *where), _ranking(required)),
        "allocation.csv": (
            (
                *("layout", "parameter", "kind", "sigma_arcsec", "share_of_binding_variance"),
                *("together_arcsec", "alone_arcsec"),
            ),
            _allocations(required),
        ),
        "elevation_trade.csv": (
            (
                *("elevation_deg", *evaluation),
                *("heading_refraction_arcsec", "pitch_refraction_arcsec", "roll_refraction_arcsec", *where),
            ),
            _trade(required),
        ),
        "admissible_map.csv": (
            ("sensor_moved", "azimuth_deg", "elevation_deg", "share_used", "clear", "over_horizon", "admissible"),
            _maps(study, required),
        ),
    }


def _ranking(required: RequirementResult) -> Iterator[tuple[Any, ...]]:
    for place, one in enumerate(required.ranking, start=1):
        yield place, one.name, *_evaluation_columns(one), placements_text(one.layout), "; ".join(one.obstacles)


def _evaluation_columns(one: Candidate) -> tuple[Any, ...]:
    return int(one.is_admissible), one.requirement_use, *one.sigmas_arcsec


def _allocations(required: RequirementResult) -> Iterator[tuple[Any, ...]]:
    for name, allocations in required.allocations.items():
        for row in allocations:
            sizes = row.sigma_arcsec, row.share, row.together_arcsec, row.alone_arcsec
            yield name, row.key, row.kind, *sizes


def _trade(required: RequirementResult) -> Iterator[tuple[Any, ...]]:
    for one in required.trade:
        where = placements_text(one.candidate.layout), "; ".join(one.candidate.obstacles)
        yield one.elevation_deg, *_evaluation_columns(one.candidate), *one.refraction_arcsec, *where


def _maps(study: LayoutStudy, required: RequirementResult) -> Iterator[tuple[Any, ...]]:
    for moved, allowed in zip(study.maps, required.maps, strict=True):
        admissible = allowed.is_admissible()
        for row, elevation_deg in enumerate(moved.elevations_deg):
            for column, azimuth_deg in enumerate(moved.azimuths_deg):
                at = row, column
                flags = int(allowed.is_clear[at]), int(allowed.is_above_horizon[at]), int(admissible[at])
                yield moved.sensor, azimuth_deg, elevation_deg, allowed.requirement_use[at], *flags
