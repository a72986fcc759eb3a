"""Position from several theodolites: errors against the covariance, inconsistent sets, lines without intersection.

Positions and directions are computed by pyerfa's own routines and by formulas of this file.
"""

import functools
from dataclasses import replace

import erfa
import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import ARCSEC
from ship_testing.theodolite_stations import (
    AIR,
    AXES,
    ORIGIN,
    ORIGIN_M,
    PLACE_SIGMA_M,
    seen_direction,
    station,
    theodolite_n,
)
from theodolite_calib.triangulation.triangulation import (
    RefractionConfig,
    StationDirection,
    TriangulatedPosition,
    _Line,
    triangulate,
)

SIGMA, DRAWS = 3.0 * ARCSEC, 1000


def random_stations(seed: int, noise: float = 1.0, spread_m: float = 50.0, distance_m: float = 2000.0):
    """Return three theodolites in a row, a random target around them, and its position from the origin."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(-0.5, 60.0))
    line = np.array([np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)])
    target_n = distance_m * line
    coefficient = AIR.coefficient + noise * AIR.sigma * rng.standard_normal()
    directions = []
    for number in range(3):
        at = station(f"t{number}", np.array([(number - 1) * spread_m, 2.0 * number, 5.0 * number]))
        foot_m = erfa.gd2gc(1, at.position.longitude, at.position.latitude, at.position.height_m)
        true_foot_m = foot_m + noise * PLACE_SIGMA_M * rng.standard_normal(3)
        direction_n = seen_direction(at, true_foot_m, ORIGIN_M + target_n @ AXES, coefficient)
        across = np.linalg.svd(direction_n[None])[2][1:]
        measured_n = direction_n + noise * SIGMA * rng.standard_normal(2) @ across
        measured_n /= np.linalg.norm(measured_n)
        directions.append(StationDirection(at, measured_n, SIGMA**2 * across.T @ across))
    return directions, target_n


def triangulate_directions(directions, **changes) -> TriangulatedPosition:
    place = triangulate(ORIGIN, directions, changes.get("air", AIR))
    assert isinstance(place, TriangulatedPosition)
    return place


@pytest.mark.parametrize(("spread_m", "distance_m"), [(50.0, 2000.0), (5000.0, 20_000.0)])
def test_without_errors_the_place_is_exact_on_the_curved_earth(spread_m: float, distance_m: float) -> None:
    for seed in range(20):
        directions, target_n = random_stations(seed, noise=0.0, spread_m=spread_m, distance_m=distance_m)
        place = triangulate_directions(directions)
        # ``seen_direction`` raises by the angle, the tested code along Up: the two differ by the square of 4" to 42".
        np.testing.assert_allclose(place.position_n, target_n, atol=1e-3 * distance_m / 2000.0)
        assert place.rejection is None


@functools.cache
def errors() -> tuple[np.ndarray, np.ndarray, float]:
    nees, chi_square, rejected = [], [], 0
    for seed in range(DRAWS):
        directions, target_n = random_stations(seed)
        place = triangulate_directions(directions)
        nees.append(normalized_error_squared(target_n - place.position_n, place.covariance_n))
        chi_square.append(place.chi_square)
        rejected += place.rejection is not None
    return np.array(nees), np.array(chi_square), rejected


def test_three_theodolites_match_their_covariance_at_2_km() -> None:
    nees, chi_square, rejected = errors()
    low, high = mean_nees_band(DRAWS, 3)
    assert low < nees.mean() < high
    low, high = mean_nees_band(DRAWS, 3)  # six residuals less three unknowns of the position
    assert low < chi_square.mean() < high
    assert rejected <= 6  # one in a thousand: more has a probability of 1e-4 (Poisson of mean 1)


def test_wrong_direction_rejects_the_set() -> None:
    directions, _ = random_stations(3)
    wrong = directions[1].direction_n + 60.0 * ARCSEC * np.array([0.0, 1.0, 0.0])
    place = triangulate_directions(
        [directions[0], replace(directions[1], direction_n=wrong / np.linalg.norm(wrong)), directions[2]]
    )
    assert place.chi_square > place.gate
    assert place.rejection is not None
    assert place.rejection.reason is Reason.GATE


@pytest.mark.parametrize("kind", ["one", "parallel", "behind", "nan"])
def test_missing_position_is_reported(kind: str) -> None:
    directions, _ = random_stations(4, noise=0.0)
    given = {
        "one": directions[:1],
        "parallel": [replace(each, direction_n=directions[0].direction_n) for each in directions],
        "behind": [replace(each, direction_n=-each.direction_n) for each in directions],
        "nan": [replace(directions[0], direction_n=np.full(3, np.nan)), *directions[1:]],
    }[kind]
    result = triangulate(ORIGIN, given, AIR)
    assert isinstance(result, Rejection)
    expected = {"one": "two or more", "parallel": "parallel", "behind": "behind t0", "nan": "NaN"}
    assert expected[kind] in result.text


@pytest.mark.parametrize("distance_m", [50.0, 2000.0, 50_000.0])
def test_the_change_by_the_place_is_that_of_finite_differences(distance_m: float) -> None:
    directions, _ = random_stations(1, noise=0.0)
    line = _Line.from_direction(directions[0], AXES, ORIGIN_M)
    place_n, step_m = line.foot_n + distance_m * np.array([0.8, 0.1, -0.59]), 1e-3 * distance_m
    _, by_path_n, _ = line.direction_to(place_n, AIR.coefficient)
    differences = [
        (
            line.direction_to(place_n + step_n, AIR.coefficient)[0]
            - line.direction_to(place_n - step_n, AIR.coefficient)[0]
        )
        / (2.0 * step_m)
        for step_n in step_m * np.eye(3)
    ]
    # Central differences are off by a sixth of the step squared, over the cube of the distance.
    np.testing.assert_allclose(by_path_n, np.transpose(differences), rtol=0.0, atol=1e-6 / distance_m)


def two_abreast_stations(
    distance_m: float, sigma: float, rng: np.random.Generator
) -> tuple[list[StationDirection], np.ndarray]:
    """Return directions from two theodolites 50 m apart, abreast of the target, and its position; air is known."""
    target_n, directions = np.array([25.0, 0.05 * distance_m, distance_m]), []
    for number in range(2):
        at = replace(station(f"t{number}", theodolite_n(number)), sigma_m=0.0)
        direction_n = seen_direction(
            at, ORIGIN_M + theodolite_n(number) @ AXES, ORIGIN_M + target_n @ AXES, AIR.coefficient
        )
        across = np.linalg.svd(direction_n[None])[2][1:]
        measured_n = direction_n + sigma * rng.standard_normal(2) @ across
        directions.append(StationDirection(at, measured_n / np.linalg.norm(measured_n), sigma**2 * across.T @ across))
    return directions, target_n


def test_two_theodolites_match_their_covariance_at_50_km() -> None:
    rng, nees = np.random.default_rng(20), []
    for _ in range(DRAWS):
        directions, target_n = two_abreast_stations(50_000.0, SIGMA, rng)
        place = triangulate_directions(directions, air=RefractionConfig(coefficient=AIR.coefficient, sigma=0.0))
        nees.append(normalized_error_squared(target_n - place.position_n, place.covariance_n))
    low, high = mean_nees_band(DRAWS, 3)
    assert low < np.mean(nees) < high


@pytest.mark.parametrize(("distance_m", "sigma"), [(50_000.0, 100.0 * ARCSEC), (2000.0, 0.02)])
def test_position_with_unknown_distance_is_rejected(distance_m: float, sigma: float) -> None:
    """The relative sigma of the distance is sqrt(2) sigma distance / 50 m: 0.69 and 1.1."""
    rng, texts = np.random.default_rng(21), []
    for _ in range(200):
        result = triangulate(ORIGIN, two_abreast_stations(distance_m, sigma, rng)[0], AIR)
        assert isinstance(result, Rejection)
        assert result.reason is Reason.GATE
        texts.append(result.text)
    # With these errors the lines may also meet behind the theodolites.
    assert sum("set the theodolites further apart, or measure a range" in text for text in texts) > 100
