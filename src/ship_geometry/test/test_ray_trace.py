"""Traced rays against published values, ERFA, and rays integrated by scipy; and the coverage of their sigma."""

from collections.abc import Callable

import erfa
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ship_geometry.air.ray_trace import STANDARD, Atmosphere, traced_refraction
from ship_geometry.air.refraction import LOWEST_ELEVATION, Weather, refraction
from ship_geometry.rotations import ARCSEC, FloatArray

REFRACTIVE = 79.0265e-6
"""(287.6155 + 1.62887/0.55² + 0.01360/0.55⁴) · 1e-6 · 273.15/1013.25, K/hPa, of dry air (IAG 1999)."""

AIR = {"pressure_hpa": 1013.25, "temperature_c": 15.0, "relative_humidity": 0.5}
LOW_DEG = np.array([5.01, 6.0, 7.0, 8.0, 10.0, 15.0, 20.0, 30.0, 45.0])
"""True elevations (without refraction), degrees."""


def trace_refraction(zenith_deg: FloatArray | float, weather: Weather, atmosphere: Atmosphere = STANDARD) -> FloatArray:
    return traced_refraction(
        np.atleast_1d(np.deg2rad(zenith_deg)),
        np.array([weather.pressure_hpa]),
        np.array([weather.temperature_c]),
        weather.relative_humidity,
        0.55,
        atmosphere,
    )[0]


def observed_zenith_distance(elevation_deg: FloatArray, weather: Weather) -> FloatArray:
    """Return the zenith distance with air, degrees."""
    angle = refraction("ray_trace", np.deg2rad(elevation_deg), weather).angle
    return 90.0 - elevation_deg - np.rad2deg(angle)


def test_slalibs_own_value():
    # SLALIB's test of slaRefro(1.4, 3456.7, 280, 678.9, 0.9, 0.55, -0.3, 0.006, 1e-9).
    of_observer = np.array([678.9]), np.array([280.0 - 273.15]), 0.9, 0.55
    above = Atmosphere(lapse_k_per_m=0.006, latitude=-0.3, height_m=3456.7)
    ours = traced_refraction(np.array([1.4]), *of_observer, above)[0, 0]
    # SLALIB neglects the air above 80 km. There the barometric formula gives n - 1 = 3.6e-9, and a constant n r sin z
    # gives tan z = 4.6.
    assert ours - 0.00106715763018568 == pytest.approx(3.6e-9 * 4.6, abs=1e-9)


@pytest.mark.parametrize(
    ("zenith_deg", "arcsec"),
    [(10, 10.27), (30, 33.61), (45, 58.16), (60, 100.51), (70, 158.63), (74, 200.35), (78, 267.44), (80, 319.13)],
)
def test_rays_of_erfas_description(zenith_deg, arcsec):
    # The description of ERFA's refco: 1005 hPa, 7 °C, 80 % humidity, 0.574 µm, a lapse rate of 6.5 K/km, at sea.
    found = traced_refraction(np.deg2rad([zenith_deg]), np.array([1005.0]), np.array([7.0]), 0.8, 0.574)[0, 0]
    # ERFA's description uses an older refractivity of air, which differs by 0.02 %.
    assert found / ARCSEC == pytest.approx(arcsec, rel=2.5e-4, abs=0.005)


def test_high_up_it_is_erfas_refraction():
    weather = Weather(**AIR)
    high = np.deg2rad([35.0, 50.0, 70.0, 85.0])
    a, b = erfa.refco(*AIR.values(), 0.55)
    ours = refraction("ray_trace", high, weather).angle
    tan_z = np.tan(np.pi / 2 - high - ours)
    # ERFA states an error of 10 mas for refco up to a zenith distance of 55°.
    assert np.abs(ours - (a * tan_z + b * tan_z**3)).max() < 0.012 * ARCSEC


def drawn_ray(zenith: float, temperature: Callable[[float], tuple[float, float]]) -> float:
    """Return the refraction of dry air by the equation of a light ray in a plane, integrated step by step.

    Args:
        zenith: zenith distance with air, rad.
        temperature: returns the temperature, K, and its change with height, K/m, at a height in metres.
    """
    radius_m, per_scale = 6_378_120.0, 9.784 * 28.9644 / 8314.32

    def derivatives(_: float, state: FloatArray) -> list[float]:
        x_m, y_m, bent, log_pressure = state
        distance_m = np.hypot(x_m, y_m)
        kelvin, slope = temperature(distance_m - radius_m)
        density = 1013.25 * np.exp(log_pressure) / kelvin
        falls = -density * (per_scale + slope) / kelvin
        direction = np.pi / 2 - zenith - bent
        cosine, sine = np.cos(direction), np.sin(direction)
        across, climbs = (y_m * cosine - x_m * sine) / distance_m, (x_m * cosine + y_m * sine) / distance_m
        bending = -REFRACTIVE * falls / (1.0 + REFRACTIVE * density) * across
        return [cosine, sine, bending, -per_scale / kelvin * climbs]

    end_m = 130e3 / np.cos(zenith)
    drawn = solve_ivp(
        derivatives, (0.0, end_m), [0.0, radius_m, 0.0, 0.0], "DOP853", rtol=1e-11, atol=1e-12, max_step=end_m / 2000
    )
    return float(drawn.y[2, -1])


def model_air(height_m: float) -> tuple[float, float]:
    return (288.15 - 0.0065 * height_m, -0.0065) if height_m < 11_000.0 else (216.65, 0.0)


@pytest.mark.parametrize("zenith_deg", [30.0, 70.0, 80.0, 84.8])
def test_a_ray_drawn_step_by_step_is_the_same(zenith_deg):
    dry = Weather(1013.25, 15.0, 0.0)
    assert trace_refraction(zenith_deg, dry)[0] == pytest.approx(
        drawn_ray(np.deg2rad(zenith_deg), model_air), abs=5e-5 * ARCSEC
    )


LAYERS_M = np.array([0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 200e3])
SLOPES = np.array([-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, 0.0])
BASES_K = 288.15 + np.concatenate([[0.0], np.cumsum(SLOPES * np.diff(LAYERS_M))])


def standard_1976(height_m: float) -> tuple[float, float]:
    """Return temperature, K, and its change with height, K/m, of the U.S. Standard Atmosphere 1976.

    Geopotential heights are taken as heights, and the last layer is isothermal.
    """
    layer = min(int(np.searchsorted(LAYERS_M, max(height_m, 0.0), "right")) - 1, len(SLOPES) - 1)
    return float(BASES_K[layer] + SLOPES[layer] * (height_m - LAYERS_M[layer])), float(SLOPES[layer])


def over_the_sea(warmer_k: float, within_m: float) -> Callable[[float], tuple[float, float]]:
    """Return air that becomes ``warmer_k`` warmer with height than the model air, mostly below ``within_m``."""

    def temperature(height_m: float) -> tuple[float, float]:
        kelvin, slope = model_air(height_m)
        left = np.exp(-max(height_m, 0.0) / within_m)
        return kelvin + warmer_k * (1.0 - left), slope + warmer_k * left / within_m

    return temperature


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("name", "air"),
    [
        ("U.S. Standard Atmosphere 1976", standard_1976),
        ("inversion, 3 K in 300 m", over_the_sea(3.0, 300.0)),
        ("warm sea, -1 K in 30 m", over_the_sea(-1.0, 30.0)),
        ("trade wind, 6 K in 1500 m", over_the_sea(6.0, 1500.0)),
    ],
)
def test_sigma_covers_air_that_is_built_otherwise(name, air):
    dry = Weather(1013.25, 15.0, 0.0)
    elevation_deg = np.array([5.01, 7.0, 10.0, 20.0, 45.0])
    sigma = refraction("ray_trace", np.deg2rad(elevation_deg), dry).model_sigma
    zenith_deg = observed_zenith_distance(elevation_deg, dry)
    errors = trace_refraction(zenith_deg, dry) - [drawn_ray(np.deg2rad(z), air) for z in zenith_deg]
    print(name, np.round(errors / ARCSEC, 3), "of", np.round(sigma / ARCSEC, 3))
    assert np.all(np.abs(errors) < sigma)


@pytest.mark.parametrize("temperature_c", [-30.0, 15.0, 40.0])
def test_sigma_is_what_varying_the_air_gives(temperature_c):
    """The numbers of the comment above _MODEL_SIGMAS; the error of the humidity is neglected for all models."""
    weather = Weather(1013.25, temperature_c, 0.5)
    zenith_deg = observed_zenith_distance(LOW_DEG, weather)
    given = trace_refraction(zenith_deg, weather)
    pairs = (
        (Atmosphere(lapse_k_per_m=0.005), Atmosphere(lapse_k_per_m=0.008)),
        (Atmosphere(tropopause_m=8e3), Atmosphere(tropopause_m=16e3)),
        (Atmosphere(latitude=0.0), Atmosphere(latitude=0.5 * np.pi)),
    )
    squares = np.zeros(len(LOW_DEG))
    for pair in pairs:
        both = np.array([trace_refraction(zenith_deg, weather, other) - given for other in pair])
        squares += np.abs(both).max(axis=0) ** 2
    # The pressure gradient is 1 hPa in 100 km along the line of sight. At constant temperature ∂n/∂x is proportional to
    # this gradient, and the integral of n - 1 over the height is 2.77e-4 times 8.4 km.
    tilted = 2.77e-4 * 8400.0 * 1e-5 / 1013.25 / np.sin(np.deg2rad(LOW_DEG)) ** 2
    refractivity = 2e-4 * given
    needed = np.sqrt(squares + tilted**2 + refractivity**2)
    share = needed / refraction("ray_trace", np.deg2rad(LOW_DEG), weather).model_sigma
    print(temperature_c, np.round(np.sqrt(squares) / ARCSEC, 3), np.round(tilted / ARCSEC, 3), np.round(share, 2))
    assert np.all(share < 1.0)
    assert share.max() > 0.5


@pytest.mark.parametrize("temperature_c", [-30.0, -10.0, 15.0, 40.0])
@pytest.mark.parametrize("pressure_hpa", [950.0, 1050.0])
def test_the_other_models_err_by_their_sigma(pressure_hpa, temperature_c):
    """The error of erfa is at most 1.3 sigmas (17.8″ at 5.3°), that of the almanac's model at most 2.0.

    The almanac's model has no humidity, and adds the effects of pressure and temperature instead of multiplying them:
    this model is worst in hot thin air.
    """
    weather = Weather(pressure_hpa, temperature_c, 0.7)
    for model, most in (("erfa", 1.35), ("almanac", 2.0)):
        elevation = np.linspace(LOWEST_ELEVATION[model], 1.5, 400)
        found, rays = refraction(model, elevation, weather), refraction("ray_trace", elevation, weather)
        ratio = np.abs(found.angle - rays.angle) / np.hypot(found.model_sigma, rays.model_sigma)
        print(model, pressure_hpa, temperature_c, f"{ratio.max():.2f}")
        assert ratio.max() < most


@pytest.mark.parametrize("temperature_c", [-60.0, -30.0, 15.0, 45.0, 60.0])
@pytest.mark.parametrize("pressure_hpa", [800.0, 1013.25, 1100.0])
def test_the_expansion_is_the_traced_ray(pressure_hpa, temperature_c):
    weather = Weather(pressure_hpa, temperature_c, 0.9)
    zenith_deg = np.linspace(0.01, 84.9, 300)
    angle = trace_refraction(zenith_deg, weather)
    elevation = np.deg2rad(90.0 - zenith_deg) - angle
    held = elevation >= LOWEST_ELEVATION["ray_trace"]
    assert np.rad2deg(elevation[held].min()) < 5.3
    found = refraction("ray_trace", elevation[held], weather).angle
    assert np.abs(found - angle[held]).max() < 2e-4 * ARCSEC
