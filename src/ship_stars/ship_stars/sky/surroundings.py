"""The ship's position and the air at the ship at any time, from position fixes and readings of the air.

The position is computed by :mod:`ship_stars.sky.position_from_fixes`. The air is the last reading with a stamp
``gnss_delay_s`` or more before the requested time. A newer reading is used if no such reading is recent enough, and
parameters are used if there is no recent reading. A fix or reading that has jumped is rejected
(:mod:`ship_stars.sky.stamped_values`), and the last accepted fix or reading stays in use with a growing error.
The results do not depend on the order of arrival.
"""

import math
import struct
from dataclasses import dataclass

from ship_estimation.rejection_rules import Rejection
from ship_geometry.air.refraction import Weather
from ship_geometry.earth.time_scales import SECOND_NS
from ship_stars.attitude_samples import AirReading, PositionFix, SkyInput
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.position_from_fixes import PositionFromFixes, ShipPosition
from ship_stars.sky.stamped_values import JumpLimits, StampedValues

MAX_PRESSURE_STEP_HPA = 5.0
"""Largest step of the measured pressure, by gusts at the inlet (30 m/s: 5 hPa), heave (10 m: 1 hPa), squall (2 hPa)."""

MAX_PRESSURE_RATE_HPA_PER_H = 30.0
"""Maximum rate of pressure, as in a typhoon: ten times the hourly tolerance of WMO-No. 305 (1993, VI.21)."""

MAX_TEMPERATURE_STEP_K = 5.0
"""Largest step of the measured temperature, by the plume of the funnel or the sun."""

MAX_TEMPERATURE_RATE_K_PER_H = 40.0
"""Maximum rate of temperature, as in a thunderstorm: ten times the hourly tolerance of WMO-No. 305 (1993, VI.21)."""

_MAX_CACHED_RESULTS = 256
"""Number of cached results; exposures that are applied again need up to 28 results per second of the last 2 s."""


@dataclass(frozen=True)
class Air:
    """The air at the ship at one time.

    Attributes:
        weather: pressure, temperature and humidity.
        pressure_sigma_hpa: standard deviation of the pressure; it grows with the age of the reading.
        temperature_sigma_k: standard deviation of the temperature; it grows with the age of the reading.
    """

    weather: Weather
    pressure_sigma_hpa: float
    temperature_sigma_k: float


@dataclass(frozen=True)
class _Value:
    """Value of an air quantity with its standard deviation, both in the unit of the quantity."""

    value: float
    sigma: float

    def content(self) -> bytes:
        return struct.pack("<dd", self.value, self.sigma)

    def distance_to(self, other: "_Value") -> float:
        return abs(self.value - other.value)


class _Quantity:
    """One quantity of the air: its readings and its default value.

    Args:
        default: value used without a recent reading.
        measured_sigma: standard deviation of a reading if the message has no variance.
        limits: limits of a jump; the confirmation time is also the maximum age of a reading.
        delay_ns: age from which on a reading is used. A younger reading is used if no earlier reading is valid.
    """

    def __init__(self, default: _Value, measured_sigma: float, limits: JumpLimits, delay_ns: int) -> None:
        self._default = default
        self._measured_sigma = measured_sigma
        self._max_age_ns, self._delay_ns = limits.confirmation_s * SECOND_NS, delay_ns
        self.readings: StampedValues[_Value] = StampedValues(limits)

    def value_of(self, reading: AirReading) -> _Value:
        return _Value(reading.value, self._measured_sigma if reading.sigma is None else reading.sigma)

    def insert(self, reading: AirReading) -> int | None:
        """Insert a reading; return the time (ns) after which results may have changed, None without a change."""
        changed_ns = self.readings.insert(reading.time_ns, self.value_of(reading))
        if changed_ns is None:
            return None
        # If an earlier reading is used during the delay, no result within the delay depends on the new reading.
        recent = self._recent_reading_index(changed_ns - self._delay_ns, changed_ns + self._delay_ns)
        return changed_ns - 1 + (0 if recent is None else self._delay_ns)

    def drop_before(self, time_ns: int) -> None:
        """Drop the readings that are not needed for times from ``time_ns`` on."""
        self.readings.drop_before(time_ns - self._delay_ns)

    def reading_index(self, time_ns: int) -> int | None:
        """Return the index of the reading used at a time; None if the default is used."""
        delayed = self._recent_reading_index(time_ns - self._delay_ns, time_ns)
        return self._recent_reading_index(time_ns, time_ns) if delayed is None else delayed

    def _recent_reading_index(self, before_ns: int, time_ns: int) -> int | None:
        """Return the index of the last reading at or before ``before_ns``; None if it is too old at ``time_ns``."""
        last = self.readings.last_before(before_ns)
        return last if last >= 0 and time_ns - self.readings.times[last] <= self._max_age_ns else None

    def value_at(self, time_ns: int) -> _Value:
        """Return the value at a time.

        The variance of a reading grows with its age up to the variance of the default, unless it is larger from the
        start.
        """
        index = self.reading_index(time_ns)
        if index is None:
            return self._default
        reading, age_ns = self.readings.values[index], time_ns - self.readings.times[index]
        growth = max(0.0, self._default.sigma**2 - reading.sigma**2)
        return _Value(reading.value, math.sqrt(reading.sigma**2 + growth * age_ns / self._max_age_ns))


class Surroundings:
    """Position fixes and air readings in the order of their stamps, and the position and air at any time from them.

    Args:
        config: maximum ages of fixes and readings, and default values of the air.
    """

    def __init__(self, config: SkyConfig) -> None:
        self._position = PositionFromFixes(config)
        delay_ns = round(config.gnss_delay_s * SECOND_NS)
        self._results: dict[int, tuple[ShipPosition, Air]] = {}
        pressure = _Value(config.pressure_hpa, config.pressure_sigma_hpa)
        temperature = _Value(config.temperature_c, config.temperature_sigma_k)
        # The error of humidity is neglected. A change from dry to saturated air changes refraction as much as a change
        # of temperature by 0.5 K at 10 °C, or by 2.5 K at 35 °C. For the same reason no change of humidity is a jump.
        humidity = _Value(config.relative_humidity, 0.0)
        max_age_s = config.weather_max_age_s
        pressure_limits = JumpLimits(MAX_PRESSURE_STEP_HPA, MAX_PRESSURE_RATE_HPA_PER_H / 3600.0, max_age_s, "hPa")
        temperature_limits = JumpLimits(MAX_TEMPERATURE_STEP_K, MAX_TEMPERATURE_RATE_K_PER_H / 3600.0, max_age_s, "K")
        self._air = {
            "pressure": _Quantity(pressure, config.measured_pressure_sigma_hpa, pressure_limits, delay_ns),
            "temperature": _Quantity(temperature, config.measured_temperature_sigma_k, temperature_limits, delay_ns),
            "humidity": _Quantity(humidity, 0.0, JumpLimits(1.0, 0.0, max_age_s, ""), delay_ns),
        }

    # -- inputs ---------------------------------------------------------------------------------------------

    def rejection(self, sky_input: SkyInput) -> Rejection | None:
        """Return the rejection or a remark for an input, None without either; call this method before :meth:`insert`.

        DUPLICATE or CONFLICT: an input of the same kind and stamp exists. LATE: all stored inputs of this kind
        are later. JUMP: the input has jumped. A rejected input must be inserted too. Of two inputs with the same stamp
        the message whose bytes sort first is kept, and an input that has jumped affects the evaluation of later inputs.
        """
        if isinstance(sky_input, PositionFix):
            return self._position.rejection(sky_input)
        quantity = self._air[sky_input.quantity]
        return quantity.readings.rejection(sky_input.time_ns, quantity.value_of(sky_input))

    def insert(self, sky_input: SkyInput) -> int | None:
        """Insert a position fix or a reading of the air.

        Returns:
            Time (ns) after which results may have changed; None without a change.
        """
        if isinstance(sky_input, PositionFix):
            changed_after_ns = self._position.insert(sky_input)
        else:
            changed_after_ns = self._air[sky_input.quantity].insert(sky_input)
        if changed_after_ns is not None:
            self._results = {
                time_ns: result for time_ns, result in self._results.items() if time_ns <= changed_after_ns
            }
        return changed_after_ns

    def drop_before(self, time_ns: int) -> None:
        """Drop the inputs that are not needed from ``time_ns`` on; earlier times must not be requested afterwards."""
        self._position.drop_before(time_ns)
        for quantity in self._air.values():
            quantity.drop_before(time_ns)

    def step_time_base(self, step_ns: int) -> None:
        """Shift the accepted inputs of the last ten seconds by a step of the clocks; drop all other inputs."""
        self._results.clear()
        self._position.step_time_base(step_ns)
        for quantity in self._air.values():
            quantity.readings = quantity.readings.with_shifted_stamps(step_ns)

    # -- results --------------------------------------------------------------------------------------------

    def position_and_air_at(self, time_ns: int) -> tuple[ShipPosition, Air] | Rejection:
        """Return position and air at a time, or the rejection NO_FIX of :meth:`PositionFromFixes.position_at`.

        The returned object is the same while it is cached and no input changes the result.
        """
        known = self._results.get(time_ns)
        if known is not None:
            return known
        position = self._position.position_at(time_ns)
        if isinstance(position, Rejection):
            return position
        pressure, temperature, humidity = [quantity.value_at(time_ns) for quantity in self._air.values()]
        weather = Weather(pressure.value, temperature.value, humidity.value)
        result = self._results[time_ns] = position, Air(weather, pressure.sigma, temperature.sigma)
        if len(self._results) > _MAX_CACHED_RESULTS:
            del self._results[next(iter(self._results))]
        return result

    def unmeasured_quantities(self, time_ns: int) -> list[str]:
        """Return the names of the quantities of the air that are taken from parameters at a time."""
        return [name for name, quantity in self._air.items() if quantity.reading_index(time_ns) is None]
