"""Where the ship is and the air around it, at one moment, with their errors."""

from dataclasses import dataclass

from ship_geometry.refraction import Weather
from ship_geometry.rotations import FloatArray
from ship_geometry.star_directions import Observer


@dataclass(frozen=True)
class Place:
    """The ship's place at one moment.

    Attributes:
        observer: position on WGS 84 and velocity over ground.
        covariance_m2: of the position in (North, Up, East), m², shape (3, 3).
        age_s: time to the fix that it rests on.
    """

    observer: Observer
    covariance_m2: FloatArray
    age_s: float


@dataclass(frozen=True)
class Air:
    """The air at the ship at one moment.

    Attributes:
        weather: pressure, temperature, humidity.
        pressure_sigma_hpa: standard deviation of the pressure, its age included.
        temperature_sigma_k: standard deviation of the temperature, its age included.
    """

    weather: Weather
    pressure_sigma_hpa: float
    temperature_sigma_k: float
