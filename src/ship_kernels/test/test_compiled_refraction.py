"""Compiled refraction against the same by numpy: angles, directions, and displacement by common errors."""

import numpy as np
import pytest

from ship_geometry.air.refraction import (
    LOWEST_ELEVATION,
    MODELS,
    ModelName,
    Weather,
    raised_directions,
    refraction,
    seen_through_air,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_stars

RNG_SEED = 6
LINEAR, CUBIC = np.array([2.9e-4, 2.8e-7, -1.0e-6]), np.array([-3.2e-7, -3.0e-10, 1.2e-9])
TWO_TERMS = np.stack([LINEAR, CUBIC])
FOUR_TERMS = np.stack([LINEAR, CUBIC, 2e-2 * LINEAR**2, -4e-5 * LINEAR**2])
TERMS = {"erfa": TWO_TERMS, "almanac": TWO_TERMS, "ray_trace": FOUR_TERMS}
CURVATURES = {"erfa": 0.0, "almanac": 0.0, "ray_trace": 0.003}
SIGMAS = {
    "erfa": np.array([0.03, 1e-4, 0.0]) * ARCSEC,
    "almanac": np.array([0.0, 0.0, 0.007]),
    "ray_trace": np.array([0.0, 5e-6 * ARCSEC, 6e-4]),
}


def equal(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-16)


def by_numpy(model: ModelName, elevation: FloatArray) -> tuple[FloatArray, ...]:
    tan_z = 1.0 / np.tan(np.where(elevation >= LOWEST_ELEVATION[model], elevation, np.nan))
    terms = TERMS[model]
    powers = (tan_z**2 / (1.0 + CURVATURES[model] * tan_z**2))[:, None] ** np.arange(len(terms))
    angles = (powers @ terms) * tan_z[:, None]
    if model == "erfa":
        angles /= (1.0 + (LINEAR[0] + 3.0 * CUBIC[0] * tan_z**2) * (1.0 + tan_z**2))[:, None]
    everywhere, per_tan5, share = SIGMAS[model]
    return angles, everywhere + per_tan5 * tan_z**5 + share * angles[:, 0]


def some_stars() -> FloatArray:
    """Return directions to low and high stars, one of them below the horizon."""
    rng, elevation = np.random.default_rng(RNG_SEED), np.deg2rad([-20.0, 4.0, 6.0, 13.0, 15.0, 45.0, 89.9])
    azimuth = rng.uniform(0.0, 2.0 * np.pi, len(elevation))
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)], axis=-1)


@pytest.mark.parametrize("model", MODELS)
def test_angles_are_those_by_numpy(model: ModelName) -> None:
    elevation = np.deg2rad(np.linspace(-10.0, 90.0, 41))
    of_air = TERMS[model], CURVATURES[model], LOWEST_ELEVATION[model], model == "erfa", SIGMAS[model]
    angles, sigma = compiled_stars.refraction_angles(elevation, *of_air)
    expected_angles, expected_sigma = by_numpy(model, elevation)
    equal(angles, expected_angles)
    equal(sigma, expected_sigma)
    assert np.isnan(sigma).any()
    assert np.isfinite(sigma).any()


@pytest.mark.parametrize("model", MODELS)
def test_apparent_directions_and_displacements_equal_numpy(model: ModelName) -> None:
    stars, turns_n = some_stars(), np.random.default_rng(RNG_SEED).standard_normal((3, 3))
    weather, (by_hpa, by_kelvin) = Weather(1002.0, 17.0), (3.0, 2.0)
    seen = seen_through_air(model, stars, weather, 0.55, (by_hpa, by_kelvin), turns_n)
    elevation = np.arctan2(stars[:, 1], np.hypot(stars[:, 0], stars[:, 2]))
    equal(seen.elevation, elevation)
    bent = refraction(model, elevation, weather)
    raised, azimuth = elevation + bent.angle, np.arctan2(stars[:, 2], stars[:, 0])
    level = np.cos(raised)
    expected_n = np.stack([level * np.cos(azimuth), np.sin(raised), level * np.sin(azimuth)], axis=-1)
    np.testing.assert_allclose(seen.direction_n, expected_n, rtol=0.0, atol=1e-15)
    upward_n = np.stack([-np.sin(raised) * np.cos(azimuth), level, -np.sin(raised) * np.sin(azimuth)], axis=-1)
    shared_n = np.concatenate(
        [(upward_n * bent.sigma(by_hpa, by_kelvin)[:, None])[None], np.cross(turns_n[:, None], expected_n)]
    )
    np.testing.assert_allclose(seen.shared_n, np.moveaxis(shared_n, 0, -1), rtol=0.0, atol=1e-14)
    low = elevation < LOWEST_ELEVATION[model]
    assert np.isnan(seen.direction_n[low]).all()
    assert np.isfinite(seen.direction_n[~low]).all()


def test_directions_and_angles_broadcast() -> None:
    stars, angles = some_stars(), np.linspace(0.0, 1e-3, 7)
    equal(
        raised_directions(stars, angles),
        np.stack([raised_directions(star, angle) for star, angle in zip(stars, angles, strict=True)]),
    )
    equal(raised_directions(stars[3], angles), raised_directions(np.broadcast_to(stars[3], (7, 3)), angles))
    equal(raised_directions(stars, np.asarray(1e-3)), raised_directions(stars, np.full(7, 1e-3)))


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The compiled loops do not check bounds, so the functions check shapes."""
    stars, coefficients, sigmas, turns = some_stars(), TWO_TERMS, SIGMAS["erfa"], np.zeros((3, 3))
    for arguments in (
        (stars[:, :2].copy(), coefficients, sigmas, turns),
        (stars, coefficients[:1], sigmas, turns),
        (stars, FOUR_TERMS, sigmas, turns),
        (stars, coefficients, sigmas[:2], turns),
        (stars, coefficients, sigmas, turns[:, :2].copy()),
    ):
        vectors, of_model, of_sigmas, turned = arguments
        with pytest.raises(ValueError, match="do not fit together"):
            compiled_stars.seen_through_air(vectors, of_model, 0.0, 0.1, True, of_sigmas, 1.0, 1.0, turned)
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_stars.refraction_angles(stars[:, 1].copy(), coefficients[:1], 0.0, 0.1, True, sigmas)
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_stars.raised_directions(stars, np.zeros(3))
