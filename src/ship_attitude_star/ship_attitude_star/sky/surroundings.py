"""The ship's place and the air around it at any moment, from position fixes and readings of the air.

The place is extrapolated from fixes that were stamped ``gnss_delay_s`` or more before the moment, on the line that they
lie on. A fix that comes within this delay changes no answer, so that nothing is compared anew because of it. In 1.5 s
a ship leaves the line by half a metre, 0.016″ (0.1 m/s²). The line is straight in Earth-fixed coordinates, so that
neither the date line nor a pole is special. At the beginning, and after a time without fixes, such a line is not known
yet: the place then lies on the line through the two fixes nearest in time, later ones too.

The air is what was measured last, the delay before the moment or earlier; where nothing was measured, parameters stand
in. A fix or a reading that has jumped is left out: the last good ones go on, with an error that grows
(:mod:`ship_attitude_star.sky.stamped_values`). Whatever the order of arrival, the answers are the same.
"""

import bisect
import math
import struct
from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.measurements.readings import AirReading, PositionFix, SkyInput
from ship_attitude_star.sky.config import SkyConfig
from ship_attitude_star.sky.stamped_values import JumpLimits, StampedValues
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.geodetic import (
    ecef_from_geodetic,
    geodetic_from_ecef,
    horizon_radii_m,
    rotation_horizon_from_ecef,
)
from ship_geometry.refraction import Weather
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

FIX_AT_ONCE_M = 50.0
"""What a position may change at once: from one antenna to another, from one solution of a receiver to a better one.

Stars hardly know it: 31 m make 1″.
"""

PRESSURE_AT_ONCE_HPA = 5.0
"""What a barometer may change at once: gusts at its inlet (30 m/s: 5 hPa), heave (10 m: 1 hPa), a squall (2 hPa)."""

PRESSURE_PER_H_HPA = 30.0
"""Ten times what WMO-No. 305 (1993, VI.21) tolerates within an hour: a typhoon may pass."""

TEMPERATURE_AT_ONCE_K = 5.0
"""What a thermometer may change at once: the plume of the funnel, the sun."""

TEMPERATURE_PER_H_K = 40.0
"""Ten times what WMO-No. 305 (1993, VI.21) tolerates within an hour: the outflow of a thunderstorm may arrive."""


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
class Air:
    """The air at the ship at one moment.

    Attributes:
        weather: pressure, temperature, humidity.
        pressure_sigma_hpa: standard deviation of the pressure; it grows with the age of the reading.
        temperature_sigma_k: standard deviation of the temperature; it grows likewise.
    """

    weather: Weather
    pressure_sigma_hpa: float
    temperature_sigma_k: float


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


@dataclass(frozen=True)
class _Value:
    """A quantity of the air with its standard deviation, both in the unit of the quantity."""

    value: float
    sigma: float

    def content(self) -> bytes:
        return struct.pack("<dd", self.value, self.sigma)

    def away(self, other: "_Value") -> float:
        return abs(self.value - other.value)


class _Quantity:
    """One quantity of the air: its readings, and the value that holds without any.

    Args:
        default: holds without a reading, and after the last one has grown too old.
        measured_sigma: standard deviation of a reading whose message gives none.
        limits: what the air cannot have changed by; a reading holds for as long as these say that a jump must last.
        delay_ns: a reading holds from so long after its stamp on; before, where no earlier one holds.
    """

    def __init__(self, default: _Value, measured_sigma: float, limits: JumpLimits, delay_ns: int) -> None:
        self._default = default
        self._measured_sigma = measured_sigma
        self._max_age_ns, self._delay_ns = limits.lasts_s * SECOND_NS, delay_ns
        self.readings: StampedValues[_Value] = StampedValues(limits)

    def measured(self, reading: AirReading) -> _Value:
        return _Value(reading.value, self._measured_sigma if reading.sigma is None else reading.sigma)

    def insert(self, reading: AirReading) -> int | None:
        """Take a reading; returns the moment (ns) after which answers may have changed, None for nothing."""
        changed_ns = self.readings.insert(reading.time_ns, self.measured(reading))
        if changed_ns is None:
            return None
        # Where an earlier reading holds until the delay is over, nobody has asked for this one before.
        holds = self._young(changed_ns - self._delay_ns, changed_ns + self._delay_ns)
        return changed_ns - 1 + (0 if holds is None else self._delay_ns)

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``."""
        self.readings.drop_before(time_ns - self._delay_ns)

    def holding(self, time_ns: int) -> int | None:
        """Index of the reading that holds at a moment; None where none does."""
        delayed = self._young(time_ns - self._delay_ns, time_ns)
        return self._young(time_ns, time_ns) if delayed is None else delayed

    def _young(self, before_ns: int, time_ns: int) -> int | None:
        """Index of the last reading at or before a moment, where it is young enough at ``time_ns``."""
        last = self.readings.last_before(before_ns)
        return last if last >= 0 and time_ns - self.readings.times[last] <= self._max_age_ns else None

    def at(self, time_ns: int) -> _Value:
        """The value at a moment.

        The variance of a reading grows in its life to that of the default, unless it is larger from the beginning.
        """
        index = self.holding(time_ns)
        if index is None:
            return self._default
        reading, age_ns = self.readings.values[index], time_ns - self.readings.times[index]
        growth = max(0.0, self._default.sigma**2 - reading.sigma**2)
        return _Value(reading.value, math.sqrt(reading.sigma**2 + growth * age_ns / self._max_age_ns))


_ANSWERS_KEPT = 256
"""Moments of which the answer is kept: exposures that are applied again ask again, 28 a second in two seconds."""


class Surroundings:
    """Position fixes and readings of the air by their stamps, and what they tell of any moment.

    Args:
        config: how old a fix and a reading may be, and what holds where the air was not measured.
    """

    def __init__(self, config: SkyConfig) -> None:
        self._fix_max_age_s = config.fix_max_age_s
        self._fix_max_age_ns = round(config.fix_max_age_s * SECOND_NS)
        self._delay_ns = round(config.gnss_delay_s * SECOND_NS)
        self._oldest_ns: int | None = None
        self._answers: dict[int, tuple[Place, Air]] = {}
        reach = JumpLimits(FIX_AT_ONCE_M, config.max_speed_m_per_s, config.fix_max_age_s, "m")
        self._fixes: StampedValues[_Fix] = StampedValues(reach)
        pressure = _Value(config.pressure_hpa, config.pressure_sigma_hpa)
        temperature = _Value(config.temperature_c, config.temperature_sigma_k)
        # The error of humidity is left out: from dry to saturated air, refraction changes as by 0.5 K at 10 °C, and as
        # by 2.5 K at 35 °C. For the same reason no change of it is a jump.
        humidity = _Value(config.relative_humidity, 0.0)
        max_age_s = config.weather_max_age_s
        by_weather = JumpLimits(PRESSURE_AT_ONCE_HPA, PRESSURE_PER_H_HPA / 3600.0, max_age_s, "hPa")
        by_warmth = JumpLimits(TEMPERATURE_AT_ONCE_K, TEMPERATURE_PER_H_K / 3600.0, max_age_s, "K")
        self._air = {
            "pressure": _Quantity(pressure, config.measured_pressure_sigma_hpa, by_weather, self._delay_ns),
            "temperature": _Quantity(temperature, config.measured_temperature_sigma_k, by_warmth, self._delay_ns),
            "humidity": _Quantity(humidity, 0.0, JumpLimits(1.0, 0.0, max_age_s, ""), self._delay_ns),
        }

    # -- inputs ---------------------------------------------------------------------------------------------

    def refusal(self, given: SkyInput) -> Refusal | None:
        """Why an input is not used, or not as it came; to be asked before :meth:`insert`.

        DUPLICATE or CONFLICT where an input of the same kind and stamp is known, LATE where it comes too long after
        later ones of its kind, JUMP where it has jumped. All inputs are inserted: of two with the same stamp the one
        whose bytes sort first is kept, and what has jumped tells something of those after it.
        """
        if isinstance(given, PositionFix):
            return self._fixes.refusal(given.time_ns, _earth_fixed(given))
        quantity = self._air[given.quantity]
        return quantity.readings.refusal(given.time_ns, quantity.measured(given))

    def insert(self, given: SkyInput) -> int | None:
        """Take a position fix or a reading of the air.

        Returns:
            The moment (ns) after which answers may have changed; None where no answer has changed.
        """
        if isinstance(given, PositionFix):
            changed_after_ns = self._insert_fix(given)
        else:
            changed_after_ns = self._air[given.quantity].insert(given)
        if changed_after_ns is not None:
            self._answers = {moment: told for moment, told in self._answers.items() if moment <= changed_after_ns}
        return changed_after_ns

    def _insert_fix(self, fix: PositionFix) -> int | None:
        changed_ns = self._fixes.insert(fix.time_ns, _earth_fixed(fix))
        if changed_ns is None:
            return None
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
        for quantity in self._air.values():
            quantity.drop_before(time_ns)

    # -- answers --------------------------------------------------------------------------------------------

    def at(self, time_ns: int) -> tuple[Place, Air] | Refusal:
        """Place and air at a moment, or NO_FIX where no fix is near enough in time.

        Errors of successive fixes are taken to be alike, as those of GNSS are: no averaging makes them better. The
        error that the straight line leaves out grows with the time to its two fixes. As long as no input has changed
        the answer, it is the same object.
        """
        known = self._answers.get(time_ns)
        if known is not None:
            return known
        place = self._place(time_ns)
        if isinstance(place, Refusal):
            return place
        pressure, temperature, humidity = [quantity.at(time_ns) for quantity in self._air.values()]
        weather = Weather(pressure.value, temperature.value, humidity.value)
        told = self._answers[time_ns] = place, Air(weather, pressure.sigma, temperature.sigma)
        if len(self._answers) > _ANSWERS_KEPT:
            del self._answers[next(iter(self._answers))]
        return told

    def not_measured(self, time_ns: int) -> list[str]:
        """Names of the quantities of the air that are taken from parameters at a moment."""
        return [name for name, quantity in self._air.items() if quantity.holding(time_ns) is None]

    def _place(self, time_ns: int) -> Place | Refusal:
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
    covariance_m2 += np.diag([drift_m**2, 0.0, drift_m**2])
    return Place(Observer(position, rotation @ velocity_ecef), covariance_m2, age_s, horizon_radii_m(position))
