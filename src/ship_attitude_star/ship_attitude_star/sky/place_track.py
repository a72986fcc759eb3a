"""The ship's place at any moment, from position fixes: on the line through the two fixes nearest to it.

The line is straight in Earth-fixed coordinates, so that neither the date line nor a pole is special.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.sky.surroundings import Place
from ship_attitude_star.stars.star_config import SkyConfig
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stamped_values import StampedValues
from ship_geometry.geodetic import (
    GeodeticPosition,
    ecef_from_geodetic,
    geodetic_from_ecef,
    rotation_horizon_from_ecef,
)
from ship_geometry.rotations import FloatArray
from ship_geometry.star_directions import Observer

ACCELERATION_SIGMA_M_PER_S2 = 0.1
"""By which a ship leaves the straight line, each horizontal axis: a turn of 0.6°/s at 10 m/s."""

SPEED_SIGMA_M_PER_S = 10.0
"""Of a ship of which there is one fix only, each horizontal axis."""

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class _Fix:
    ecef_m: FloatArray
    covariance_ecef_m2: FloatArray

    def content(self) -> bytes:
        return self.ecef_m.tobytes() + self.covariance_ecef_m2.tobytes()


class PlaceTrack:
    """Position fixes by their stamps; any order of arrival gives the same answers.

    Args:
        config: how old a fix may be.
    """

    def __init__(self, config: SkyConfig) -> None:
        self._max_age_s = config.fix_max_age_s
        self._max_age_ns = round(config.fix_max_age_s * _SECOND_NS)
        self._fixes: StampedValues[_Fix] = StampedValues()

    def refusal(self, time_ns: int, position: GeodeticPosition, covariance_m2: FloatArray) -> Refusal | None:
        """Why :meth:`insert` will not take a fix, or will put it in the place of another; None where it is new."""
        return self._fixes.refusal(time_ns, _fix(position, covariance_m2))

    def insert(self, time_ns: int, position: GeodeticPosition, covariance_m2: FloatArray) -> int | None:
        """Take a fix.

        Args:
            time_ns: its stamp.
            position: antenna.
            covariance_m2: in (North, Up, East), shape (3, 3).

        Returns:
            The moment after which answers may have changed; None where none did.
        """
        index = self._fixes.insert(time_ns, _fix(position, covariance_m2))
        if index is None:
            return None
        times = self._fixes.times
        if index < 2:
            return 0  # the first two tell the velocity for all times before
        # Where its neighbour is alone, a fix tells the velocity on the other side of it too.
        joined = times[index - 1] - times[index - 2] <= 2 * self._max_age_ns
        return times[index - 1] if joined else times[index - 2]

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``."""
        # Two fixes before the moment give place and velocity until the next comes.
        self._fixes.forget(self._fixes.last_before(time_ns) - 1)

    def at(self, time_ns: int) -> Place | None:
        """The place at a moment; None where :meth:`reason_against` says why.

        Fixes are taken to err alike from one to the next, as GNSS does: no averaging makes them better. What the
        straight line leaves out grows with the time to its two fixes.
        """
        nearest = self._nearest(time_ns)
        if nearest is None or not self._young(nearest, time_ns):
            return None
        age_s = abs(time_ns - self._fixes.times[nearest]) / _SECOND_NS
        pair = self._pair(nearest, time_ns)
        if pair is None:
            fix = self._fixes.values[nearest]
            return _place(fix.ecef_m, np.zeros(3), fix.covariance_ecef_m2, SPEED_SIGMA_M_PER_S * age_s, age_s)
        times, (first, second) = self._fixes.times, (self._fixes.values[index] for index in pair)
        since_first_s, since_second_s = ((time_ns - times[index]) / _SECOND_NS for index in pair)
        span_s = since_first_s - since_second_s
        velocity_ecef = (second.ecef_m - first.ecef_m) / span_s
        share = min(max(since_first_s / span_s, 0.0), 1.0)
        return _place(
            first.ecef_m + since_first_s * velocity_ecef,
            velocity_ecef,
            (1.0 - share) * first.covariance_ecef_m2 + share * second.covariance_ecef_m2,
            # Remainder of the line through two points of a curve with this second derivative.
            0.5 * ACCELERATION_SIGMA_M_PER_S2 * abs(since_first_s * since_second_s),
            age_s,
        )

    def reason_against(self, time_ns: int) -> Refusal | None:
        """Why there is no place at a moment; None where there is one."""
        nearest = self._nearest(time_ns)
        if nearest is None:
            return Refusal(Reason.NO_FIX, "no position fix yet: is gnss/fix published?")
        if self._young(nearest, time_ns):
            return None
        away_s = (time_ns - self._fixes.times[nearest]) / _SECOND_NS
        text = f"the nearest position fix is {abs(away_s):.1f} s {'older' if away_s > 0 else 'younger'}"
        return Refusal(Reason.NO_FIX, f"{text}: more than fix_max_age_s = {self._max_age_s:g}")

    def _nearest(self, time_ns: int) -> int | None:
        """Index of the fix nearest in time; of two the earlier."""
        before = self._fixes.last_before(time_ns)
        around = [index for index in (before, before + 1) if 0 <= index < len(self._fixes.times)]
        return min(around, key=lambda index: abs(self._fixes.times[index] - time_ns), default=None)

    def _young(self, index: int, time_ns: int) -> bool:
        return abs(self._fixes.times[index] - time_ns) <= self._max_age_ns

    def _pair(self, nearest: int, time_ns: int) -> tuple[int, int] | None:
        """The nearest fix and its neighbour, the one across the moment if there is one; None where both are too far."""
        times = self._fixes.times
        left = nearest if times[nearest] <= time_ns else nearest - 1
        for index in (left, left - 1) if left == nearest else (left, left + 1):
            # Between joined fixes one is always young.
            if 0 <= index < len(times) - 1 and times[index + 1] - times[index] <= 2 * self._max_age_ns:
                return index, index + 1
        return None


def _fix(position: GeodeticPosition, covariance_m2: FloatArray) -> _Fix:
    rotation = rotation_horizon_from_ecef(position.latitude, position.longitude)
    return _Fix(ecef_from_geodetic(position), rotation.T @ covariance_m2 @ rotation)


def _place(
    ecef_m: FloatArray, velocity_ecef: FloatArray, covariance_ecef_m2: FloatArray, drift_m: float, age_s: float
) -> Place:
    """A place from Earth-fixed vectors, with a further horizontal error."""
    position = geodetic_from_ecef(ecef_m)
    rotation = rotation_horizon_from_ecef(position.latitude, position.longitude)
    covariance_m2 = rotation @ covariance_ecef_m2 @ rotation.T
    covariance_m2 += np.diag([drift_m**2, 0.0, drift_m**2])
    return Place(Observer(position, rotation @ velocity_ecef), covariance_m2, age_s)
