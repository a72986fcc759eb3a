"""Vertical at any time of a voyage: known deflection of the vertical, and distance over ground.

The vertical is computed at fixed times, every two seconds, and again after a late input. The results therefore do not
depend on the order of arrival.
The steps between intervals are small: 0.02″ if the deflection changes by 60″ in 50 km, at 20 kn.
"""

import bisect
import copy
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ship_attitude_star.vertical.deflection import CONSTANT, NONE, TABLE, DeflectionTable, GravityConfig
from ship_estimation.rejection_rules import Reason, Rejection, resolve_same_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.attitude_samples import DeflectionReading, PositionFix
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.position_from_fixes import PositionFromFixes, ShipPosition

STEP_NS = 2 * SECOND_NS
"""Interval at which position and deflection are evaluated, ns."""

_MIN_MOVE_M = 100.0
"""Minimum distance that counts as motion, m; smaller distances at anchor would add up the noise of fixes."""

_MAX_STEPS = 50_000
"""Maximum number of stored steps, and of steps computed across a gap. 50 000 steps last 27.8 hours.

After a longer gap the distance restarts at zero.
"""

_MAX_MESSAGES = 10_000
"""Maximum number of stored deflection messages."""


class LocalVertical(NamedTuple):
    """The vertical at one time.

    Attributes:
        distance_run_m: distance over ground from an arbitrary start, m.
        latitude: latitude of the ship, rad; NaN before the first fix.
        velocity_m_per_s: velocity of the ship over ground, northward and eastward; 0 before the first fix.
        given_deflection: known deflection (xi, eta), rad, shape (2,); None if the deflection is unknown.
        covariance: covariance of the error of the known deflection, or of the unknown deflection, rad², shape (2, 2).
    """

    distance_run_m: float
    latitude: float
    velocity_m_per_s: tuple[float, float]
    given_deflection: FloatArray | None
    covariance: FloatArray

    @property
    def deflection_jacobian(self) -> FloatArray:
        """Derivative of the rotation vector of the geodetic horizon relative to the gravity horizon, shape (3, 2).

        R_geodetic = exp(deflection_jacobian @ (xi, eta)) R_gravity. The rotation vector has the components (North, Up,
        East). The Up component is eta tan L at the latitude L, the error of a gyrocompass (Laplace's equation).
        """
        return np.array([[0.0, 1.0], [0.0, 0.0 if math.isnan(self.latitude) else math.tan(self.latitude)], [-1.0, 0.0]])


_BEFORE_FIRST_FIX = LocalVertical(0.0, math.nan, (0.0, 0.0), None, np.zeros((2, 2)))
"""The vertical before the first position fix."""


class _GridPoint(NamedTuple):
    """The vertical at the start of an interval.

    Attributes:
        vertical: the vertical.
        anchor: position up to which the distance is counted; None before the first position.
        place: position at the start of the interval; None if no fix is near enough in time.
    """

    vertical: LocalVertical
    anchor: ShipPosition | None
    place: ShipPosition | None


class VerticalTrack:
    """Vertical at any time, from position fixes and deflections.

    Args:
        config: parameters of the deflection.
        sky: parameters of position fixes.

    Attributes:
        unknown_variance: variance of a component of an unknown deflection, rad².
    """

    def __init__(self, config: GravityConfig, sky: SkyConfig) -> None:
        self._config, self._sky = config, sky
        self._table = DeflectionTable(config) if config.deflection == TABLE else None
        self._given_covariance = (config.sigma_arcsec * ARCSEC) ** 2 * np.eye(2)
        self.unknown_variance = (config.unknown_sigma_arcsec * ARCSEC) ** 2
        self._unknown_covariance = self.unknown_variance * np.eye(2)
        self.reset()

    def reset(self) -> None:
        """Discard all inputs and results."""
        self._place = PositionFromFixes(self._sky)
        self._messages: list[DeflectionReading] = []
        self._stamps: list[int] = []
        self._grid: dict[int, _GridPoint] = {}
        self._newest_step: int | None = None

    def clone(self) -> "VerticalTrack":
        """Return an independent copy for another estimator."""
        clone = copy.copy(self)
        clone._place = copy.deepcopy(self._place)
        clone._messages, clone._stamps, clone._grid = list(self._messages), list(self._stamps), dict(self._grid)
        return clone

    def step_time_base(self, step_ns: int) -> None:
        """Shift the stamps of fixes and deflections by a step of the time base; the distance restarts."""
        self._place.step_time_base(step_ns)
        self._messages = [replace(message, time_ns=message.time_ns + step_ns) for message in self._messages]
        self._stamps = [stamp_ns + step_ns for stamp_ns in self._stamps]
        self._grid.clear()
        self._newest_step = None

    # -- inputs ---------------------------------------------------------------------------------------------

    def rejection(self, given: "PositionFix | DeflectionReading") -> Rejection | None:
        """Return the rejection or a remark for an input, else None; call this method before :meth:`insert`."""
        if isinstance(given, PositionFix):
            return self._place.rejection(given)
        index = bisect.bisect_left(self._stamps, given.time_ns)
        if index < len(self._stamps) and self._stamps[index] == given.time_ns:
            return resolve_same_stamp(self._messages[index], given)[1]
        if index == 0 and len(self._stamps) >= _MAX_MESSAGES:
            return Rejection(Reason.LATE, "the stamp is older than all stored messages of this source")
        return None

    def insert(self, given: "PositionFix | DeflectionReading") -> int | None:
        """Add an input; return the time after which results may have changed, ns, None for no change."""
        changed_after_ns = self._place.insert(given) if isinstance(given, PositionFix) else self._insert_reading(given)
        if changed_after_ns is None:
            return None
        return self._drop_points_after(changed_after_ns)

    def drop_before(self, time_ns: int, needed_since_ns: int) -> None:
        """Discard data that are no longer needed.

        Args:
            time_ns: inputs before this time are final.
            needed_since_ns: earliest time for which the vertical is still needed.
        """
        settled, oldest = time_ns // STEP_NS, needed_since_ns // STEP_NS
        if self._newest_step is not None:
            # Later points are computed from the point at this step, so it must exist.
            self._grid_point(max(settled, self._newest_step))
        self._place.drop_before(settled * STEP_NS)
        # Points are in time order, because each is computed after the one before it.
        while self._grid and ((first := next(iter(self._grid))) < oldest or len(self._grid) > _MAX_STEPS):
            del self._grid[first]
        passed = bisect.bisect_right(self._stamps, settled * STEP_NS) - 1
        if passed > 0:
            del self._stamps[:passed], self._messages[:passed]

    # -- results --------------------------------------------------------------------------------------------

    def at(self, time_ns: int) -> LocalVertical:
        """Return the vertical at a time.

        Calls for times in one interval return the same object until an input changes the vertical, except for intervals
        before the stored ones.
        """
        return self._grid_point(time_ns // STEP_NS).vertical

    def missing_data_text(self, time_ns: int) -> str:
        """Return a text about missing data at a time; empty if nothing is missing."""
        point = self._grid_point(time_ns // STEP_NS)
        if self._config.deflection == NONE:
            text = "no position fix: the error model of the INS uses the last latitude, or 0° before the first fix"
            return "" if point.place is not None else text
        if point.vertical.given_deflection is not None or self._config.deflection in (CONSTANT, "unknown"):
            return ""
        if self._table is None:
            return f"no message on gravity/deflection within max_age_s = {self._config.max_age_s:g}"
        if point.place is None:
            return "no position fix: the deflection table cannot be used"
        distance_km = 1e-3 * self._table.distance_m(point.place.observer.position)
        return (
            f"no row of the deflection table near the ship: the nearest is {distance_km:.0f} km away (gravity.table_…)"
        )

    def _grid_point(self, step: int) -> _GridPoint:
        found = self._grid.get(step)
        if found is not None:
            return found
        newest = self._newest_step
        if newest is None or step - newest > _MAX_STEPS:
            return self._store_point(step, self._first_point(step))
        if step < newest:
            # The point is before the first computed point, or was discarded.
            return self._first_point(step)
        point = self._grid[newest]
        for later in range(newest + 1, step + 1):
            point = self._store_point(later, self._next_point(point, later))
        return point

    def _store_point(self, step: int, point: _GridPoint) -> _GridPoint:
        self._grid[step], self._newest_step = point, step
        return point

    def _first_point(self, step: int) -> _GridPoint:
        """Return the point at a step without using an earlier point; its distance is zero."""
        place = self._place_at(step)
        return _GridPoint(self._local_vertical(step, 0.0, place, _BEFORE_FIRST_FIX), place, place)

    def _next_point(self, before: _GridPoint, step: int) -> _GridPoint:
        """Return the point one step later."""
        place, run_m = self._place_at(step), before.vertical.distance_run_m
        if place is None:
            # Without a position the distance is extrapolated with the last velocity.
            run_m += math.hypot(*before.vertical.velocity_m_per_s) * STEP_NS / SECOND_NS
            return _GridPoint(self._local_vertical(step, run_m, None, before.vertical), before.anchor, None)
        if before.anchor is None:
            return _GridPoint(self._local_vertical(step, run_m, place, before.vertical), place, place)
        distance_m = _distance_m(before.anchor, place)
        has_moved = distance_m >= _MIN_MOVE_M
        if has_moved and before.place is not None:
            run_m += distance_m
        anchor = place if has_moved or before.place is None else before.anchor
        return _GridPoint(self._local_vertical(step, run_m, place, before.vertical), anchor, place)

    def _local_vertical(
        self, step: int, run_m: float, place: ShipPosition | None, before: LocalVertical
    ) -> LocalVertical:
        """Return the vertical at a step; without a position, latitude and velocity are from the step before."""
        latitude, velocity = before.latitude, before.velocity_m_per_s
        if place is not None:
            latitude = float(place.observer.position.latitude)
            north, _, east = place.observer.velocity_n_m_per_s.tolist()
            velocity = north, east
        given, covariance = self._given_deflection(step, place) or (None, self._unknown_covariance)
        return LocalVertical(run_m, latitude, velocity, given, covariance)

    def _given_deflection(self, step: int, place: ShipPosition | None) -> tuple[FloatArray, FloatArray] | None:
        """Return the known deflection and its error covariance; None if the deflection is unknown."""
        config = self._config
        if config.deflection == CONSTANT:
            return ARCSEC * np.array([config.xi_arcsec, config.eta_arcsec]), self._given_covariance
        if self._table is not None:
            deflection = None if place is None else self._table.at(place.observer.position)
            return None if deflection is None else (deflection, self._given_covariance)
        last = bisect.bisect_right(self._stamps, step * STEP_NS) - 1
        if last < 0 or step * STEP_NS - self._stamps[last] > config.max_age_s * SECOND_NS:
            return None
        message = self._messages[last]
        covariance = self._given_covariance if message.covariance is None else message.covariance
        return message.deflection, covariance

    def _place_at(self, step: int) -> ShipPosition | None:
        place = self._place.position_at(step * STEP_NS)
        return None if isinstance(place, Rejection) else place

    # ---------------------------------------------------------------------------------------------------------

    def _insert_reading(self, message: DeflectionReading) -> int | None:
        """Insert a message by its stamp; of two messages with one stamp, the message whose bytes sort first is kept."""
        index = bisect.bisect_left(self._stamps, message.time_ns)
        if index < len(self._stamps) and self._stamps[index] == message.time_ns:
            if self._messages[index].content() <= message.content():
                return None
            self._messages[index] = message
        elif index == 0 and len(self._stamps) >= _MAX_MESSAGES:
            return None
        else:
            self._stamps.insert(index, message.time_ns)
            self._messages.insert(index, message)
            if len(self._stamps) > _MAX_MESSAGES:
                del self._stamps[0], self._messages[0]
        return message.time_ns - 1

    def _drop_points_after(self, time_ns: int) -> int | None:
        """Discard the points after a time; return the time after which points were discarded, None without any."""
        gone = [step for step in self._grid if step * STEP_NS > time_ns]
        for step in gone:
            del self._grid[step]
        if not gone:
            return None
        self._newest_step = max(self._grid, default=None)
        return min(gone) * STEP_NS - 1


def _distance_m(earlier: ShipPosition, later: ShipPosition) -> float:
    """Return the distance over ground between two nearby positions, m."""
    radius_north_m, radius_east_m = earlier.horizon_radii_m
    here, there = earlier.observer.position, later.observer.position
    east = math.remainder(float(there.longitude - here.longitude), 2.0 * math.pi)
    north_m = float((there.latitude - here.latitude) * radius_north_m)
    return math.hypot(north_m, float(east * math.cos(here.latitude) * radius_east_m))
