"""Refraction by ray tracing through a model of the air, more accurate at low elevations than two terms of tan z.

The model is by Hohenkerk and Sinclair (NAO Technical Note 63, 1985), also in the Explanatory Supplement to the
Astronomical Almanac (1992, §3.281):

- Surfaces of equal density are spheres about the Earth's centre, of radius 6 378 120 m at sea level.
- Up to the tropopause at 11 km the temperature falls by 6.5 K/km, from the measured value; above the tropopause it is
  constant.
- Air and vapour are ideal gases at rest. Gravity depends on the latitude and height of the observer; the same value
  is used at all heights of the air.
- The vapour pressure is proportional to the 18.36th power of the temperature up to the tropopause, and zero above. The
  vapour pressure at the observer is computed from relative humidity and saturation pressure (Gill, Atmosphere-Ocean
  Dynamics, 1982).
- The refractivity of dry air is from the International Association of Geodesy (1999, Birmingham, Resolution 3);
  vapour refracts less than the dry air that it replaces, by 11.2684e-6 K/hPa.

Along a ray n r sin z is constant, with n the index of refraction, r the distance from the Earth's centre and z the
zenith distance. The refraction is therefore ∫ tan z (-dn)/n from the observer upwards. Gaussian quadrature uses ten
points in the troposphere (Legendre) and ten above it (Laguerre). Down to an elevation of 5° the integrand is smooth and
the quadrature error is 1e-6″. Auer and Standish integrate over the zenith distance instead, which is needed only near
the horizon. The Laguerre points cover all heights above the tropopause. The Technical Note stops at 80 km, which gives
0.003″ less at a zenith distance of 80°.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

_GAS_CONSTANT = 8314.32
_DRY_MASS, _VAPOUR_MASS = 28.9644, 18.0152
_EARTH_RADIUS_M = 6_378_120.0
_VAPOUR_POWER = 18.36
_VAPOUR_DEFECT_K_PER_HPA = 11.2684e-6
_ZERO_C_K = 273.15

_LOWER_NODES, _LOWER_WEIGHTS = np.polynomial.legendre.leggauss(10)
_UPPER_NODES, _UPPER_WEIGHTS = np.polynomial.laguerre.laggauss(10)


@dataclass(frozen=True)
class Atmosphere:
    """Parameters of the air that no barometer or thermometer measures; the defaults are from the Technical Note.

    Attributes:
        lapse_k_per_m: decrease of the temperature with height up to the tropopause, above 0.
        tropopause_m: height of the tropopause above sea level.
        latitude: latitude of the observer, rad, for gravity.
        height_m: height of the observer above sea level, below the tropopause.
    """

    lapse_k_per_m: float = 0.0065
    tropopause_m: float = 11_000.0
    latitude: float = 0.25 * np.pi
    height_m: float = 0.0

    @property
    def gravity(self) -> float:
        """Gravity at the centre of mass of the air above the observer, m/s²."""
        return float(9.784 * (1.0 - 0.0026 * np.cos(2.0 * self.latitude) - 2.8e-7 * self.height_m))


STANDARD = Atmosphere()


def traced_refraction(
    observed_zenith_distance: FloatArray,
    pressure_hpa: FloatArray,
    temperature_c: FloatArray,
    relative_humidity: float,
    wavelength_um: float,
    atmosphere: Atmosphere = STANDARD,
) -> FloatArray:
    """Return refraction at k observed zenith distances in w kinds of weather, rad, shape (w, k).

    Args:
        observed_zenith_distance: zenith distances with air, up to 86°, rad, shape (k,). Larger zenith distances need
            more quadrature points.
        pressure_hpa: air pressures at the observer, shape (w,).
        temperature_c: air temperatures at the observer, shape (w,).
        relative_humidity: humidity at the observer, 0 to 1.
        wavelength_um: wavelength of the light, µm.
        atmosphere: parameters of the air above the observer.

    Example:
        Refraction at an observed elevation of 5° is 9.65′ at 15 °C, and 9.85′ at 10 °C:

        >>> pressures_hpa, temperatures_c = np.full(2, 1013.25), np.array([15.0, 10.0])
        >>> traced = traced_refraction(np.deg2rad([85.0]), pressures_hpa, temperatures_c, 0.5, 0.55)
        >>> print((np.rad2deg(traced[:, 0]) * 60.0).round(2))
        [9.65 9.85]
    """
    kelvin = temperature_c + _ZERO_C_K
    per_scale_k_per_m = atmosphere.gravity * _DRY_MASS / _GAS_CONSTANT
    power = per_scale_k_per_m / atmosphere.lapse_k_per_m
    vapour_hpa = _vapour_pressure(pressure_hpa, temperature_c, relative_humidity)
    # Vapour is lighter than air. A part of the pressure therefore follows the power law of vapour and is subtracted;
    # the part that follows the power law of air is larger by this amount.
    lighter_hpa = vapour_hpa * (1.0 - _VAPOUR_MASS / _DRY_MASS) * power / (_VAPOUR_POWER - power)
    dry = _dry_refractivity(wavelength_um)
    of_air = (dry * (pressure_hpa + lighter_hpa) / kelvin)[:, None]
    of_vapour = ((dry * lighter_hpa + _VAPOUR_DEFECT_K_PER_HPA * vapour_hpa) / kelvin)[:, None]
    heights_m, refractivity, falls = _points(atmosphere, kelvin[:, None], of_air, of_vapour, per_scale_k_per_m)
    index, observer_m = 1.0 + refractivity, _EARTH_RADIUS_M + atmosphere.height_m
    narrowing = (1.0 + of_air - of_vapour) * observer_m / (index * (observer_m + heights_m))
    sines = narrowing[:, None, :] * np.sin(observed_zenith_distance)[:, None]
    traced: FloatArray = np.einsum("wki,wi->wk", sines / np.sqrt(1.0 - sines * sines), falls / index)
    return traced


def _points(
    atmosphere: Atmosphere, kelvin: FloatArray, of_air: FloatArray, of_vapour: FloatArray, per_scale_k_per_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return height above the observer (m), n - 1 and weighted decrease of n at i quadrature points, shape (w, i) each.

    Args:
        atmosphere: parameters of the air above the observer.
        kelvin: temperature at the observer, K, shape (w, 1).
        of_air: part of n - 1 at the observer that decreases with height as air does, shape (w, 1).
        of_vapour: part of n - 1 at the observer that decreases as vapour does and is subtracted, shape (w, 1).
        per_scale_k_per_m: temperature divided by the scale height of isothermal air, K/m.
    """
    thickness_m = atmosphere.tropopause_m - atmosphere.height_m
    power, cooling_per_m = per_scale_k_per_m / atmosphere.lapse_k_per_m, atmosphere.lapse_k_per_m / kelvin
    lower_m = 0.5 * thickness_m * (1.0 + _LOWER_NODES)
    # Temperature divided by the temperature at the observer; the last point is the tropopause.
    warmth = 1.0 - cooling_per_m * np.append(lower_m, thickness_m)
    air, vapour = of_air * warmth ** (power - 1.0), of_vapour * warmth ** (_VAPOUR_POWER - 1.0)
    lower, top = (air - vapour)[:, :-1], (air - vapour)[:, -1:]
    falls_per_m = cooling_per_m * ((power - 1.0) * air - (_VAPOUR_POWER - 1.0) * vapour)[:, :-1] / warmth[:, :-1]
    upper_m = thickness_m + _UPPER_NODES * kelvin * warmth[:, -1:] / per_scale_k_per_m
    return (
        np.concatenate([np.broadcast_to(lower_m, lower.shape), upper_m], axis=-1),
        np.concatenate([lower, top * np.exp(-_UPPER_NODES)], axis=-1),
        np.concatenate([0.5 * thickness_m * falls_per_m * _LOWER_WEIGHTS, top * _UPPER_WEIGHTS], axis=-1),
    )


def _vapour_pressure(pressure_hpa: FloatArray, temperature_c: FloatArray, relative_humidity: float) -> FloatArray:
    """Return the pressure of the water vapour at the observer, hPa."""
    over_water = 10.0 ** ((0.7859 + 0.03477 * temperature_c) / (1.0 + 0.00412 * temperature_c))
    saturated = over_water * (1.0 + pressure_hpa * (4.5e-6 + 6e-10 * temperature_c**2))
    vapour_share = saturated / pressure_hpa
    vapour_hpa: FloatArray = relative_humidity * saturated / (1.0 - (1.0 - relative_humidity) * vapour_share)
    return vapour_hpa


def _dry_refractivity(wavelength_um: float) -> float:
    """Return the refractivity n - 1 of dry air, times temperature and divided by pressure, K/hPa."""
    per_square = 1.0 / wavelength_um**2
    return (287.6155 + 1.62887 * per_square + 0.01360 * per_square**2) * 1e-6 * _ZERO_C_K / 1013.25
