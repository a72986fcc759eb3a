"""Errors that depend on a star's position on the detector: statistics of their stated process.

The field-spatial error is a Gaussian process with the correlation exp(-d²/(2 · 1.5²)), d in half sides, less its mean
over the detector; expected values come from sums over a grid of positions.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from ship_estimation.parameters.schema import ParameterError
from ship_stars.camera.camera import Distortion, StarCamera
from ship_stars.camera.config import CameraConfig
from ship_stars.camera.errors import FIELD_MODES, SpatialErrors

CAMERA = StarCamera(focal_length_m=0.05, pixel_pitch_m=5.5e-6, principal_u_px=1023.5, principal_v_px=767.5)
HALF_PX = np.array([1023.5, 767.5])
FIELD_PX, PIXEL_PX, LENGTH = 0.3, 0.2, 1.5
ERRORS = SpatialErrors(CAMERA, FIELD_PX, PIXEL_PX)
PIXEL_RAD = 5.5e-6 / 0.05


GRID = np.stack(np.meshgrid(*[(np.arange(40) + 0.5) / 20.0 - 1.0] * 2), axis=-1).reshape(-1, 2)


def correlation(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    squared = np.sum((places[:, None] - others) ** 2, axis=-1)
    return np.exp(-0.5 * squared / LENGTH**2)


def powers(places: np.ndarray) -> np.ndarray:
    """Return all products of powers up to the third degree, shape (k, 10)."""
    return np.stack([places[:, 0] ** i * places[:, 1] ** j for i in range(4) for j in range(4 - i)], axis=-1)


def polynomial_variance(places: np.ndarray) -> np.ndarray:
    """Return the covariance at positions (half sides) of the best polynomial fit to the process, less its mean.

    The process is scaled so that its mean square over the detector is 1 after its mean is subtracted.
    """
    fit = np.linalg.pinv(powers(GRID))
    less_mean = (powers(places) - powers(GRID).mean(axis=0)) @ fit
    of_process = correlation(GRID, GRID)
    return less_mean @ of_process @ less_mean.T / (1.0 - of_process.mean())


def in_pixels(displacement_s: np.ndarray, directions_s: np.ndarray) -> np.ndarray:
    moved = directions_s[:, None] + np.swapaxes(displacement_s, -1, -2)
    return CAMERA.pixels(moved) - CAMERA.pixels(directions_s)[:, None]


def test_the_field_error_is_the_best_polynomial_of_the_stated_process():
    places = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 2))
    directions_s = CAMERA.directions((places + 1.0) * HALF_PX)
    modes_px = in_pixels(ERRORS.field_modes(directions_s), directions_s)
    assert modes_px.shape == (10, FIELD_MODES, 2)
    for axis in range(2):
        covariance = modes_px[..., axis] @ modes_px[..., axis].T
        # The sums over the grid are accurate to some thousandths.
        np.testing.assert_allclose(covariance / FIELD_PX**2, polynomial_variance(places), atol=0.01)
    # Modes of u do not change v.
    np.testing.assert_allclose(modes_px[..., 0] @ modes_px[..., 1].T, 0.0, atol=1e-9)


def test_the_polynomial_leaves_out_a_thousandth_of_its_variance():
    directions_s = CAMERA.directions((GRID + 1.0) * HALF_PX)
    modes_px = in_pixels(ERRORS.field_modes(directions_s), directions_s)
    mean_square = np.mean(np.sum(modes_px**2, axis=1), axis=0)
    np.testing.assert_allclose(mean_square, 0.999 * FIELD_PX**2, rtol=0.001)
    np.testing.assert_allclose(modes_px.mean(axis=0), 0.0, atol=1e-3)


def information_ratios(steps_px: np.ndarray, stars: int = 12, noise_px: float = 0.0, seed: int = 3) -> np.ndarray:
    """Return the information of successive exposures, relative to a single one, for given movements, shape (n,)."""
    rng = np.random.default_rng([7, seed])
    places, dwell, found = rng.uniform(100.0, 1400.0, (stars, 2)), None, []
    for place in np.cumsum(steps_px, axis=0):
        seen = places + place + noise_px * rng.standard_normal((stars, 2))
        dwell = ERRORS.pixel_dwell(CAMERA.directions(seen), np.full(stars, noise_px * PIXEL_RAD), dwell)
        found.append(1.0 / (1.0 + dwell.excess_ratio))
    return np.array(found)


def drift(step_px: tuple[float, float], count: int = 300) -> np.ndarray:
    return np.vstack([[0.0, 0.0], np.tile(step_px, (count - 1, 1))])


@pytest.mark.parametrize("step_px", [(0.05, 0.0), (0.15, 0.0), (0.1, 0.1), (0.6, -0.2), (5.0, 3.0)])
def test_the_variance_of_exposures_on_the_same_pixels_matches_their_error(step_px: tuple[float, float]):
    """Stars drift over square pixels with independent errors: variance of the weighted mean of 300 exposures.

    The correlation of two exposures' errors is the overlap of a pixel with the shifted pixel. The overlap decreases
    linearly with distance, the filter's correlation exponentially.
    """
    exposures, number = information_ratios(drift(step_px), stars=100), np.arange(300)
    distance_px = np.abs(number[:, None] - number)[..., None] * np.abs(step_px)
    overlap = np.prod(np.maximum(1.0 - distance_px, 0.0), axis=-1)
    variance = exposures @ overlap @ exposures / exposures.sum() ** 2
    assert variance == pytest.approx(1.0 / exposures.sum(), rel=0.15)


@pytest.mark.statistics
@pytest.mark.parametrize(("drift_px", "sway_px"), [(0.03, 0.0), (0.1, 0.0), (0.2, 0.0), (0.1, 0.3), (0.2, 0.3)])
def test_noise_and_sway_do_not_count_as_new_pixels(drift_px: float, sway_px: float):
    """The mean of 100 noisy exposures of eight stars on random pixels has the variance that the model states.

    There are 60 runs with two axes each. The stated variance may differ from the truth by a fifth, in addition to the
    99.9 % band.
    """
    squares = []
    for seed in range(60):
        rng = np.random.default_rng([8, seed])
        steps = np.vstack([[0.0, 0.0], np.diff(sway_px * rng.standard_normal((100, 2)), axis=0)])
        steps[1:, 0] += drift_px
        noise_px = 0.1
        variance = noise_px**2 + PIXEL_PX**2 / information_ratios(steps, stars=8, noise_px=noise_px, seed=seed)
        path = np.rint(np.cumsum(steps, axis=0)[:, None] + rng.uniform(-0.5, 0.5, (8, 2)))
        errors = np.stack([_of_pixels(rng, path[:, star]) for star in range(8)], axis=1)
        seen = (PIXEL_PX * errors + noise_px * rng.standard_normal(errors.shape)).mean(axis=1)
        mean = (seen / variance[:, None]).sum(axis=0) / (1.0 / variance).sum()
        squares += (mean**2 * 8.0 * (1.0 / variance).sum()).tolist()
    low, high = chi2.ppf([0.0005, 0.9995], len(squares)) / len(squares)
    assert 0.8 * low <= np.mean(squares) <= 1.2 * high


def _of_pixels(rng: np.random.Generator, path: np.ndarray) -> np.ndarray:
    """Return errors of unit variance along a path over pixels, shape (n, 2): one pair of numbers per pixel."""
    _, which = np.unique(path, axis=0, return_inverse=True)
    return rng.standard_normal((which.max() + 1, 2))[which.ravel()]


def test_a_rotation_of_the_stars_about_their_mean_counts_as_movement():
    """Twelve stars rotate about their mean position, with the same root mean square movement as a shift."""
    places = np.random.default_rng(11).uniform(-400.0, 400.0, (12, 2))
    arm = np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))
    dwell = ERRORS.pixel_dwell(CAMERA.directions(HALF_PX + places), np.full(12, 1e-12), None)
    for way_px in (1.0, 2.0):
        cosine, sine = np.cos(way_px / arm), np.sin(way_px / arm)
        turned = (places - places.mean(axis=0)) @ np.array([[cosine, sine], [-sine, cosine]]) + places.mean(axis=0)
        shifted = places + np.array([way_px, 0.0])
        by_turn, by_shift = (
            ERRORS.pixel_dwell(CAMERA.directions(HALF_PX + moved), np.full(12, 1e-12), dwell).excess_ratio
            for moved in (turned, shifted)
        )
        assert by_turn == pytest.approx(by_shift, rel=0.02)
        assert by_turn < 1.0


def test_at_the_fold_of_a_distortion_the_error_is_finite():
    """The image of a lens folds at 1/sqrt(60) of the focal length; the star is 0.01 pixel inside the fold."""
    folds = StarCamera(0.05, 5.5e-6, 1023.5, 767.5, Distortion(k1=-20.0))
    edge = folds.pixels(np.array([[1.0, 0.0, 1.0 / np.sqrt(60.0)]]))
    inside = folds.directions(edge - np.array([0.01, 0.0]))
    assert np.all(np.isfinite(SpatialErrors(folds, 0.3, 0.0).field_modes(inside)))


def test_stars_on_new_pixels_start_a_new_dwell():
    assert information_ratios(drift((8.0, 0.0), 5)).tolist() == [1.0] * 5
    dwell = ERRORS.pixel_dwell(CAMERA.directions(np.array([[300.0, 400.0]])), np.full(1, 1e-6), None)
    other = ERRORS.pixel_dwell(CAMERA.directions(np.array([[900.0, 200.0]])), np.full(1, 1e-6), dwell)
    assert (other.exposure_count, other.excess_ratio) == (0, 0.0)


def test_exactly_constant_stars_add_the_least_information():
    exposures = information_ratios(np.zeros((50, 2)))
    assert exposures[0] == 1.0
    assert np.all(exposures[1:] == 1e-3)


@pytest.mark.parametrize("length_px", [0.0, 0.3, 2.0, 30.0])
def test_a_streak_averages_over_its_pixels(length_px: float):
    """The ratio equals the double mean of exp(-2 |s - t|) over the streak, computed by sums."""
    ways = (np.arange(2000) + 0.5) / 2000.0 * length_px
    expected = np.mean(np.exp(-2.0 * np.abs(ways[:, None] - ways)))
    share = ERRORS.streak_variance_ratio(np.array([length_px * PIXEL_RAD]))
    np.testing.assert_allclose(share, expected, rtol=1e-3)


def test_a_field_error_needs_the_size_of_the_detector():
    config = CameraConfig(focal_length_m=0.05, pixel_pitch_m=5.5e-6, field_spatial_sigma_px=0.1)
    with pytest.raises(ParameterError, match=r"'cam.principal_u_px' and 'cam.principal_v_px' must be given"):
        config.camera("cam")


def test_without_spatial_errors_nothing_is_modelled():
    config = CameraConfig(focal_length_m=0.05, pixel_pitch_m=5.5e-6)
    assert config.spatial_errors(config.camera("cam")) is None
