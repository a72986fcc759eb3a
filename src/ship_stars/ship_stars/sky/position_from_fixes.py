"""The ship's position at any time, from position fixes.

The position is extrapolated along the line through two fixes with stamps ``gnss_delay_s`` or more before the requested
time. A fix that arrives within this delay changes no result, so no exposure has to be processed again. With an
acceleration of 0.1 m/s² the error of the extrapolation is half a metre (0.016″) 1.5 s after the later fix. The line is
straight in Earth-fixed coordinates, so the date line and the poles need no special treatment.

At the start, and after a time without fixes, there is no such line. The position is then on the line through the
nearest fix and a neighbour of this fix; both may be later than the requested time. If no neighbour is usable, the
position is that of the nearest fix. The first fixes are provisional until ten fixes are consistent
(:mod:`ship_stars.sky.stamped_values`). While other fixes contradict provisional fixes, there is no position.
The results do not depend on the order of arrival.
"""

import bisect
import math
from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.geodetic import (
    ecef_from_geodetic,
    geodetic_from_ecef,
    horizon_radii_m,
    rotation_horizon_from_ecef,
)
from ship_geometry.earth.star_directions import Observer
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_stars.attitude_samples import PositionFix
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.stamped_values import JumpLimits, StampedValues

ACCELERATION_SIGMA_M_PER_S2 = 0.1
"""Standard deviation of the ship's acceleration off the straight line, each horizontal axis.

A ship that turns at 0.6°/s and 10 m/s has this acceleration.
"""

LINE_LENGTH_NS = 5 * SECOND_NS
"""Minimum time between the two fixes that define the extrapolation line, if connected fixes are that old, ns.

One second after the later fix, the acceleration of the ship causes an error of 0.3 m. Independent errors of the two
fixes are multiplied by 1.2. The factor would be 2.2 for fixes one second apart, and 15 for fixes 0.1 s apart.
"""

SPEED_SIGMA_M_PER_S = 10.0
"""Standard deviation of the ship's velocity, each horizontal axis, if the position is computed from a single fix."""

JUMP_CONFIRMATION_S = 25.0
"""Time after which a position that has jumped is accepted, s; ``fix_max_age_s`` is used instead if it is shorter.

It cannot be decided which of two positions is right; the first one may be wrong.
"""

MIN_CONSISTENT_FIXES = 10
"""Number of different consistent fixes that establish a position.

A position that is not yet established is replaced by another position with this number of consistent fixes.
"""

MAX_POSITION_STEP_M = 50.0
"""Largest step of a position that is not a jump, m, as after a change of antenna or of the receiver's solution type.

The effect of such a step on star directions is small: 31 m correspond to 1″.
"""


@dataclass(frozen=True)
class ShipPosition:
    """The ship's position at one time.

    Attributes:
        observer: position on WGS 84 and velocity over ground.
        covariance_m2: covariance of the position in (North, Up, East), m², shape (3, 3).
        age_s: time to the nearest fix that was used.
        horizon_radii_m: radii of curvature in the meridian and in the prime vertical, each plus the height.
    """

    observer: Observer
    covariance_m2: FloatArray
    age_s: float
    horizon_radii_m: tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class _Fix:
    """A position fix in Earth-fixed coordinates.

    Attributes:
        ecef_m: position of the antenna, shape (3,).
        covariance_ecef_m2: covariance of the position, shape (3, 3).
        ellipsoid_point_m: point of the ellipsoid below the antenna. Fixes are compared by these points, because heights
            do not affect stars.
        sigma: horizontal standard deviation, root of the sum of both variances, m.
    """

    ecef_m: FloatArray
    covariance_ecef_m2: FloatArray
    ellipsoid_point_m: list[float]
    sigma: float

    def content(self) -> bytes:
        return self.ecef_m.tobytes() + self.covariance_ecef_m2.tobytes()

    def distance_to(self, other: "_Fix") -> float:
        return math.dist(self.ellipsoid_point_m, other.ellipsoid_point_m)


class PositionFromFixes:
    """Position fixes in the order of their stamps, and the position at any time from these fixes.

    Args:
        config: age limits of fixes and the ship's maximum speed.
    """

    def __init__(self, config: SkyConfig) -> None:
        self._fix_max_age_s = config.fix_max_age_s
        self._fix_max_age_ns = round(config.fix_max_age_s * SECOND_NS)
        self._delay_ns = round(config.gnss_delay_s * SECOND_NS)
        self._oldest_ns: int | None = None
        confirmation_s = min(JUMP_CONFIRMATION_S, config.fix_max_age_s)
        limits = JumpLimits(MAX_POSITION_STEP_M, config.max_speed_m_per_s, confirmation_s, "m", MIN_CONSISTENT_FIXES)
        self._fixes: StampedValues[_Fix] = StampedValues(limits)

    def rejection(self, fix: PositionFix) -> Rejection | None:
        """Return the result of :meth:`StampedValues.rejection` for a fix; call this method before :meth:`insert`."""
        return self._fixes.rejection(fix.time_ns, _to_earth_fixed(fix))

    def insert(self, fix: PositionFix) -> int | None:
        """Insert a fix; return the time (ns) after which results may have changed, or None if no result has changed."""
        changed_ns = self._fixes.insert(fix.time_ns, _to_earth_fixed(fix))
        conflict_ns = self._fixes.conflict_changed_ns
        unchanged_until_ns = [] if conflict_ns is None else [conflict_ns + self._delay_ns - 1]
        if changed_ns is not None:
            unchanged_until_ns.append(self._last_unchanged_ns(changed_ns))
        return min(unchanged_until_ns, default=None)

    def _last_unchanged_ns(self, changed_ns: int) -> int:
        """Return the time after which positions may change if the accepted fixes change from ``changed_ns`` on."""
        times, index = self._fixes.times, bisect.bisect_left(self._fixes.times, changed_ns)
        if index < 2:
            return 0  # the first two fixes define the line for all earlier times
        # The velocity changes from the last unchanged fix on. If this fix is not connected to its predecessor, the
        # velocity between the two fixes may change too.
        nearest_after_ns = times[index - 1] - 1 if self._is_connected(index - 2) else times[index - 2]
        return self._extrapolated_until_ns(nearest_after_ns, changed_ns + self._delay_ns - 1)

    def _extrapolated_until_ns(self, after_ns: int, until_ns: int) -> int:
        """Return the last time up to which all positions after ``after_ns`` are extrapolated; at most ``until_ns``."""
        extrapolated_ns = after_ns if self._oldest_ns is None else max(after_ns, self._oldest_ns - 1)
        while extrapolated_ns < until_ns:
            line = self._line_fixes(extrapolated_ns + 1)
            if line is None:
                break
            # A line is used until the next fix is older than the delay, or the later fix of the line is too old.
            _, last = line
            old_enough_ns = [time_ns + self._delay_ns - 1 for time_ns in self._fixes.times[last + 1 : last + 2]]
            extrapolated_ns = min([self._fixes.times[last] + self._fix_max_age_ns, until_ns, *old_enough_ns])
        return extrapolated_ns

    def drop_before(self, time_ns: int) -> None:
        """Drop the fixes that are not needed for positions from ``time_ns`` on; earlier positions are lost."""
        self._oldest_ns = time_ns
        last = self._fixes.last_before(time_ns - self._delay_ns)
        self._fixes.drop_before(
            self._fixes.times[self._line_start_index(last)] if last >= 0 else time_ns - self._delay_ns
        )

    def step_time_base(self, step_ns: int) -> None:
        """Shift the accepted fixes of the last ten seconds by a step of the clocks; drop all other fixes."""
        self._oldest_ns, self._fixes = None, self._fixes.with_shifted_stamps(step_ns)

    def position_at(self, time_ns: int) -> ShipPosition | Rejection:
        """Return the position at a time, or NO_FIX.

        NO_FIX is returned if no fix is near enough in time, or if fixes contradict the provisional fixes. Errors of
        successive fixes are assumed to be equal, as they nearly are for GNSS, so averaging does not reduce the errors.
        The error of the straight line grows with the time to its two fixes.
        """
        if self._fixes.has_conflict_at(time_ns - self._delay_ns):
            text = "the first position fixes contradict one another"
            return Rejection(Reason.NO_FIX, f"{text}: no position until {MIN_CONSISTENT_FIXES} in a row are consistent")
        line = self._line_fixes(time_ns)
        return self._position_near_fixes(time_ns) if line is None else self._position_on_line(*line, time_ns)

    def _line_fixes(self, time_ns: int) -> tuple[int, int] | None:
        """Return the indices of the two fixes, both older than the delay, that define the line at a time.

        The result is None if no fix is older than the delay, or if the later fix is too old. The result is also None
        if the two fixes are less than the delay apart, because the extrapolation would then amplify their errors.
        """
        times, last = self._fixes.times, self._fixes.last_before(time_ns - self._delay_ns)
        if last < 0 or time_ns - times[last] > self._fix_max_age_ns:
            return None
        first = self._line_start_index(last)
        return (first, last) if first < last and times[last] - times[first] >= self._delay_ns else None

    def _line_start_index(self, last: int) -> int:
        """Return the index of the first fix of the line that ends at fix ``last``.

        The line starts at the last fix that is at least :data:`LINE_LENGTH_NS` before fix ``last``. If the fixes
        connected to fix ``last`` span less time, the line starts at the first of them.
        """
        times, first = self._fixes.times, last
        while first > 0 and times[last] - times[first] < LINE_LENGTH_NS and self._is_connected(first - 1):
            first -= 1
        return first

    def _position_near_fixes(self, time_ns: int) -> ShipPosition | Rejection:
        times, last = self._fixes.times, self._fixes.last_before(time_ns)
        if not times:
            return Rejection(Reason.NO_FIX, "no position fix received yet: check that gnss/fix is published")
        # If two fixes are equally near in time, the earlier one is used.
        later = last < 0 or (last + 1 < len(times) and times[last + 1] - time_ns < time_ns - times[last])
        nearest = last + 1 if later else last
        away_s = (time_ns - times[nearest]) / SECOND_NS
        if abs(time_ns - times[nearest]) > self._fix_max_age_ns:
            text = f"the nearest position fix is {abs(away_s):.1f} s {'older' if away_s > 0 else 'newer'}"
            return Rejection(Reason.NO_FIX, f"{text}: more than fix_max_age_s = {self._fix_max_age_s:g}")
        pair = self._neighbour_pair_index(nearest, time_ns)
        if pair is not None:
            return self._position_on_line(pair, pair + 1, time_ns)
        fix, age_s = self._fixes.values[nearest], abs(away_s)
        return _ship_position(fix.ecef_m, np.zeros(3), fix.covariance_ecef_m2, SPEED_SIGMA_M_PER_S * age_s, age_s)

    def _position_on_line(self, first: int, last: int, time_ns: int) -> ShipPosition:
        """Return the position at a time on the line through two fixes."""
        times, start, end = self._fixes.times, self._fixes.values[first], self._fixes.values[last]
        since_start_s, since_end_s = (time_ns - times[first]) / SECOND_NS, (time_ns - times[last]) / SECOND_NS
        span_s = since_start_s - since_end_s
        velocity_ecef = (end.ecef_m - start.ecef_m) / span_s
        share = min(max(since_start_s / span_s, 0.0), 1.0)
        return _ship_position(
            start.ecef_m + since_start_s * velocity_ecef,
            velocity_ecef,
            (1.0 - share) * start.covariance_ecef_m2 + share * end.covariance_ecef_m2,
            # Remainder of a linear interpolation between two points of a curve with this second derivative.
            0.5 * ACCELERATION_SIGMA_M_PER_S2 * abs(since_start_s * since_end_s),
            min(abs(since_start_s), abs(since_end_s)),
        )

    def _neighbour_pair_index(self, nearest: int, time_ns: int) -> int | None:
        """Return the index of the first of two successive fixes that define the line; None without such fixes.

        One of the two fixes is the nearest fix. The other is the neighbour of the nearest fix across the requested time
        if both are connected, else the neighbour on the other side.
        """
        times = self._fixes.times
        left = nearest if times[nearest] <= time_ns else nearest - 1
        for index in (left, left - 1) if left == nearest else (left, left + 1):
            # Connected fixes are at most twice fix_max_age_s apart, so any time between them is near enough to a fix.
            if 0 <= index < len(times) - 1 and self._is_connected(index):
                return index
        return None

    def _is_connected(self, index: int) -> bool:
        """True if a line may connect a fix to the next fix, with no long gap and no jump between them."""
        times = self._fixes.times
        return times[index + 1] - times[index] <= 2 * self._fix_max_age_ns and not self._fixes.follows_jump[index + 1]


def _to_earth_fixed(fix: PositionFix) -> _Fix:
    rotation = rotation_horizon_from_ecef(fix.position.latitude, fix.position.longitude)
    below_m = ecef_from_geodetic(replace(fix.position, height_m=0.0)).tolist()
    sigma_m = math.sqrt(max(fix.covariance_m2[0, 0] + fix.covariance_m2[2, 2], 0.0))
    return _Fix(ecef_from_geodetic(fix.position), rotation.T @ fix.covariance_m2 @ rotation, below_m, sigma_m)


def _ship_position(
    ecef_m: FloatArray, velocity_ecef: FloatArray, covariance_ecef_m2: FloatArray, drift_m: float, age_s: float
) -> ShipPosition:
    """Return a position from Earth-fixed vectors, with an additional error of ``drift_m`` on each horizontal axis."""
    position = geodetic_from_ecef(ecef_m)
    rotation = rotation_horizon_from_ecef(position.latitude, position.longitude)
    covariance_m2 = rotation @ covariance_ecef_m2 @ rotation.T
    covariance_m2[0, 0] += drift_m**2
    covariance_m2[2, 2] += drift_m**2
    return ShipPosition(Observer(position, rotation @ velocity_ecef), covariance_m2, age_s, horizon_radii_m(position))
