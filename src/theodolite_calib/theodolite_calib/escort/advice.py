"""Advised positions of the drones: the positions within the limits with the most accurate pointing.

Only a node that gives advice imports this module, because loading scipy's optimisers takes long.

A position within the limits is given by three box coordinates, each between 0 and 1. At the theodolite it has a range,
an elevation e and an azimuth A + α; A and E are azimuth and elevation of the telescope's axis. The position is in a
field of the radius f if cos f ≤ sin e sin E + cos e cos E cos α. The allowed elevations are therefore an interval, and
so are the allowed azimuths at each elevation. All box coordinates meet the limits on range, elevation and field; the
separation of the drones must be checked.

The standard deviation of the pointing is smooth over the box coordinates. It is minimised with SLSQP from each of the
two best starting points. The result is the best evaluated set of positions with sufficient separations of the drones.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ship_estimation.rejection_rules import Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import FloatArray, angle_between
from theodolite_calib.config import EscortConfig, OpticalAxisConfig
from theodolite_calib.escort.accuracy import BeaconAccuracy
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.subfilters import BEACON_PREFIX
from theodolite_calib.samples.samples import BaselineSample, PointingEstimate
from theodolite_calib.samples.tracks import MeasuredTracks

_BOX_MARGIN = 1e-9
"""Margin of the box at each limit against rounding, as a ratio."""
_LIMIT_MARGIN = 1e-3
"""Distance from a limit up to which a position is at this limit: a ratio for lengths, radii of the field for angles."""
_POLE = 1e-12
_MIN_RANGE_M = 1.0
"""Minimum range of a beacon, m; a closer position is on board."""

_REFINED_STARTS = 2
"""Number of starting points that are refined."""
_MIN_GAIN = 0.005
"""Relative gain of accuracy below which the previous positions are kept, because the gain is not worth a move."""
_RANGES = (0.0, 0.35, 0.7, 1.0)
_ORIENTATIONS = (0.0, 0.25, 0.5, 0.75)
_TOLERANCE = 1e-4
_MAX_STEPS = 40


@dataclass(frozen=True)
class AllowedPlaces:
    """Allowed positions of a drone for one direction of the telescope.

    Attributes:
        limits: configured limits.
        centre_n: vector from the ship's antenna to the theodolite (N, U, E), m, shape (3,).
        azimuth: azimuth of the telescope's axis in the horizon, rad.
        elevation: elevation of the telescope's axis in the horizon, rad.
        least_elevation: least elevation of a drone within limits and field, rad.
        greatest_elevation: greatest elevation of a drone, rad; less than ``least_elevation`` if no position is allowed.
    """

    limits: EscortConfig
    centre_n: FloatArray
    azimuth: float
    elevation: float
    least_elevation: float
    greatest_elevation: float

    @classmethod
    def around_axis(cls, limits: EscortConfig, centre_n: FloatArray, rotation_nt: FloatArray) -> "AllowedPlaces":
        """Return the allowed positions around the axis of the telescope; ``rotation_nt`` is horizon from telescope."""
        azimuth, elevation, _ = angles_from_rotation(rotation_nt).tolist()
        field = np.deg2rad(limits.field_deg) * (1.0 - _BOX_MARGIN)
        least = max(float(np.deg2rad(limits.elevation_min_deg)), elevation - field)
        greatest = min(float(np.deg2rad(limits.elevation_max_deg)), elevation + field, 0.5 * np.pi)
        return cls(limits, centre_n, azimuth, elevation, least, greatest)

    @property
    def unmet_limit(self) -> str:
        """Elevation limit that no position in the field meets; empty if a position meets both limits."""
        if self.least_elevation <= self.greatest_elevation:
            return ""
        low = self.elevation < np.deg2rad(self.limits.elevation_min_deg)
        return "elevation_min_deg" if low else "elevation_max_deg"

    def places_n(self, box: FloatArray) -> FloatArray:
        """Return positions from the ship's antenna (N, U, E), m, shape (..., 3).

        Args:
            box: elevation, azimuth and logarithm of the range as fractions of their allowed intervals, shape (..., 3).
        """
        inside = np.clip(box, _BOX_MARGIN, 1.0 - _BOX_MARGIN)
        elevation = self.least_elevation + inside[..., 0] * (self.greatest_elevation - self.least_elevation)
        azimuth = self.azimuth + (2.0 * inside[..., 1] - 1.0) * self._half_width(elevation)
        near, far = self.limits.range_min_m, self.limits.range_max_m
        range_m = near * (far / near) ** inside[..., 2]
        level = np.cos(elevation)
        direction_n = np.stack([level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)], axis=-1)
        places_n: FloatArray = self.centre_n + range_m[..., None] * direction_n
        return places_n

    def nearest_box(self, places_n: FloatArray) -> FloatArray:
        """Return the box coordinates of positions, clipped to the limits, shape (N, 3)."""
        path_n = places_n - self.centre_n
        range_m, elevation = self._range_and_elevation(places_n)
        range_m = np.clip(range_m, self.limits.range_min_m, self.limits.range_max_m)
        elevation = np.clip(elevation, self.least_elevation, self.greatest_elevation)
        offset = np.angle(np.exp(1j * (np.arctan2(path_n[:, 2], path_n[:, 0]) - self.azimuth)))
        near, far = self.limits.range_min_m, self.limits.range_max_m
        box = np.stack(
            [
                _ratio(elevation - self.least_elevation, self.greatest_elevation - self.least_elevation),
                0.5 + 0.5 * _ratio(offset, self._half_width(elevation)),
                _ratio(np.log(range_m / near), np.log(far / near)),
            ],
            axis=-1,
        )
        nearest: FloatArray = np.clip(box, 0.0, 1.0)
        return nearest

    def is_in_field(self, place_n: FloatArray) -> bool:
        """True if a beacon at a position (N, U, E), m, shape (3,), is in the field of the telescope."""
        range_m, _ = self._range_and_elevation(place_n[None])
        if not range_m[0] >= _MIN_RANGE_M:
            return False
        return bool(self._angles_off_axis(place_n[None])[0] <= np.deg2rad(self.limits.field_deg))

    def separations_m(self, places_n: FloatArray) -> FloatArray:
        """Return the distances between all pairs of drones, m, shape (N (N - 1) / 2,)."""
        first, second = np.triu_indices(len(places_n), k=1)
        separations_m: FloatArray = np.linalg.norm(places_n[first] - places_n[second], axis=-1)
        return separations_m

    def limits_reached(self, names: tuple[str, ...], places_n: FloatArray) -> list[str]:
        """Return the limits that positions reach: ``name: parameter``; for separations ``name, name: parameter``."""
        limits = self.limits
        (range_m, elevation), off = self._range_and_elevation(places_n), self._angles_off_axis(places_n)
        field = np.deg2rad(limits.field_deg)
        reached = []
        for number, name in enumerate(names):
            at = {
                "range_min_m": range_m[number] < limits.range_min_m * (1.0 + _LIMIT_MARGIN),
                "range_max_m": range_m[number] > limits.range_max_m * (1.0 - _LIMIT_MARGIN),
                "elevation_min_deg": elevation[number] < np.deg2rad(limits.elevation_min_deg) + _LIMIT_MARGIN * field,
                "elevation_max_deg": elevation[number] > np.deg2rad(limits.elevation_max_deg) - _LIMIT_MARGIN * field,
                "field_deg": off[number] > field * (1.0 - _LIMIT_MARGIN),
            }
            reached += [f"{name}: {limit}" for limit, is_at in at.items() if is_at]
        close = self.separations_m(places_n) < limits.separation_min_m * (1.0 + _LIMIT_MARGIN)
        for first, second, is_at in zip(*np.triu_indices(len(names), k=1), close, strict=True):
            if is_at:
                reached.append(f"{names[first]}, {names[second]}: separation_min_m")
        return reached

    def _range_and_elevation(self, places_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the range of positions, m, and their elevation, rad, shape (N,) each."""
        path_n = places_n - self.centre_n
        range_m = np.linalg.norm(path_n, axis=-1)
        elevation = np.arctan2(path_n[:, 1], np.hypot(path_n[:, 0], path_n[:, 2]))
        return range_m, elevation

    def _angles_off_axis(self, places_n: FloatArray) -> FloatArray:
        """Return the angles of positions from the telescope's axis, rad, shape (N,)."""
        axis_n = rotation_from_angles(self.azimuth, self.elevation, 0.0)[:, 0]
        return angle_between(places_n - self.centre_n, axis_n)

    def _half_width(self, elevation: FloatArray) -> FloatArray:
        """Return the greatest azimuth difference α from the axis that is in the field at an elevation, rad."""
        field = np.deg2rad(self.limits.field_deg) * (1.0 - _BOX_MARGIN)
        # cos f = cos(e - E) - cos e cos E (1 - cos α) is solved for α by half angles, accurate for small fields too.
        product = np.sin(0.5 * (field - elevation + self.elevation)) * np.sin(
            0.5 * (field + elevation - self.elevation)
        )
        level = np.maximum(np.cos(elevation) * np.cos(self.elevation), _POLE)
        width: FloatArray = 2.0 * np.arcsin(np.sqrt(np.clip(product / level, 0.0, 1.0)))
        return width


def _ratio(part: FloatArray, whole: FloatArray | float) -> FloatArray:
    """Return the ratio of a part to the whole; 0 if the whole is 0."""
    share: FloatArray = part / np.where(np.asarray(whole) == 0.0, np.inf, whole)
    return share


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


class EscortAdvisor:
    """Computes advised positions for the drones of one run.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        tracks: tracks of the measured samples.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter, tracks: MeasuredTracks) -> None:
        self._tracks = tracks
        self._advised_ns: int | None = None
        self._names: tuple[str, ...] = ()
        self._advised_n: FloatArray | None = None
        self.reconfigure(config, filter_)

    def reconfigure(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        """Apply changed noise."""
        self._config, self._filter = config, filter_

    def advice(self, estimate: PointingEstimate) -> EscortAdvice | None:
        """Return the advised positions of the drones; None within the period, without usable drones, or in a gap.

        Args:
            estimate: latest pointing that is not INVALID.
        """
        time_ns, period_ns = estimate.time_ns, round(self._config.escort.period_s * SECOND_NS)
        if self._advised_ns is not None and time_ns - self._advised_ns < period_ns:
            return None
        names = self._usable_drones(estimate)
        axes = self._tracks.axes_at(time_ns)
        if not names or isinstance(axes, Rejection):
            return None
        samples = {name: sample for name in names if (sample := self._newest_baseline(name, time_ns)) is not None}
        now_n = {name: sample.vector for name, sample in samples.items()}
        accuracy = BeaconAccuracy(
            self._config,
            self._filter,
            *axes,
            estimate.state.mean,
            {name: sample.covariance_n for name, sample in samples.items()},
        )
        if self._advised_n is None or names != self._names:
            self._advised_n = np.array([now_n[name] for name in names]) if len(now_n) == len(names) else None
        advice = advise(self._config.escort, accuracy, names, now_n, self._advised_n)
        self._advised_ns, self._names = time_ns, names
        if np.isfinite(advice.sigma_advised):
            self._advised_n = advice.places_n
        return advice

    def _usable_drones(self, estimate: PointingEstimate) -> tuple[str, ...]:
        """Return the drones whose beacons the filter would use."""
        disabled, excluded = set(self._config.sources_off), estimate.state.fault_state.excluded
        return tuple(
            name
            for name in self._config.beacons
            if BEACON_PREFIX + name not in excluded and not {"lights", f"baseline.{name}", f"drone.{name}"} & disabled
        )

    def _newest_baseline(self, name: str, time_ns: int) -> BaselineSample | None:
        """Return the newest baseline to a drone; None if the baseline is rejected or old."""
        sample = self._tracks.baselines[name].newest
        if sample is None or sample.rejection is not None:
            return None
        recent_ns = round(self._config.lights_recent_s * SECOND_NS)
        return sample if abs(time_ns - sample.time_ns) <= recent_ns else None
