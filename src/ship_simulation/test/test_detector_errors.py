"""Errors of a simulated detector by position: the stated statistics, constant for each position."""

import numpy as np
import pytest
from scipy.stats import chi2

from ship_simulation.random_draws import random_stream
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario import Detector
from ship_simulation.stars.true_camera import DetectorErrors
from ship_testing.paper_stars import paper_stars, with_sensor

FIELD_PX, PIXEL_PX, SEEDS = 0.3, 0.2, 600
DETECTOR = {"focal_length_m": 0.05, "pixel_pitch_m": 5.5e-6, "principal_u_px": 499.5, "principal_v_px": 299.5}
SIDES = {"width_px": 1000, "height_px": 600}


def draw_errors(seed: int, field_px: float = 0.0, pixel_px: float = 0.0) -> DetectorErrors:
    own = {"field_spatial_sigma_px": field_px, "pixel_spatial_sigma_px": pixel_px}
    return DetectorErrors(np.random.default_rng([9, seed]), Detector(**DETECTOR, **SIDES, **own))


def test_the_field_errors_covariance_is_the_stated_one():
    """Variances at three positions, u and v, over 600 seeds, and the correlation of each pair.

    The expected covariance is exp(-d²/(2 · 1.5²)), d in half sides, less the mean over the detector (sums over a grid).
    """
    side = (np.arange(40) + 0.5) / 20.0 - 1.0
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    places = np.array([[0.1, -0.2], [0.6, 0.1], [-0.8, 0.7]])

    def correlation(some, others):
        return np.exp(-0.5 * np.sum((some[:, None] - others) ** 2, axis=-1) / 1.5**2)

    to_grid, of_grid = correlation(places, grid).mean(axis=1), correlation(grid, grid).mean()
    covariance = (correlation(places, places) - to_grid[:, None] - to_grid + of_grid) / (1.0 - of_grid)
    pixels = np.array([499.5, 299.5]) + places * np.array([500.0, 300.0])
    errors = np.array([draw_errors(seed, field_px=FIELD_PX).errors_at(pixels) for seed in range(SEEDS)])
    low, high = chi2.ppf([0.0005, 0.9995], SEEDS) / SEEDS
    for axis in range(2):
        root = np.linalg.cholesky(FIELD_PX**2 * covariance)
        whitened = np.linalg.solve(root, errors[..., axis].T)
        spread = np.mean(whitened**2, axis=1)
        assert np.all((low <= spread) & (spread <= high))
        # Pairs: 3.29 standard errors of a correlation coefficient.
        pairs = (whitened @ whitened.T / SEEDS)[np.triu_indices(3, 1)]
        assert np.all(np.abs(pairs) <= 3.29 / np.sqrt(SEEDS))
    across = np.mean(errors[..., 0] * errors[..., 1]) / FIELD_PX**2
    assert abs(across) <= 3.29 / np.sqrt(SEEDS)


def test_a_maps_mean_over_the_detector_is_zero():
    pixels = np.stack(np.meshgrid(np.arange(5.0, 1000.0, 10.0), np.arange(5.0, 600.0, 10.0)), axis=-1).reshape(-1, 2)
    found = draw_errors(1, field_px=FIELD_PX).errors_at(pixels - 0.5)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-4)


def test_each_pixel_has_its_own_error():
    errors = draw_errors(2, pixel_px=PIXEL_PX)
    whole = np.stack(np.meshgrid(np.arange(100.0), np.arange(100.0)), axis=-1).reshape(-1, 2)
    found = errors.errors_at(whole)
    np.testing.assert_array_equal(errors.errors_at(whole + 0.4), found)
    low, high = chi2.ppf([0.0005, 0.9995], found.size) / found.size
    assert low <= np.mean((found / PIXEL_PX) ** 2) <= high
    assert not np.any(errors.errors_at(whole + 1.0) == found)


@pytest.mark.parametrize("kind", ["field_spatial_sigma_px", "pixel_spatial_sigma_px"])
def test_centroids_of_a_run_contain_constant_detector_errors(kind: str):
    """Centroids without noise, minus the true points, are the errors of one detector at all times."""
    camera = {kind: 0.3, "centroid_sigma_px": 1e-6}
    run = simulate(with_sensor(paper_stars(), camera=camera), seed=5)
    sightings, detector = run.stars["fore"], run.scenario.star_sensors["fore"].camera
    true_px = detector.camera("camera").pixels(run.truth.sightings["fore"].direction_s)
    added_px = sightings.pixel - true_px
    assert np.sqrt(np.mean(added_px**2)) > 0.1
    clean = simulate(with_sensor(paper_stars(), camera={"centroid_sigma_px": 1e-6}), seed=5)
    np.testing.assert_allclose(clean.stars["fore"].pixel, true_px, atol=1e-5)
    errors = DetectorErrors(random_stream(5, "star.fore.detector"), detector)
    np.testing.assert_allclose(added_px, errors.errors_at(true_px), atol=1e-5)
