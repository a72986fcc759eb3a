"""Refraction of starlight by the air: how much higher a star is seen than it stands, and what the weather does to it.

There are two models. Both take the elevation without air, which the catalogue gives, so no prior attitude is needed
([P15] §3). ``erfa`` is A tan z + B tan³ z of the observed zenith distance, with A and B of ERFA's ``refco``.
``almanac`` is [P15] (8)-(12) of the true zenith distance. Below its lowest elevation a model gives NaN.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ship_geometry import late_erfa as erfa
from ship_geometry.rotations import ARCSEC, FloatArray

ModelName = Literal["erfa", "almanac"]

LOWEST_ELEVATION: dict[ModelName, float] = {"erfa": np.deg2rad(5.0), "almanac": np.deg2rad(14.0)}
"""Lowest elevation (rad, without air) at which each model holds; stars below it cannot be used."""

# Steps of the numerical derivatives by pressure and temperature; over them refraction is as good as linear.
_STEP_HPA, _STEP_K = 1.0, 1.0
_TINY = 1e-300

_NORTH_AND_EAST = slice(None, None, 2)
"""The level components of a direction (North, Up, East)."""

# Error of the models in standard air. The description of refco has a table: 0.03″ up to 70° of zenith distance, 0.57″
# at 80°; it grows like the first term left out, tan⁵ z. The almanac's model knows neither humidity nor colour of
# the light, and differs from erfa by 0.7 %.
_ERFA_SIGMA, _ERFA_SIGMA_TAN5 = 0.03 * ARCSEC, 1e-4 * ARCSEC
_ALMANAC_SIGMA_FRACTION = 0.007


@dataclass(frozen=True)
class Weather:
    """The air at the ship.

    Attributes:
        pressure_hpa: at the ship's height, not reduced to sea level.
        temperature_c: degrees Celsius.
        relative_humidity: 0 to 1.

    Raises:
        ValueError: a value that no ship meets, most often because of its unit: Pa for hPa, K for °C, % for a fraction.
    """

    pressure_hpa: float
    temperature_c: float
    relative_humidity: float = 0.5

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("pressure_hpa", self.pressure_hpa, 800.0, 1100.0),
            ("temperature_c", self.temperature_c, -60.0, 60.0),
            ("relative_humidity", self.relative_humidity, 0.0, 1.0),
        ):
            if not low <= value <= high:
                raise ValueError(f"{name} is {value:g}: expected {low:g} to {high:g}")


@dataclass(frozen=True)
class Refraction:
    """Refraction at some elevations. Each array has their shape, and is NaN below the model's lowest elevation.

    An error of the pressure, of the temperature or of the model moves all stars together.

    Attributes:
        angle: the angle by which refraction raises the elevation, rad.
        per_hpa: derivative by pressure, rad/hPa.
        per_kelvin: derivative by temperature, rad/K.
        model_sigma: standard deviation of the model itself in standard air, rad.
    """

    angle: FloatArray
    per_hpa: FloatArray
    per_kelvin: FloatArray
    model_sigma: FloatArray

    def sigma(self, pressure_sigma_hpa: float, temperature_sigma_k: float) -> FloatArray:
        """Standard deviation of the angle with weather known that well, rad."""
        of_weather = np.hypot(self.per_hpa * pressure_sigma_hpa, self.per_kelvin * temperature_sigma_k)
        return np.hypot(of_weather, self.model_sigma)


def refraction(
    model: ModelName, elevation: FloatArray | float, weather: Weather, wavelength_um: float = 0.55
) -> Refraction:
    """Refraction of stars at elevations without air.

    Args:
        model: ``"erfa"`` or ``"almanac"``.
        elevation: rad, shape (...).
        weather: the air at the ship.
        wavelength_um: of the light the sensor sees; the almanac's model does not know it.

    Example:
        >>> weather = Weather(pressure_hpa=1008.3, temperature_c=28.2)
        >>> for model in ("erfa", "almanac"):
        ...     print(model, f"{refraction(model, np.deg2rad(42.2207), weather).angle / ARCSEC:.2f} arcsec")
        erfa 59.74 arcsec
        almanac 59.34 arcsec
    """
    elevation = np.asarray(elevation, dtype=float)
    tan_z = 1.0 / np.tan(np.where(elevation >= LOWEST_ELEVATION[model], elevation, np.nan))
    tan2_z = tan_z * tan_z
    linear, cubic = _coefficients(model, weather, wavelength_um)
    # The last axis: the angle, its derivative by pressure and its derivative by temperature.
    angles = (linear + cubic * tan2_z[..., None]) * tan_z[..., None]
    if model == "erfa":
        # A and B belong to the observed zenith distance. One step of Newton's method leads there from the true one, as
        # in ERFA's atioq. In the derivatives the small change of this divisor is left out.
        angles /= (1.0 + (linear[0] + 3.0 * cubic[0] * tan2_z) * (1.0 + tan2_z))[..., None]
        model_sigma = _ERFA_SIGMA + _ERFA_SIGMA_TAN5 * tan2_z * tan2_z * tan_z
    else:
        model_sigma = _ALMANAC_SIGMA_FRACTION * angles[..., 0]
    angle, per_hpa, per_kelvin = (angles[..., column] for column in range(3))
    return Refraction(angle, per_hpa, per_kelvin, model_sigma)


def refraction_slopes(
    model: ModelName, elevation: float, weather: Weather, wavelength_um: float = 0.55
) -> tuple[float, float]:
    """First and second derivative of refraction by elevation, rad/rad and rad/rad²; NaN below the lowest elevation.

    They are good to 0.1 %: the small difference between observed and true zenith distance is left out.

    Args:
        model: ``"erfa"`` or ``"almanac"``.
        elevation: rad, without air.
        weather: the air at the ship.
        wavelength_um: of the light the sensor sees; the almanac's model does not know it.

    Example:
        At 45° a star one degree higher is lifted by 2.0″ less:

        >>> slope, _ = refraction_slopes("erfa", np.deg2rad(45.0), Weather(1013.25, 10.0))
        >>> print(f"{slope * 3600.0:.1f} arcsec per degree")
        -2.0 arcsec per degree
    """
    t = 1.0 / np.tan(elevation) if elevation >= LOWEST_ELEVATION[model] else np.nan
    linear, cubic = (float(coefficients[0]) for coefficients in _coefficients(model, weather, wavelength_um))
    steep = 1.0 + t * t
    by_tan = linear + 3.0 * cubic * t * t
    return -by_tan * steep, 2.0 * t * steep * (by_tan + 3.0 * cubic * steep)


@lru_cache(maxsize=8)
def _coefficients(model: ModelName, weather: Weather, wavelength_um: float) -> tuple[FloatArray, FloatArray]:
    """Coefficients of tan z and of tan³ z, shape (3,) each: value (rad), derivative by hPa, derivative by K.

    The last ones are kept, because the weather changes far less often than the sky.
    """
    # Five kinds of weather: as given, more and less pressure, higher and lower temperature.
    given, more_pressure, less_pressure, warmer, colder = range(5)
    pressures_hpa = weather.pressure_hpa + _STEP_HPA * np.array([0.0, 1.0, -1.0, 0.0, 0.0])
    temperatures_c = weather.temperature_c + _STEP_K * np.array([0.0, 0.0, 0.0, 1.0, -1.0])
    if model == "erfa":
        both = np.stack(erfa.refco(pressures_hpa, temperatures_c, weather.relative_humidity, wavelength_um))
    else:
        # [P15] (8) for 0 °C and 1013.25 hPa, times 1 + αA + B of (9)-(11) with α = 1.
        factor = pressures_hpa / 1013.25 - 0.00383 * temperatures_c / (1.0 + 0.00367 * temperatures_c)
        both = np.array([[60.0978], [-0.0669]]) * ARCSEC * factor
    per_hpa = (both[:, more_pressure] - both[:, less_pressure]) / (2.0 * _STEP_HPA)
    per_kelvin = (both[:, warmer] - both[:, colder]) / (2.0 * _STEP_K)
    linear, cubic = np.stack([both[:, given], per_hpa, per_kelvin], axis=1)
    return linear, cubic


def lifted(direction_n: FloatArray, angle: FloatArray) -> FloatArray:
    """Directions turned upwards by refraction.

    Args:
        direction_n: unit vectors (North, Up, East) without air, shape (..., 3).
        angle: refraction, rad, shape (...).

    Returns:
        Unit vectors (North, Up, East) as seen, shape (..., 3).

    Example:
        >>> direction_n = np.array([np.cos(np.pi / 6.0), 0.5, 0.0])  # in the north, 30° up
        >>> print(np.rad2deg(elevation_of(lifted(direction_n, 100.0 * ARCSEC))).round(5))
        30.02778
    """
    up, horizontal = direction_n[..., 1], np.hypot(direction_n[..., 0], direction_n[..., 2])
    cosine, sine = np.cos(angle), np.sin(angle)
    result = np.empty(np.broadcast_shapes(direction_n.shape, (*cosine.shape, 3)))
    # At the zenith itself there is no azimuth to turn in, and no refraction.
    stretch = (cosine - sine * up / np.maximum(horizontal, _TINY))[..., None]
    result[..., _NORTH_AND_EAST] = direction_n[..., _NORTH_AND_EAST] * stretch
    result[..., 1] = up * cosine + horizontal * sine
    return result


def lifting_axis(direction_n: FloatArray) -> FloatArray:
    """The level unit vector about which a direction turns upwards, direction × Up; zero at the zenith itself.

    Args:
        direction_n: (North, Up, East), shape (3,).

    Example:
        >>> print(lifting_axis(np.array([0.0, 0.6, 0.8])))  # a star in the east turns upwards about South
        [-1.  0.  0.]
    """
    level = np.array([-direction_n[2], 0.0, direction_n[0]])
    return level / max(float(np.hypot(direction_n[0], direction_n[2])), _TINY)


def elevation_of(direction_n: FloatArray) -> FloatArray:
    """Elevation (rad, shape (...)) of directions (North, Up, East), shape (..., 3).

    Example:
        >>> print(np.rad2deg(elevation_of(np.array([1.0, 1.0, 0.0]))))
        45.0
    """
    return np.arctan2(direction_n[..., 1], np.hypot(direction_n[..., 0], direction_n[..., 2]))
