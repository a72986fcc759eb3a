"""Advised positions of the drones: the positions within the limits with the most accurate pointing.

The standard deviation of the pointing is smooth over the box coordinates of the allowed positions
(:mod:`theodolite_calib.escort.places`). The standard deviation is minimised with SLSQP from each of the two best
starting points. The result is the best evaluated set of positions with sufficient separations of the drones. All box
coordinates meet the other limits.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ship_geometry.rotations import FloatArray
from theodolite_calib.config import EscortConfig
from theodolite_calib.escort.accuracy import BeaconAccuracy
from theodolite_calib.escort.places import AllowedPlaces

_REFINED_STARTS = 2
"""Number of starting points that are refined."""
_MIN_GAIN = 0.005
"""Relative gain of accuracy below which the previous positions are kept, because the gain is not worth a move."""
_RANGES = (0.0, 0.35, 0.7, 1.0)
_ORIENTATIONS = (0.0, 0.25, 0.5, 0.75)
_TOLERANCE = 1e-4
_MAX_STEPS = 40


@dataclass(frozen=True)
class EscortAdvice:
    """Advised positions of the drones; NaN if no position is within the limits.

    Attributes:
        names: names of the N drones.
        places_n: vectors from the ship's antenna to the drones' antennas (N, U, E), m, shape (N, 3).
        sigma_now: standard deviation of the pointing on the sky with the beacons now in the field, rad.
        sigma_advised: standard deviation of the pointing with the beacons at the advised positions, rad.
        limits_reached: limits reached by the positions; or the limit that no position meets.
    """

    names: tuple[str, ...]
    places_n: FloatArray
    sigma_now: float
    sigma_advised: float
    limits_reached: tuple[str, ...]


def advise(
    limits: EscortConfig,
    accuracy: BeaconAccuracy,
    names: tuple[str, ...],
    now_n: dict[str, FloatArray],
    keep_n: FloatArray | None = None,
) -> EscortAdvice:
    """Return the best positions for the drones.

    Args:
        limits: limits of the positions.
        accuracy: accuracy of the pointing with beacons at given positions.
        names: names of the drones, at least one.
        now_n: known present positions of the drones, from the ship's antenna (N, U, E), m, shape (3,).
        keep_n: previous positions, shape (N, 3), which are shifted into the limits and kept unless other positions are
            better by half a percent.
    """
    allowed = AllowedPlaces.around_axis(limits, accuracy.centre_n, accuracy.rotation_nt)
    in_field = {name: place_n for name, place_n in now_n.items() if allowed.is_in_field(place_n)}
    sigma_now = accuracy.sigma(tuple(in_field), np.array(list(in_field.values())).reshape(-1, 3))
    if allowed.unmet_limit:
        return _no_advice(names, sigma_now, allowed.unmet_limit)
    search = _Search(allowed, accuracy, names)
    kept_sigma = np.inf if keep_n is None else search.evaluate(allowed.nearest_box(keep_n))
    kept_box = search.best_box
    search.run(kept_box)
    if search.best_box is None:
        return _no_advice(names, sigma_now, "separation_min_m")
    box = kept_box if kept_box is not None and kept_sigma <= (1.0 + _MIN_GAIN) * search.best else search.best_box
    places_n = allowed.places_n(box)
    return EscortAdvice(
        names, places_n, sigma_now, accuracy.sigma(names, places_n), tuple(allowed.limits_reached(names, places_n))
    )


def _no_advice(names: tuple[str, ...], sigma_now: float, limit: str) -> EscortAdvice:
    return EscortAdvice(names, np.full((len(names), 3), np.nan), sigma_now, float("nan"), (limit,))


class _Search:
    """Search for the best positions; the best evaluated positions are stored.

    Args:
        allowed: allowed positions.
        accuracy: accuracy of the pointing with beacons at given positions.
        names: names of the drones.

    Attributes:
        best: least standard deviation of the pointing at any evaluated positions, rad; infinite at the start.
        best_box: box coordinates of the best positions, shape (N, 3); None at the start.
    """

    def __init__(self, allowed: AllowedPlaces, accuracy: BeaconAccuracy, names: tuple[str, ...]) -> None:
        self._allowed, self._accuracy, self._names = allowed, accuracy, names
        self.best = float("inf")
        self.best_box: FloatArray | None = None

    def run(self, first: FloatArray | None) -> None:
        """Search for the best positions; ``first`` is an additional starting point, shape (N, 3)."""
        starts = [] if first is None else [first]
        starts += list(_starting_points(len(self._names)))
        valued = sorted((self.evaluate(box), number) for number, box in enumerate(starts))
        scale = min(valued[0][0], self._accuracy.sigma((), np.empty((0, 3))))
        for _, number in valued[:_REFINED_STARTS]:
            self._refine(starts[number], scale)

    def evaluate(self, box: FloatArray) -> float:
        """Return the standard deviation at box coordinates, infinite for drones too close together; record the best."""
        places_n = self._allowed.places_n(box)
        if not np.all(self._allowed.separations_m(places_n) >= self._allowed.limits.separation_min_m):
            return float("inf")
        return self._evaluate_and_record(box, places_n)

    def _evaluate_and_record(self, box: FloatArray, places_n: FloatArray) -> float:
        sigma = self._accuracy.sigma(self._names, places_n)
        if sigma < self.best:
            self.best, self.best_box = sigma, np.array(box)
        return sigma

    def _refine(self, start: FloatArray, scale: float) -> None:
        """Refine a starting point; steps may bring drones too close together, but such positions are not stored."""
        shape, least_m = start.shape, self._allowed.limits.separation_min_m

        def value(flat: FloatArray) -> float:
            box = np.clip(flat.reshape(shape), 0.0, 1.0)
            places_n = self._allowed.places_n(box)
            if np.all(self._allowed.separations_m(places_n) >= least_m):
                return self._evaluate_and_record(box, places_n) / scale
            return self._accuracy.sigma(self._names, places_n) / scale

        def separation_margin(flat: FloatArray) -> FloatArray:
            separations_m = self._allowed.separations_m(self._allowed.places_n(flat.reshape(shape)))
            return separations_m / max(least_m, 1.0) - least_m / max(least_m, 1.0) * (1.0 + 1e-6)

        constraints = [{"type": "ineq", "fun": separation_margin}] if len(start) > 1 and least_m > 0.0 else []
        minimize(
            value,
            np.clip(start, 0.01, 0.99).ravel(),
            method="SLSQP",
            bounds=[(0.0, 1.0)] * start.size,
            constraints=constraints,
            options={"maxiter": _MAX_STEPS, "ftol": _TOLERANCE, "eps": 1e-4},
        )


def _starting_points(count: int) -> Iterator[FloatArray]:
    """Yield the box coordinates of N positions for each start, shape (N, 3).

    The positions are around the edge of the field, at equal or alternating ranges, or at one elevation. A single
    position is also in the middle of the field.
    """
    numbers = np.arange(float(count))
    for share in _RANGES:
        ranges = np.full(count, share)
        for orientation in _ORIENTATIONS:
            yield _around_edge(numbers, orientation, ranges)
    for share in (0.0, 0.5, 1.0):
        yield np.column_stack([np.full(count, share), numbers / max(count - 1, 1), np.ones(count)])
    for orientation in _ORIENTATIONS:
        yield _around_edge(numbers, orientation, numbers % 2.0)
    if count == 1:
        yield from (np.array([[0.5, 0.5, share]]) for share in _RANGES)


def _around_edge(numbers: FloatArray, orientation: float, ranges: FloatArray) -> FloatArray:
    """Return positions evenly around the edge of the field."""
    angle = np.pi * orientation + 2.0 * np.pi * numbers / len(numbers)
    # On the edge the azimuth is at one end of the interval that is allowed at the elevation.
    side = np.where(np.abs(np.cos(angle)) < 1e-9, 0.5, (np.cos(angle) > 0.0).astype(float))
    return np.column_stack([0.5 + 0.5 * np.sin(angle), side, ranges])
