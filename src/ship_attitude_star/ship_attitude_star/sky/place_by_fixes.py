"""The ship's place at any moment, from position fixes.

The place is extrapolated from fixes that were stamped ``gnss_delay_s`` or more before the moment, on the line that they
lie on. A fix that comes within this delay changes no answer, so that nothing is compared anew because of it. In 1.5 s
a ship leaves the line by half a metre, 0.016″ (0.1 m/s²). The line is straight in Earth-fixed coordinates, so that
neither the date line nor a pole is special. At the beginning, and after a time without fixes, such a line is not known
yet: the place then lies on the line through the two fixes nearest in time, later ones too. The first fixes are
provisional until ten agree (:mod:`ship_attitude_star.sky.stamped_values`); while others contradict them, no place is
known. Whatever the order of arrival, the answers are the same.
"""

import bisect
import math
from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.measurements.readings import PositionFix
from ship_attitude_star.sky.config import SkyConfig
from ship_attitude_star.sky.stamped_values import JumpLimits, StampedValues
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.geodetic import (
    ecef_from_geodetic,
    geodetic_from_ecef,
    horizon_radii_m,
    rotation_horizon_from_ecef,
)
from ship_geometry.rotations import FloatArray
from ship_geometry.star_directions import Observer
from ship_geometry.time_scales import SECOND_NS

ACCELERATION_SIGMA_M_PER_S2 = 0.1
"""Acceleration with which a ship leaves the straight line, standard deviation of each horizontal axis.

A ship that turns by 0.6°/s at 10 m/s has it.
"""

LINE_NS = 5 * SECOND_NS
"""Time between the two fixes that give the line beyond them.

After one second more it errs by 0.3 m, as the ship accelerates. Of an error that each fix has by itself the line makes
1.2 times as much; with fixes a second apart it were 2.2 times, with a tenth of a second 15 times.
"""

SPEED_SIGMA_M_PER_S = 10.0
"""Speed of a ship of which only one fix is known, standard deviation of each horizontal axis."""

JUMP_LASTS_S = 25.0
"""A position that has jumped is believed after this time, s. A node cannot know which of two positions is right, and a
wrong one may have come first: it must be left as soon as a right one."""

SETTLED_BY_FIXES = 10
"""Number of different fixes that agree after which a position is established; before, as many others replace it."""

FIX_AT_ONCE_M = 50.0
"""What a position may change at once: from one antenna to another, from one solution of a receiver to a better one.

Stars hardly know it: 31 m make 1″.
"""


@dataclass(frozen=True)
class Place:
    """The ship's place at one moment.

    Attributes:
        observer: position on WGS 84 and velocity over ground.
        covariance_m2: of the position in (North, Up, East), m², shape (3, 3).
        age_s: time between the moment and the nearest of the fixes that tell the place.
        horizon_radii_m: radii of curvature of the ellipsoid along the meridian and along the parallel.
    """

    observer: Observer
    covariance_m2: FloatArray
    age_s: float
    horizon_radii_m: tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class _Fix:
    """A position fix in Earth-fixed coordinates.

    Attributes:
        ecef_m: the antenna, shape (3,).
        covariance_ecef_m2: of it, shape (3, 3).
        below_m: the point of the ellipsoid below it: heights, of which stars know nothing, are not compared.
        sigma: horizontal, of both axes together, m.
    """

    ecef_m: FloatArray
    covariance_ecef_m2: FloatArray
    below_m: list[float]
    sigma: float

    def content(self) -> bytes:
        return self.ecef_m.tobytes() + self.covariance_ecef_m2.tobytes()

    def away(self, other: "_Fix") -> float:
        return math.dist(self.below_m, other.below_m)


class PlaceByFixes:
    """Position fixes by their stamps, and the place that they tell.

    Args:
        config: how old a fix may be and must be, and how fast the ship.
    """

    def __init__(self, config: SkyConfig) -> None:
        self._fix_max_age_s = config.fix_max_age_s
        self._fix_max_age_ns = round(config.fix_max_age_s * SECOND_NS)
        self._delay_ns = round(config.gnss_delay_s * SECOND_NS)
        self._oldest_ns: int | None = None
        lasts_s = min(JUMP_LASTS_S, config.fix_max_age_s)
        reach = JumpLimits(FIX_AT_ONCE_M, config.max_speed_m_per_s, lasts_s, "m", SETTLED_BY_FIXES)
        self._fixes: StampedValues[_Fix] = StampedValues(reach)

    def refusal(self, fix: PositionFix) -> Refusal | None:
        """Why a fix is not used, or not as it came; to be asked before :meth:`insert`."""
        return self._fixes.refusal(fix.time_ns, _earth_fixed(fix))

    def insert(self, fix: PositionFix) -> int | None:
        """Take a fix; returns the moment (ns) after which answers may have changed, None for nothing."""
        changed_ns = self._fixes.insert(fix.time_ns, _earth_fixed(fix))
        disputed_ns = self._fixes.disputed_since_ns
        told_ns = [] if disputed_ns is None else [disputed_ns + self._delay_ns - 1]
        if changed_ns is not None:
            told_ns.append(self._after_change(changed_ns))
        return min(told_ns, default=None)

    def _after_change(self, changed_ns: int) -> int:
        """The moment after which answers may differ where the fixes believed differ from a stamp on."""
        times, index = self._fixes.times, bisect.bisect_left(self._fixes.times, changed_ns)
        if index < 2:
            return 0  # the first two fixes give the velocity for all times before them
        # At the fix before the new one gives another velocity; where that fix is alone, on its far side too.
        nearest_after_ns = times[index - 1] - 1 if self._joined(index - 2) else times[index - 2]
        return self._by_lines(nearest_after_ns, changed_ns + self._delay_ns - 1)

    def _by_lines(self, after_ns: int, until_ns: int) -> int:
        """The last moment up to which, from ``after_ns`` on, no place needs the nearest fixes; at most ``until_ns``."""
        told_ns = after_ns if self._oldest_ns is None else max(after_ns, self._oldest_ns - 1)
        while told_ns < until_ns:
            line = self._line(told_ns + 1)
            if line is None:
                break
            # It serves until the next fix is old enough, or its own last one is too old.
            _, last = line
            old_enough_ns = [time_ns + self._delay_ns - 1 for time_ns in self._fixes.times[last + 1 : last + 2]]
            told_ns = min([self._fixes.times[last] + self._fix_max_age_ns, until_ns, *old_enough_ns])
        return told_ns

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``; no earlier ones may be asked for any more."""
        self._oldest_ns = time_ns
        last = self._fixes.last_before(time_ns - self._delay_ns)
        self._fixes.drop_before(self._fixes.times[self._first(last)] if last >= 0 else time_ns - self._delay_ns)

    def step_time_base(self, step_ns: int) -> None:
        """Carry the fixes that are believed over a step of the clocks."""
        self._oldest_ns, self._fixes = None, self._fixes.with_shifted_stamps(step_ns)

    def at(self, time_ns: int) -> Place | Refusal:
        """The place at a moment, or NO_FIX where no fix is near enough in time, or a provisional one is disputed.

        Errors of successive fixes are taken to be alike, as those of GNSS are: no averaging makes them better. The
        error that the straight line leaves out grows with the time to its two fixes.
        """
        if self._fixes.is_disputed(time_ns - self._delay_ns):
            disputed = "the first position fixes contradict one another"
            return Refusal(Reason.NO_FIX, f"{disputed}: known once {SETTLED_BY_FIXES} in a row agree")
        line = self._line(time_ns)
        return self._place_by_nearest(time_ns) if line is None else self._place_on_line(*line, time_ns)

    def _line(self, time_ns: int) -> tuple[int, int] | None:
        """Indices of the two fixes, both older than the delay, on whose line the ship is at a moment.

        None where the last one is too old, or where they are nearer to one another than to the moment: the line would
        only make more of their errors.
        """
        times, last = self._fixes.times, self._fixes.last_before(time_ns - self._delay_ns)
        if last < 0 or time_ns - times[last] > self._fix_max_age_ns:
            return None
        first = self._first(last)
        return (first, last) if first < last and times[last] - times[first] >= self._delay_ns else None

    def _first(self, last: int) -> int:
        """Index of the fix from which a line leads to a later one, :data:`LINE_NS` long or as long as there are any."""
        times, first = self._fixes.times, last
        while first > 0 and times[last] - times[first] < LINE_NS and self._joined(first - 1):
            first -= 1
        return first

    def _place_by_nearest(self, time_ns: int) -> Place | Refusal:
        times, last = self._fixes.times, self._fixes.last_before(time_ns)
        if not times:
            return Refusal(Reason.NO_FIX, "no position fix yet: is gnss/fix published?")
        # Of two fixes equally near the earlier one counts.
        later = last < 0 or (last + 1 < len(times) and times[last + 1] - time_ns < time_ns - times[last])
        nearest = last + 1 if later else last
        away_s = (time_ns - times[nearest]) / SECOND_NS
        if abs(time_ns - times[nearest]) > self._fix_max_age_ns:
            text = f"the nearest position fix is {abs(away_s):.1f} s {'older' if away_s > 0 else 'younger'}"
            return Refusal(Reason.NO_FIX, f"{text}: more than fix_max_age_s = {self._fix_max_age_s:g}")
        pair = self._pair(nearest, time_ns)
        if pair is not None:
            return self._place_on_line(pair, pair + 1, time_ns)
        fix, age_s = self._fixes.values[nearest], abs(away_s)
        return _place(fix.ecef_m, np.zeros(3), fix.covariance_ecef_m2, SPEED_SIGMA_M_PER_S * age_s, age_s)

    def _place_on_line(self, first: int, last: int, time_ns: int) -> Place:
        """The place at a moment on the line through two fixes."""
        times, start, end = self._fixes.times, self._fixes.values[first], self._fixes.values[last]
        since_start_s, since_end_s = (time_ns - times[first]) / SECOND_NS, (time_ns - times[last]) / SECOND_NS
        span_s = since_start_s - since_end_s
        velocity_ecef = (end.ecef_m - start.ecef_m) / span_s
        share = min(max(since_start_s / span_s, 0.0), 1.0)
        return _place(
            start.ecef_m + since_start_s * velocity_ecef,
            velocity_ecef,
            (1.0 - share) * start.covariance_ecef_m2 + share * end.covariance_ecef_m2,
            # Remainder of the line through two points of a curve with this second derivative.
            0.5 * ACCELERATION_SIGMA_M_PER_S2 * abs(since_start_s * since_end_s),
            min(abs(since_start_s), abs(since_end_s)),
        )

    def _pair(self, nearest: int, time_ns: int) -> int | None:
        """Index of the first of two successive fixes that give the line; None where no two are near enough in time.

        One of the two is the nearest fix. The other is its neighbour on the far side of the moment, where there is
        one.
        """
        times = self._fixes.times
        left = nearest if times[nearest] <= time_ns else nearest - 1
        for index in (left, left - 1) if left == nearest else (left, left + 1):
            # Wherever a moment lies between fixes so near to one another, one of them is young enough.
            if 0 <= index < len(times) - 1 and self._joined(index):
                return index
        return None

    def _joined(self, index: int) -> bool:
        """Whether a line leads from a fix to the next one: not across a long time, nor across a jump."""
        times = self._fixes.times
        return times[index + 1] - times[index] <= 2 * self._fix_max_age_ns and not self._fixes.anew[index + 1]


def _earth_fixed(fix: PositionFix) -> _Fix:
    rotation = rotation_horizon_from_ecef(fix.position.latitude, fix.position.longitude)
    below_m = ecef_from_geodetic(replace(fix.position, height_m=0.0)).tolist()
    sigma_m = math.sqrt(max(fix.covariance_m2[0, 0] + fix.covariance_m2[2, 2], 0.0))
    return _Fix(ecef_from_geodetic(fix.position), rotation.T @ fix.covariance_m2 @ rotation, below_m, sigma_m)


def _place(
    ecef_m: FloatArray, velocity_ecef: FloatArray, covariance_ecef_m2: FloatArray, drift_m: float, age_s: float
) -> Place:
    """A place from Earth-fixed vectors, with a further error ``drift_m`` (m) of each horizontal axis."""
    position = geodetic_from_ecef(ecef_m)
    rotation = rotation_horizon_from_ecef(position.latitude, position.longitude)
    covariance_m2 = rotation @ covariance_ecef_m2 @ rotation.T
    covariance_m2[0, 0] += drift_m**2
    covariance_m2[2, 2] += drift_m**2
    return Place(Observer(position, rotation @ velocity_ecef), covariance_m2, age_s, horizon_radii_m(position))
