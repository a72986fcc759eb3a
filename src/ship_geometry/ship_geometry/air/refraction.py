"""Refraction of starlight by the air, and its dependence on the weather.

Each model takes the elevation without air, which is computed from catalogue, time and place; so no prior attitude is
needed ([P15] §3). There are three models; below its lowest elevation a model gives NaN.

- ``erfa`` is A tan z + B tan³ z, with the observed zenith distance z and with A and B of ERFA's ``refco``; one step of
  Newton's method solves for the observed zenith distance.
- ``almanac`` is the formula (8)-(12) of [P15] for the true zenith distance.
- ``ray_trace`` is the result of :mod:`ship_geometry.air.ray_trace`, expanded in the true zenith distance once for each
  weather, with tan⁵ z and higher terms.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import numpy as np

from ship_geometry.air.ray_trace import traced_refraction
from ship_geometry.late_libraries import erfa
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_stars

ModelName = Literal["erfa", "almanac", "ray_trace"]

MODELS: tuple[ModelName, ...] = get_args(ModelName)
"""All models, the default first."""

LOWEST_ELEVATION: dict[ModelName, float] = {
    "erfa": np.deg2rad(5.0),
    "almanac": np.deg2rad(14.0),
    "ray_trace": np.deg2rad(5.0),
}
"""Lowest elevation without air at which each model is valid, rad; lower stars are not used."""

# Steps of the numerical derivatives with respect to pressure and temperature; refraction is linear over these steps.
_STEP_HPA, _STEP_K = 1.0, 1.0
_TINY = 1e-300

# Errors of the models in standard air. The description of refco has a table: 0.03″ up to 70° of zenith distance, 0.57″
# at 80°; the error grows like the first neglected term, tan⁵ z. The almanac's model does not contain humidity or the
# colour of the light, and differs from erfa by 0.7 %.
# The error of a traced ray is due to properties of the air that are not measured aboard. Further traces give these
# errors at elevations of 5°, 10° and 45°: lapse rate ±1.5 K/km 0.54″, 0.03″, 0; tropopause at 8 or 16 km 0.27″, 0.02″,
# 0; gravity at the pole or the equator 0.17″, 0.03″, 0. A pressure gradient of 1 hPa in 100 km, as in a wind of 10 m/s,
# bends the ray by ∫ ∂n/∂x dh / sin² E: 0.62″, 0.16″, 0.01″. The relative error of the refractivity is 0.02 %. The
# standard deviations here are larger than the root sum square of these errors.
_MODEL_SIGMAS: dict[ModelName, FloatArray] = {
    "erfa": np.array([0.03 * ARCSEC, 1e-4 * ARCSEC, 0.0]),
    "almanac": np.array([0.0, 0.0, 0.007]),
    "ray_trace": np.array([0.0, 5e-6 * ARCSEC, 6e-4]),
}
"""Standard deviation of each model, a sum of three terms: constant, rad; factor of tan⁵ z, rad; factor of the angle."""

# Traced refraction is expanded as tan z Σ cᵢ xⁱ with x = tan² z/(1 + c tan² z) and z without air. With c = 0 the terms
# are tan z, tan³ z, tan⁵ z …, a series that converges slowly for long paths through curved air. For curved air c is
# 2 H/R with the scale height H. With about this c, seven terms equal the rays to 2e-4″ down to 5° in any weather.
_TERMS, _CURVATURE = 7, 0.003
_LOWEST_RAY = np.deg2rad(85.0)  # observed zenith distance
_SAMPLE_ANGLES = np.pi * (np.arange(_TERMS) + 0.5) / _TERMS

for _of_model in _MODEL_SIGMAS.values():
    _of_model.flags.writeable = False


@dataclass(frozen=True)
class Weather:
    """The air at the ship.

    Attributes:
        pressure_hpa: pressure at the ship's height, not reduced to sea level.
        temperature_c: temperature, °C.
        relative_humidity: relative humidity, 0 to 1.

    Raises:
        ValueError: a value is impossible, often because of a wrong unit: Pa for hPa, K for °C, % for a fraction.
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
    """Refraction at given elevations; each array has the shape of the elevations.

    The values are NaN below the lowest elevation of the model. An error of the pressure, of the temperature or of the
    model is common to all stars.

    Attributes:
        angle: angle by which refraction raises the elevation, rad.
        per_hpa: derivative with respect to pressure, rad/hPa.
        per_kelvin: derivative with respect to temperature, rad/K.
        model_sigma: standard deviation of the model itself in standard air, rad.
    """

    angle: FloatArray
    per_hpa: FloatArray
    per_kelvin: FloatArray
    model_sigma: FloatArray

    def sigma(self, pressure_sigma_hpa: float, temperature_sigma_k: float) -> FloatArray:
        """Return the standard deviation of the angle for given sigmas of pressure and temperature, rad."""
        of_weather = np.hypot(self.per_hpa * pressure_sigma_hpa, self.per_kelvin * temperature_sigma_k)
        return np.hypot(of_weather, self.model_sigma)


def refraction(
    model: ModelName, elevation: FloatArray | float, weather: Weather, wavelength_um: float = 0.55
) -> Refraction:
    """Return the refraction of stars.

    Args:
        model: one of MODELS.
        elevation: elevation without air (true elevation), rad, shape (...).
        weather: the air at the ship.
        wavelength_um: effective wavelength of the sensor, µm; the almanac's model does not use it.

    Example:
        >>> weather = Weather(pressure_hpa=1008.3, temperature_c=28.2)
        >>> for model in MODELS:
        ...     print(model, f"{refraction(model, np.deg2rad(42.2207), weather).angle / ARCSEC:.2f} arcsec")
        erfa 59.74 arcsec
        almanac 59.34 arcsec
        ray_trace 59.73 arcsec
    """
    elevation = np.asarray(elevation, dtype=float)
    angles, model_sigma = compiled_stars.refraction_angles(
        np.ascontiguousarray(elevation).reshape(-1), *_model_in_air(model, weather, wavelength_um)
    )
    angle, per_hpa, per_kelvin = (column.reshape(elevation.shape) for column in angles.T)
    return Refraction(angle, per_hpa, per_kelvin, model_sigma.reshape(elevation.shape))


class StarsThroughAir(NamedTuple):
    """Apparent directions of stars through the air.

    Attributes:
        direction_n: unit vectors (North, Up, East), shape (k, 3); NaN below the model's lowest elevation.
        shared_n: displacement of each star by errors common to all stars, rad, shape (k, 3, 1 + m): by one sigma of
            refraction (first column), and by each of m rotations of the sky.
        elevation: elevations without air, rad, shape (k,).
    """

    direction_n: FloatArray
    shared_n: FloatArray
    elevation: FloatArray


def seen_through_air(
    model: ModelName,
    without_air_n: FloatArray,
    weather: Weather,
    wavelength_um: float,
    weather_sigma: tuple[float, float],
    turns_n: FloatArray,
) -> StarsThroughAir:
    """Return the apparent directions of a few stars through the air, with their displacement by common errors.

    Args:
        model: one of MODELS.
        without_air_n: unit vectors (North, Up, East) without air, shape (k, 3).
        weather: the air at the ship.
        wavelength_um: effective wavelength of the sensor, µm; the almanac's model does not use it.
        weather_sigma: standard deviations of the pressure, hPa, and of the temperature, K.
        turns_n: rotation vectors of the whole sky, rad, shape (m, 3).

    Example:
        A star at 45° in the north is raised by 58″. A temperature sigma of 5 K gives a sigma of 1.0″:

        >>> north_up_n = np.array([[1.0, 1.0, 0.0]]) / np.sqrt(2.0)
        >>> air = Weather(1013.25, 10.0)
        >>> refracted = seen_through_air("erfa", north_up_n, air, 0.55, (0.0, 5.0), np.empty((0, 3)))

        >>> lifted_by = elevation_of(refracted.direction_n)[0] - refracted.elevation[0]
        >>> print(f"{lifted_by / ARCSEC:.0f} {np.linalg.norm(refracted.shared_n[0, :, 0]) / ARCSEC:.1f}")
        58 1.0
    """
    of_air = _model_in_air(model, weather, wavelength_um)
    return StarsThroughAir(*compiled_stars.seen_through_air(without_air_n, *of_air, *weather_sigma, turns_n))


def refraction_slopes(
    model: ModelName, elevation: float, weather: Weather, wavelength_um: float = 0.55
) -> tuple[float, float]:
    """Return the first and second derivative of refraction with respect to elevation, rad/rad and rad/rad².

    The derivatives are NaN below the lowest elevation of the model. Derivatives of ``erfa`` have a relative error of
    0.1 %/sin² E, because the difference between observed and true zenith distance is neglected. Derivatives of the
    other models are exact.

    Args:
        model: one of MODELS.
        elevation: elevation E without air, rad.
        weather: the air at the ship.
        wavelength_um: effective wavelength of the sensor, µm; the almanac's model does not use it.

    Example:
        At 45° refraction decreases by 2.0″ for one degree of elevation:

        >>> slope, _ = refraction_slopes("erfa", np.deg2rad(45.0), Weather(1013.25, 10.0))
        >>> print(f"{slope * 3600.0:.1f} arcsec per degree")
        -2.0 arcsec per degree
    """
    t = 1.0 / np.tan(elevation) if elevation >= LOWEST_ELEVATION[model] else np.nan
    coefficients, curvature, *_ = _model_in_air(model, weather, wavelength_um)
    stretch, steep = 1.0 + curvature * t * t, 1.0 + t * t
    # First derivative with respect to tan z, and half of the second divided by tan z, summed from the last term.
    by_tan = bend = 0.0
    for power in range(len(coefficients) - 1, -1, -1):
        share = 1.0 + 2.0 * power / stretch
        of_term = coefficients.item(power, 0)
        by_tan = share * of_term + by_tan * t * t / stretch
        if power:
            of_bend = power * (share - 2.0 * curvature * t * t / stretch) * of_term / stretch**2
            bend = of_bend + bend * t * t / stretch
    return -by_tan * steep, 2.0 * t * steep * (by_tan + bend * steep)


@lru_cache(maxsize=8)
def _model_in_air(
    model: ModelName, weather: Weather, wavelength_um: float
) -> tuple[FloatArray, float, float, bool, FloatArray]:
    """Return the arguments of :func:`ship_kernels.compiled_stars.refraction_angles` for a model and weather.

    The last results are cached, because the weather changes far less often than the sky.

    Returns:
        Coefficients of the powers of x, shape (t, 3): value (rad), derivatives with respect to pressure (hPa) and
            temperature (K).
        The curvature c in x.
        The lowest elevation of the model.
        True if the coefficients belong to the observed zenith distance.
        Standard deviations of the model.
    """
    # Five kinds of weather: as given, more and less pressure, higher and lower temperature.
    given, more_pressure, less_pressure, warmer, colder = range(5)
    pressures_hpa = weather.pressure_hpa + _STEP_HPA * np.array([0.0, 1.0, -1.0, 0.0, 0.0])
    temperatures_c = weather.temperature_c + _STEP_K * np.array([0.0, 0.0, 0.0, 1.0, -1.0])
    curvature = 0.0
    if model == "erfa":
        each = np.stack(erfa.refco(pressures_hpa, temperatures_c, weather.relative_humidity, wavelength_um))
    elif model == "almanac":
        # [P15] (8) for 0 °C and 1013.25 hPa, times 1 + αA + B of (9)-(11) with α = 1.
        factor = pressures_hpa / 1013.25 - 0.00383 * temperatures_c / (1.0 + 0.00367 * temperatures_c)
        each = np.array([[60.0978], [-0.0669]]) * ARCSEC * factor
    else:
        each = _expanded_rays(pressures_hpa, temperatures_c, weather.relative_humidity, wavelength_um)
        curvature = _CURVATURE
    per_hpa = (each[:, more_pressure] - each[:, less_pressure]) / (2.0 * _STEP_HPA)
    per_kelvin = (each[:, warmer] - each[:, colder]) / (2.0 * _STEP_K)
    coefficients = np.stack([each[:, given], per_hpa, per_kelvin], axis=1)
    return coefficients, curvature, LOWEST_ELEVATION[model], model == "erfa", _MODEL_SIGMAS[model]


def _expanded_rays(
    pressures_hpa: FloatArray, temperatures_c: FloatArray, relative_humidity: float, wavelength_um: float
) -> FloatArray:
    """Return the coefficients of traced refraction in w kinds of weather, shape (_TERMS, w).

    One ray is traced for each term, at the zeros of a Chebyshev polynomial; the expansion is exact for these rays.
    """
    lowest = np.tan(_LOWEST_RAY) ** 2
    sampled = 0.5 * (1.0 + np.cos(_SAMPLE_ANGLES)) * lowest / (1.0 + _CURVATURE * lowest)
    seen = np.arctan(np.sqrt(sampled / (1.0 - _CURVATURE * sampled)))
    angles = traced_refraction(seen, pressures_hpa, temperatures_c, relative_humidity, wavelength_um)
    tangents = np.tan(seen + angles)
    powers = (tangents**2 / (1.0 + _CURVATURE * tangents**2))[..., None] ** np.arange(_TERMS)
    coefficients: FloatArray = np.linalg.solve(powers, (angles / tangents)[..., None])[..., 0].T
    return coefficients


def raised_directions(direction_n: FloatArray, angle: FloatArray) -> FloatArray:
    """Return directions raised by refraction.

    Args:
        direction_n: unit vectors (North, Up, East) without air, shape (..., 3).
        angle: refraction angles, rad, shape (...).

    Returns:
        Apparent unit vectors (North, Up, East), shape (..., 3).

    Example:
        >>> direction_n = np.array([np.cos(np.pi / 6.0), 0.5, 0.0])  # in the north, 30° up
        >>> print(np.rad2deg(elevation_of(raised_directions(direction_n, 100.0 * ARCSEC))).round(5))
        30.02778
    """
    shape = np.broadcast_shapes(direction_n.shape, (*np.shape(angle), 3))
    result: FloatArray = compiled_stars.raised_directions(
        np.ascontiguousarray(np.broadcast_to(direction_n, shape), dtype=float).reshape(-1, 3),
        np.ascontiguousarray(np.broadcast_to(angle, shape[:-1]), dtype=float).reshape(-1),
    )
    return result.reshape(shape)


def raising_axis(direction_n: FloatArray) -> FloatArray:
    """Return the horizontal unit vector about which refraction raises a direction: direction × Up; zero at the zenith.

    Args:
        direction_n: unit vector (North, Up, East), shape (3,).

    Example:
        >>> print(raising_axis(np.array([0.0, 0.6, 0.8])))  # a star in the east is raised about South
        [-1.  0.  0.]
    """
    level = np.array([-direction_n[2], 0.0, direction_n[0]])
    return level / max(float(np.hypot(direction_n[0], direction_n[2])), _TINY)


def elevation_of(direction_n: FloatArray) -> FloatArray:
    """Return the elevation (rad, shape (...)) of directions (North, Up, East), shape (..., 3).

    Example:
        >>> print(np.rad2deg(elevation_of(np.array([1.0, 1.0, 0.0]))))
        45.0
    """
    return np.arctan2(direction_n[..., 1], np.hypot(direction_n[..., 0], direction_n[..., 2]))
