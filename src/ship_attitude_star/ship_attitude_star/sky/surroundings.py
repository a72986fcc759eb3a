"""The ship's place and the air around it at any moment, from position fixes and readings of the air.

The place is that of :mod:`ship_attitude_star.sky.place_by_fixes`. The air is what was measured last, ``gnss_delay_s``
before the moment or earlier; where nothing was measured, parameters stand in. A fix or a reading that has jumped is
left out: the last good ones go on, with an error that grows (:mod:`ship_attitude_star.sky.stamped_values`). Whatever
the order of arrival, the answers are the same.
"""

import math
import struct
from dataclasses import dataclass

from ship_attitude_star.measurements.readings import AirReading, PositionFix, SkyInput
from ship_attitude_star.sky.config import SkyConfig
from ship_attitude_star.sky.place_by_fixes import Place, PlaceByFixes
from ship_attitude_star.sky.stamped_values import JumpLimits, StampedValues
from ship_estimation.refusals import Refusal
from ship_geometry.refraction import Weather
from ship_geometry.time_scales import SECOND_NS

PRESSURE_AT_ONCE_HPA = 5.0
"""What a barometer may change at once: gusts at its inlet (30 m/s: 5 hPa), heave (10 m: 1 hPa), a squall (2 hPa)."""

PRESSURE_PER_H_HPA = 30.0
"""Ten times what WMO-No. 305 (1993, VI.21) tolerates within an hour: a typhoon may pass."""

TEMPERATURE_AT_ONCE_K = 5.0
"""What a thermometer may change at once: the plume of the funnel, the sun."""

TEMPERATURE_PER_H_K = 40.0
"""Ten times what WMO-No. 305 (1993, VI.21) tolerates within an hour: the outflow of a thunderstorm may arrive."""


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
        self._place = PlaceByFixes(config)
        delay_ns = round(config.gnss_delay_s * SECOND_NS)
        self._answers: dict[int, tuple[Place, Air]] = {}
        pressure = _Value(config.pressure_hpa, config.pressure_sigma_hpa)
        temperature = _Value(config.temperature_c, config.temperature_sigma_k)
        # The error of humidity is left out: from dry to saturated air, refraction changes as by 0.5 K at 10 °C, and as
        # by 2.5 K at 35 °C. For the same reason no change of it is a jump.
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

    def refusal(self, given: SkyInput) -> Refusal | None:
        """Why an input is not used, or not as it came; to be asked before :meth:`insert`.

        DUPLICATE or CONFLICT where an input of the same kind and stamp is known, LATE where it comes too long after
        later ones of its kind, JUMP where it has jumped. All inputs are inserted: of two with the same stamp the one
        whose bytes sort first is kept, and what has jumped tells something of those after it.
        """
        if isinstance(given, PositionFix):
            return self._place.refusal(given)
        quantity = self._air[given.quantity]
        return quantity.readings.refusal(given.time_ns, quantity.measured(given))

    def insert(self, given: SkyInput) -> int | None:
        """Take a position fix or a reading of the air.

        Returns:
            The moment (ns) after which answers may have changed; None where no answer has changed.
        """
        if isinstance(given, PositionFix):
            changed_after_ns = self._place.insert(given)
        else:
            changed_after_ns = self._air[given.quantity].insert(given)
        if changed_after_ns is not None:
            self._answers = {moment: told for moment, told in self._answers.items() if moment <= changed_after_ns}
        return changed_after_ns

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``; no earlier ones may be asked for any more."""
        self._place.drop_before(time_ns)
        for quantity in self._air.values():
            quantity.drop_before(time_ns)

    def step_time_base(self, step_ns: int) -> None:
        """Carry what is believed over a step of the clocks."""
        self._answers.clear()
        self._place.step_time_base(step_ns)
        for quantity in self._air.values():
            quantity.readings = quantity.readings.with_shifted_stamps(step_ns)

    # -- answers --------------------------------------------------------------------------------------------

    def at(self, time_ns: int) -> tuple[Place, Air] | Refusal:
        """Place and air at a moment, or NO_FIX where no fix is near enough in time.

        As long as no input has changed the answer, it is the same object.
        """
        known = self._answers.get(time_ns)
        if known is not None:
            return known
        place = self._place.at(time_ns)
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
