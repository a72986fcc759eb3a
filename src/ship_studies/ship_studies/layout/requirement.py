"""Evaluation of layouts by the required accuracy: admissible layouts, their ranking, and the effect of elevation.

The requirement use of a layout is sigma / requirement of its worst angle. The layout is admissible if the use is at
most 1, no mask is in a field of view, and all fields keep the required clearance above the horizon on the moving ship.

The evaluated layouts are those of the file, the recommended azimuths, each sensor moved alone over all azimuths and
elevations, and all sensors moved together. A search moves two sensors at a time over a coarse grid, then one sensor at
a time over a fine grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_studies.layout.config import MIN_ELEVATION_DEG, LayoutStudyConfig
from ship_studies.layout.error_budget import Allocation, ErrorMap, Layout, allocate_errors, requirement_use
from ship_studies.layout.field_of_view import Obstructions

AS_GIVEN, RECOMMENDED, ALL_MOVED = "as given", "recommended azimuths", "all sensors moved"
"""Names of layouts. An alternative has the name in the file; a layout with one sensor moved is "<id> moved"."""

SEARCH_STEP_DEG = 5.0
"""Final step of azimuth and elevation in the search that moves all sensors."""
_COARSE_STEP_DEG = 15.0
_TURNS_DEG = (0.0, 30.0, 60.0, 90.0)
_TRADE_STEP_DEG = 2.5
_HIGHEST_DEG = 85.0
_MAX_ROUNDS = 20
_REFRACTION = "refraction"


@dataclass(frozen=True)
class Candidate:
    """One evaluated layout.

    Attributes:
        name: name of the layout, see :data:`AS_GIVEN`.
        layout: the layout.
        sigmas_arcsec: sigmas of heading, pitch, roll, shape (3,); NaN if a boresight is too low for refraction.
        requirement_use: ratio of sigma to requirement of the worst angle; NaN if the sigmas are NaN.
        obstacles: descriptions of the obstructions in the fields of view; empty without obstructions.
    """

    name: str
    layout: Layout
    sigmas_arcsec: FloatArray
    requirement_use: float
    obstacles: tuple[str, ...]

    @property
    def is_admissible(self) -> bool:
        """True if the layout meets the requirement without obstructions; False if its sigmas are not known."""
        return self.requirement_use <= 1.0 and not self.obstacles


@dataclass(frozen=True)
class AdmissibleMap:
    """Admissible mounting directions of one sensor on the grid of its error map; the other sensors stay as given.

    Attributes:
        sensor: sensor that is moved.
        requirement_use: requirement use, shape (e, a); NaN where the boresight is too low.
        is_clear: True where the sensor's field is clear of masks, shape (e, a).
        is_above_horizon: True where the sensor's field keeps the required clearance above the horizon, shape (e, a).
    """

    sensor: str
    requirement_use: FloatArray
    is_clear: NDArray[np.bool_]
    is_above_horizon: NDArray[np.bool_]

    def is_admissible(self) -> NDArray[np.bool_]:
        """True where the requirement is met and this sensor's field is unobstructed, shape (e, a)."""
        return (self.requirement_use <= 1.0) & self.is_clear & self.is_above_horizon


@dataclass(frozen=True)
class ElevationTrade:
    """All sensors at one elevation, at the azimuths with the least requirement use.

    Attributes:
        elevation_deg: elevation of all sensors.
        candidate: evaluated layout.
        refraction_arcsec: errors of heading, pitch, roll due to refraction, shape (3,).
    """

    elevation_deg: float
    candidate: Candidate
    refraction_arcsec: FloatArray


@dataclass(frozen=True)
class RequirementResult:
    """Results of the evaluation of a requirement.

    Attributes:
        limits_arcsec: maximum sigma of heading, pitch, roll, shape (3,); infinite for an angle without requirement.
        ranking: evaluated layouts; admissible layouts first, obstructed layouts last, each group in order of
            requirement use.
        maps: admissible directions of each sensor, in the order of the sensors.
        trade: layouts with all sensors at one elevation, in order of elevation.
        allocations: name of a layout → maximum error sizes, for the layout as given and the first in the ranking.
    """

    limits_arcsec: FloatArray
    ranking: list[Candidate]
    maps: list[AdmissibleMap]
    trade: list[ElevationTrade]
    allocations: dict[str, list[Allocation]]

    @property
    def is_met(self) -> bool:
        """True if any layout is admissible."""
        return self.ranking[0].is_admissible

    @property
    def given_layout(self) -> Candidate:
        """The layout as given."""
        return next(one for one in self.ranking if one.name == AS_GIVEN)


def evaluate_layouts(
    config: LayoutStudyConfig, layout: Layout, best: Layout, maps: list[ErrorMap], obstructions: Obstructions
) -> RequirementResult:
    """Evaluate the layouts of a study by its requirement.

    Args:
        config: parameters of the study.
        layout: layout as given.
        best: layout at the recommended azimuths.
        maps: errors over each sensor's mounting direction.
        obstructions: masks and horizon.
    """
    evaluator = _LayoutEvaluator(config.requirement.limits_arcsec(), obstructions)
    candidates = [evaluator.candidate(AS_GIVEN, layout)]
    if not np.array_equal(layout.angles, best.angles):
        candidates.append(evaluator.candidate(RECOMMENDED, best))
    for name, alternative in config.alternatives.items():
        angles = layout.angles.copy()
        for sensor, place in alternative.sensors.items():
            angles[layout.names.index(sensor)] = place.angles()
        candidates.append(evaluator.candidate(name, replace(layout, angles=angles)))
    admissible = [evaluator.admissible_map(layout, number, moved) for number, moved in enumerate(maps)]
    for number, (moved, allowed) in enumerate(zip(maps, admissible, strict=True)):
        candidates += evaluator.best_of_map(layout, number, moved, allowed)
    candidates.append(evaluator.search(candidates, layout))
    # The sort is stable: of equally good layouts the earlier candidate comes first. The layout as given is first.
    ranking = sorted(
        candidates, key=lambda one: (not one.is_admissible, bool(one.obstacles), _or_infinite(one.requirement_use))
    )
    return RequirementResult(
        limits_arcsec=evaluator.limits_arcsec,
        ranking=ranking,
        maps=admissible,
        trade=list(evaluator.elevation_trades(layout)),
        allocations={
            one.name: allocate_errors(one.layout, evaluator.limits_arcsec) for one in (ranking[0], candidates[0])
        },
    )


@dataclass(frozen=True)
class _LayoutEvaluator:
    """Evaluation of layouts by limits (arcsec, shape (3,)) and obstructions."""

    limits_arcsec: FloatArray
    obstructions: Obstructions

    def candidate(self, name: str, layout: Layout) -> Candidate:
        sigmas = layout.sigmas_arcsec()
        use = float(requirement_use(sigmas, self.limits_arcsec))
        return Candidate(name, layout, sigmas, use, tuple(self._obstacles(layout)))

    def _obstacles(self, layout: Layout) -> Iterator[str]:
        for number, name in enumerate(layout.names):
            for mask in self.obstructions.masks_in_view(number, layout.angles[number]):
                yield f"{mask} in the field of {name}"
            over = float(self.obstructions.horizon_margin(number, layout.angles[number][None])[0])
            if not over >= 0.0:
                yield f"the field of {name} is {np.rad2deg(-over):.1f} deg too near to the horizon"

    def admissible_map(self, layout: Layout, number: int, moved: ErrorMap) -> AdmissibleMap:
        angles = _grid_angles(layout, number, moved.azimuths_deg, moved.elevations_deg)
        shape = moved.sigmas_arcsec.shape[:2]
        return AdmissibleMap(
            moved.sensor,
            requirement_use(moved.sigmas_arcsec, self.limits_arcsec),
            self.obstructions.is_clear(number, angles).reshape(shape),
            (self.obstructions.horizon_margin(number, angles) >= 0.0).reshape(shape),
        )

    def best_of_map(self, layout: Layout, number: int, moved: ErrorMap, allowed: AdmissibleMap) -> list[Candidate]:
        """Return the layout with one sensor at its best unobstructed direction; empty if no direction is usable."""
        uses = np.where(allowed.is_clear & allowed.is_above_horizon, _or_infinite(allowed.requirement_use), np.inf)
        row, column = np.unravel_index(np.argmin(uses), uses.shape)
        if not np.isfinite(uses[row, column]):
            return []
        angles = layout.angles.copy()
        angles[number, :2] = np.deg2rad([moved.azimuths_deg[column] % 360.0, moved.elevations_deg[row]])
        return [self.candidate(f"{moved.sensor} moved", replace(layout, angles=angles))]

    def search(self, candidates: list[Candidate], layout: Layout) -> Candidate:
        """Search for the layout with the least requirement use, with all sensors moved.

        Two sensors at a time move to the best pair of directions of a coarse grid. One sensor at a time then moves to
        the best direction of a fine grid. This second search also starts from the layouts already evaluated, and from
        layouts with the sensors distributed around the ship.
        """
        coarse = [
            self._unobstructed_placements(layout, number, _COARSE_STEP_DEG) for number in range(len(layout.names))
        ]
        fine = [self._unobstructed_placements(layout, number, SEARCH_STEP_DEG) for number in range(len(layout.names))]
        pairs = list(combinations(range(len(layout.names)), 2))
        starts = [self._descend(layout, coarse, pairs), *(one.layout for one in candidates), *_spread_layouts(layout)]
        found = [self._descend(start, fine) for start in starts]
        return min(
            (self.candidate(ALL_MOVED, one) for one in found),
            key=lambda one: (bool(one.obstacles), _or_infinite(one.requirement_use)),
        )

    def _unobstructed_placements(self, layout: Layout, number: int, step_deg: float) -> FloatArray:
        """Return the installation angles of a sensor with an unobstructed field, on a grid, shape (n, 3), rad."""
        azimuths_deg = np.arange(0.0, 360.0, step_deg)
        own = _grid_angles(layout, number, azimuths_deg, _elevations_deg(step_deg))
        return own[self.obstructions.is_unobstructed(number, own)]

    def _descend(
        self, layout: Layout, places: list[FloatArray], groups: Sequence[tuple[int, ...]] | None = None
    ) -> Layout:
        """Move sensors in turn to their best directions until no sensor moves.

        Args:
            layout: layout at the start.
            places: possible installation angles of each sensor, shape (n, 3), rad; with n = 0 the sensor is not moved.
            groups: numbers of the sensors that move together; None if each sensor moves alone.
        """
        for _ in range(_MAX_ROUNDS):
            before = layout.angles
            for group in groups or [(number,) for number in range(len(places))]:
                chosen = np.indices([len(places[number]) for number in group]).reshape(len(group), -1)
                if not chosen.size:
                    continue
                angles = np.tile(layout.angles, (chosen.shape[1], 1, 1))
                for number, rows in zip(group, chosen, strict=True):
                    angles[:, number] = places[number][rows]
                uses = _or_infinite(requirement_use(layout.sigmas_arcsec(angles), self.limits_arcsec))
                layout = replace(layout, angles=angles[int(np.argmin(uses))])
            if np.array_equal(before, layout.angles):
                break
        return layout

    def elevation_trades(self, layout: Layout) -> Iterator[ElevationTrade]:
        """Yield, for each elevation of all sensors, the azimuths clear of masks with the least requirement use."""
        for elevation_deg in _elevations_deg(_TRADE_STEP_DEG):
            angles = layout.angles.copy()
            angles[:, 1] = np.deg2rad(elevation_deg)
            level = replace(layout, angles=angles)
            places = []
            for number in range(len(layout.names)):
                turned = _grid_angles(level, number, np.arange(0.0, 360.0, SEARCH_STEP_DEG), np.array([elevation_deg]))
                clear = self.obstructions.is_clear(number, turned)
                # If masks leave no azimuth, the sensor is not moved, and the candidate's obstacles include the masks.
                places.append(turned[clear])
            best = self._descend(level, places)
            candidate = self.candidate(f"all at {elevation_deg:g} deg", best)
            refraction = np.zeros(3)
            for source in best.budget():
                if source.source == _REFRACTION:
                    refraction = np.abs(source.errors_arcsec)
            yield ElevationTrade(float(elevation_deg), candidate, refraction)


def _spread_layouts(layout: Layout) -> Iterator[Layout]:
    """Yield layouts with azimuths evenly spaced over half a circle and over the whole circle, elevations unchanged."""
    count = len(layout.names)
    for turn_deg in _TURNS_DEG:
        for circle in (np.pi, 2.0 * np.pi):
            angles = layout.angles.copy()
            angles[:, 0] = np.deg2rad(turn_deg) + np.arange(count) * circle / count
            yield replace(layout, angles=angles)


def _elevations_deg(step_deg: float) -> FloatArray:
    return np.arange(MIN_ELEVATION_DEG, _HIGHEST_DEG + step_deg / 2.0, step_deg)


def _grid_angles(layout: Layout, number: int, azimuths_deg: FloatArray, elevations_deg: FloatArray) -> FloatArray:
    """Return installation angles of a sensor at each elevation and azimuth, with its roll, shape (e · a, 3), rad."""
    elevation, azimuth = np.meshgrid(np.deg2rad(elevations_deg), np.deg2rad(azimuths_deg), indexing="ij")
    roll = np.full(azimuth.size, layout.angles[number, 2])
    return np.stack([azimuth.ravel(), elevation.ravel(), roll], axis=-1)


def _or_infinite(use: FloatArray | float) -> FloatArray:
    """Return the requirement uses, with infinity in place of NaN."""
    return np.where(np.isnan(use), np.inf, use)
