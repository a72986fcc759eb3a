"""The air at the ship at any moment, from what was measured last; from parameters where nothing was."""

import math
import struct
from dataclasses import dataclass

from ship_attitude_star.sky.surroundings import Air
from ship_attitude_star.stars.star_config import SkyConfig
from ship_estimation.refusals import Refusal
from ship_estimation.stamped_values import StampedValues
from ship_geometry.refraction import Weather

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class _Reading:
    value: float
    sigma: float

    def content(self) -> bytes:
        return struct.pack("<dd", self.value, self.sigma)


class _Quantity:
    """One quantity: what is taken without any reading, and the readings."""

    def __init__(self, default: float, default_sigma: float, measured_sigma: float, max_age_s: float) -> None:
        self._default = _Reading(default, default_sigma)
        self._measured_sigma = measured_sigma
        self._max_age_ns = max_age_s * _SECOND_NS
        self._readings: StampedValues[_Reading] = StampedValues()

    def refusal(self, time_ns: int, value: float, sigma: float | None) -> Refusal | None:
        return self._readings.refusal(time_ns, self._reading(value, sigma))

    def insert(self, time_ns: int, value: float, sigma: float | None) -> int | None:
        # What is valid from a stamp on changes the answers at that moment too.
        return None if self._readings.insert(time_ns, self._reading(value, sigma)) is None else time_ns - 1

    def measured(self, time_ns: int) -> bool:
        """Whether a reading holds at a moment."""
        index = self._readings.last_before(time_ns)
        return index >= 0 and time_ns - self._readings.times[index] <= self._max_age_ns

    def at(self, time_ns: int) -> _Reading:
        """The last reading, its variance on the way to that of the default; the default where it is too old."""
        if not self.measured(time_ns):
            return self._default
        index = self._readings.last_before(time_ns)
        reading, age_ns = self._readings.values[index], time_ns - self._readings.times[index]
        growth = max(0.0, self._default.sigma**2 - reading.sigma**2)
        return _Reading(reading.value, math.sqrt(reading.sigma**2 + growth * age_ns / self._max_age_ns))

    def drop_before(self, time_ns: int) -> None:
        self._readings.forget(self._readings.last_before(time_ns))

    def _reading(self, value: float, sigma: float | None) -> _Reading:
        return _Reading(value, self._measured_sigma if sigma is None else sigma)


class WeatherTrack:
    """Pressure, temperature and humidity by their stamps; any order of arrival gives the same answers.

    Every ``insert_…`` takes a stamp (ns), a value and its standard deviation (None: as configured) and returns the
    moment after which answers changed, None where none did. The values are those that :class:`Weather` accepts.

    Args:
        config: what is taken where nothing was measured, and how fast a measurement grows old.
    """

    def __init__(self, config: SkyConfig) -> None:
        max_age_s = config.weather_max_age_s
        self._pressure_hpa = _Quantity(
            config.pressure_hpa, config.pressure_sigma_hpa, config.measured_pressure_sigma_hpa, max_age_s
        )
        self._temperature_c = _Quantity(
            config.temperature_c, config.temperature_sigma_k, config.measured_temperature_sigma_k, max_age_s
        )
        # Its error is left out: from dry to saturated, refraction changes as by 0.5 K at 10 °C, by 2.5 K at 35 °C.
        self._humidity = _Quantity(config.relative_humidity, 0.0, 0.0, max_age_s)
        self._by_name = {
            "pressure": self._pressure_hpa,
            "temperature": self._temperature_c,
            "humidity": self._humidity,
        }

    def refusal(self, name: str, time_ns: int, value: float, sigma: float | None) -> Refusal | None:
        """DUPLICATE or CONFLICT where there is a reading of that stamp.

        Args:
            name: ``"pressure"``, ``"temperature"`` or ``"humidity"``.
            time_ns: stamp of the new one.
            value: as for the insert that will follow.
            sigma: the same.
        """
        return self._by_name[name].refusal(time_ns, value, sigma)

    def insert_pressure(self, time_ns: int, pressure_hpa: float, sigma_hpa: float | None = None) -> int | None:
        """Pressure at the ship, not reduced to sea level."""
        return self._pressure_hpa.insert(time_ns, pressure_hpa, sigma_hpa)

    def insert_temperature(self, time_ns: int, temperature_c: float, sigma_k: float | None = None) -> int | None:
        """Temperature of the outside air, degrees Celsius."""
        return self._temperature_c.insert(time_ns, temperature_c, sigma_k)

    def insert_humidity(self, time_ns: int, relative_humidity: float) -> int | None:
        """Relative humidity, 0 to 1."""
        return self._humidity.insert(time_ns, relative_humidity, None)

    def at(self, time_ns: int) -> Air:
        """The air at a moment: what was measured last at or before it."""
        pressure, temperature = self._pressure_hpa.at(time_ns), self._temperature_c.at(time_ns)
        weather = Weather(pressure.value, temperature.value, self._humidity.at(time_ns).value)
        return Air(weather, pressure.sigma, temperature.sigma)

    def not_measured(self, time_ns: int) -> list[str]:
        """What is taken from parameters at a moment: ``pressure``, ``temperature``, ``humidity``."""
        return [name for name, quantity in self._by_name.items() if not quantity.measured(time_ns)]

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``."""
        for quantity in self._by_name.values():
            quantity.drop_before(time_ns)
