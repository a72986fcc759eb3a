"""The ship's position and the air around it at any time, from position fixes and readings of the air.

The position comes from :mod:`ship_attitude_star.sky.position_from_fixes`. The air is the last reading stamped
``gnss_delay_s`` or more before the time; parameters replace missing readings. A fix or reading that has jumped is
rejected; the last accepted one stays in use with a growing error (:mod:`ship_attitude_star.sky.stamped_values`). The
results do not depend on the order of arrival.
"""

import math
import struct
from dataclasses import dataclass

from ship_attitude_star.measurements.readings import AirReading, PositionFix, SkyInput
from ship_attitude_star.sky.config import SkyConfig
from ship_attitude_star.sky.place_by_fixes import Place, PlaceByFixes
from ship_attitude_star.sky.stamped_values import JumpLimits, StampedValues
from ship_estimation.refusals import Rejection
from ship_geometry.refraction import Weather
from ship_geometry.time_scales import SECOND_NS

PRESSURE_AT_ONCE_HPA = 5.0
"""Largest step of the measured pressure: gusts at the inlet (30 m/s: 5 hPa), heave (10 m: 1 hPa), a squall (2 hPa)."""

PRESSURE_PER_H_HPA = 30.0
"""Maximum rate of the pressure: ten times the hourly tolerance of WMO-No. 305 (1993, VI.21), for a passing typhoon."""

TEMPERATURE_AT_ONCE_K = 5.0
"""Largest step of the measured temperature: the plume of the funnel, the sun."""

TEMPERATURE_PER_H_K = 40.0
"""Maximum rate of the temperature: ten times the hourly tolerance of WMO-No. 305 (1993, VI.21), for a thunderstorm."""


@dataclass(frozen=True)
class Air:
    """The air at the ship at one time.

    Attributes:
        weather: pressure, temperature, humidity.
        pressure_sigma_hpa: standard deviation of the pressure; grows with the age of the reading.
        temperature_sigma_k: standard deviation of the temperature; grows with the age of the reading.
    """

    weather: Weather
    pressure_sigma_hpa: float
    temperature_sigma_k: float


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
    """One quantity of the air: its readings and its default value.

    Args:
        default: value used without a recent reading.
        measured_sigma: standard deviation of a reading whose message gives none.
        limits: limits of a jump; their confirmation time is also the maximum age of a reading.
        delay_ns: age from which a reading is used; it is used earlier if no earlier reading is valid.
    """

    def __init__(self, default: _Value, measured_sigma: float, limits: JumpLimits, delay_ns: int) -> None:
        self._default = default
        self._measured_sigma = measured_sigma
        self._max_age_ns, self._delay_ns = limits.confirmation_s * SECOND_NS, delay_ns
        self.readings: StampedValues[_Value] = StampedValues(limits)

    def measured(self, reading: AirReading) -> _Value:
        return _Value(reading.value, self._measured_sigma if reading.sigma is None else reading.sigma)

    def insert(self, reading: AirReading) -> int | None:
        """Insert a reading; return the time (ns) after which results may have changed, None if none has."""
        changed_ns = self.readings.insert(reading.time_ns, self.measured(reading))
        if changed_ns is None:
            return None
        # While an earlier reading is in use until the delay is over, no result has depended on this one.
        holds = self._young(changed_ns - self._delay_ns, changed_ns + self._delay_ns)
        return changed_ns - 1 + (0 if holds is None else self._delay_ns)

    def drop_before(self, time_ns: int) -> None:
        """Drop the readings that times at or after ``time_ns`` do not need."""
        self.readings.drop_before(time_ns - self._delay_ns)

    def holding(self, time_ns: int) -> int | None:
        """Return the index of the reading used at a time; None if there is none."""
        delayed = self._young(time_ns - self._delay_ns, time_ns)
        return self._young(time_ns, time_ns) if delayed is None else delayed

    def _young(self, before_ns: int, time_ns: int) -> int | None:
        """Return the index of the last reading at or before ``before_ns``, None if it is too old at ``time_ns``."""
        last = self.readings.last_before(before_ns)
        return last if last >= 0 and time_ns - self.readings.times[last] <= self._max_age_ns else None

    def at(self, time_ns: int) -> _Value:
        """Return the value at a time.

        The variance of a reading grows with its age up to that of the default, unless it is larger from the start.
        """
        index = self.holding(time_ns)
        if index is None:
            return self._default
        reading, age_ns = self.readings.values[index], time_ns - self.readings.times[index]
        growth = max(0.0, self._default.sigma**2 - reading.sigma**2)
        return _Value(reading.value, math.sqrt(reading.sigma**2 + growth * age_ns / self._max_age_ns))


_ANSWERS_KEPT = 256
"""Number of times with cached results: repeated exposures request the same times, 28 per second over two seconds."""


class Surroundings:
    """Position fixes and readings of the air by their stamps, and the position and air at any time.

    Args:
        config: maximum ages of fixes and readings, and default values of the air.
    """

    def __init__(self, config: SkyConfig) -> None:
        self._place = PlaceByFixes(config)
        delay_ns = round(config.gnss_delay_s * SECOND_NS)
        self._answers: dict[int, tuple[Place, Air]] = {}
        pressure = _Value(config.pressure_hpa, config.pressure_sigma_hpa)
        temperature = _Value(config.temperature_c, config.temperature_sigma_k)
        # The error of humidity is neglected: from dry to saturated air, refraction changes as by 0.5 K at 10 °C, and
        # as by 2.5 K at 35 °C. For the same reason no change of humidity is a jump.
        humidity = _Value(config.relative_humidity, 0.0)
        max_age_s = config.weather_max_age_s
        by_weather = JumpLimits(PRESSURE_AT_ONCE_HPA, PRESSURE_PER_H_HPA / 3600.0, max_age_s, "hPa")
        by_warmth = JumpLimits(TEMPERATURE_AT_ONCE_K, TEMPERATURE_PER_H_K / 3600.0, max_age_s, "K")
        self._air = {
            "pressure": _Quantity(pressure, config.measured_pressure_sigma_hpa, by_weather, delay_ns),
            "temperature": _Quantity(temperature, config.measured_temperature_sigma_k, by_warmth, delay_ns),
            "humidity": _Quantity(humidity, 0.0, JumpLimits(1.0, 0.0, max_age_s, ""), delay_ns),
        }

    # -- inputs ---------------------------------------------------------------------------------------------

    def rejection(self, given: SkyInput) -> Rejection | None:
        """Return why an input is rejected or only partly used; call it before :meth:`insert`.

        DUPLICATE or CONFLICT if an input of the same kind and stamp exists, LATE if it arrives too long after later
        ones of its kind, JUMP if it has jumped. All inputs are inserted: of two with the same stamp, the one whose
        bytes sort first is kept, and an input that has jumped affects the evaluation of later ones.
        """
        if isinstance(given, PositionFix):
            return self._place.rejection(given)
        quantity = self._air[given.quantity]
        return quantity.readings.rejection(given.time_ns, quantity.measured(given))

    def insert(self, given: SkyInput) -> int | None:
        """Insert a position fix or a reading of the air.

        Returns:
            Time (ns) after which results may have changed; None if no result has changed.
        """
        if isinstance(given, PositionFix):
            changed_after_ns = self._place.insert(given)
        else:
            changed_after_ns = self._air[given.quantity].insert(given)
        if changed_after_ns is not None:
            self._answers = {local_sky: told for local_sky, told in self._answers.items() if local_sky <= changed_after_ns}
        return changed_after_ns

    def drop_before(self, time_ns: int) -> None:
        """Drop the inputs that times from ``time_ns`` on do not need; earlier times may not be requested any more."""
        self._place.drop_before(time_ns)
        for quantity in self._air.values():
            quantity.drop_before(time_ns)

    def step_time_base(self, step_ns: int) -> None:
        """Shift the accepted inputs by a step of the clocks."""
        self._answers.clear()
        self._place.step_time_base(step_ns)
        for quantity in self._air.values():
            quantity.readings = quantity.readings.with_shifted_stamps(step_ns)

    # -- results --------------------------------------------------------------------------------------------

    def at(self, time_ns: int) -> tuple[Place, Air] | Rejection:
        """Return position and air at a time, or NO_FIX if no fix is near enough in time.

        The same object is returned until an input changes the result.
        """
        known = self._answers.get(time_ns)
        if known is not None:
            return known
        place = self._place.at(time_ns)
        if isinstance(place, Rejection):
            return place
        pressure, temperature, humidity = [quantity.at(time_ns) for quantity in self._air.values()]
        weather = Weather(pressure.value, temperature.value, humidity.value)
        result = self._answers[time_ns] = place, Air(weather, pressure.sigma, temperature.sigma)
        if len(self._answers) > _ANSWERS_KEPT:
            del self._answers[next(iter(self._answers))]
        return result

    def not_measured(self, time_ns: int) -> list[str]:
        """Return the names of the quantities of the air that are taken from parameters at a time."""
        return [name for name, quantity in self._air.items() if quantity.holding(time_ns) is None]
