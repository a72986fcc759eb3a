"""The error model of the installation: numbers of [Z14], exact rules, finite differences, Monte Carlo."""

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_studies.layout.installation_model import (
    ErrorModel,
    InstallationConvention,
    combine_attitudes,
    linearise,
    ship_rotation,
)
from ship_testing.consistency import sigma_ratio_band

BOTH = pytest.mark.parametrize("reading", list(InstallationConvention))


def at_operating_point(azimuth_deg: FloatArray, reading: InstallationConvention) -> ErrorModel:
    """Return the error model at the example of [Z14]: As 235°, Es 45°, roll_s 90°, E0 35°, roll_0 0."""
    azimuth_deg = np.asarray(azimuth_deg, dtype=float)
    installation_deg = np.stack([azimuth_deg, np.full_like(azimuth_deg, 35.0), np.zeros_like(azimuth_deg)], axis=-1)
    return linearise(np.deg2rad([235.0, 45.0, 90.0]), np.deg2rad(installation_deg), reading)


def random_angles(rng: np.random.Generator, count: int) -> FloatArray:
    return np.deg2rad(rng.uniform([0.0, -80.0, -180.0], [360.0, 80.0, 180.0], (count, 3)))


def random_layouts(reading: InstallationConvention, count: int) -> tuple[FloatArray, FloatArray]:
    """Return layouts with a ship pitch below 85°; differences of angles are meaningless for larger pitches."""
    rng = np.random.default_rng(14)
    star, installation = random_angles(rng, 2 * count), random_angles(rng, 2 * count)
    upright = np.abs(linearise(star, installation, reading).ship_angles[:, 1]) < np.deg2rad(85.0)
    return star[upright][:count], installation[upright][:count]


def ship_angles(star: FloatArray, installation: FloatArray, reading: InstallationConvention) -> FloatArray:
    return angles_from_rotation(ship_rotation(star, installation, reading))


# Expected numbers of the next three tests: models.md §3, [Z14] figures.


def test_paper_convention_has_the_papers_peaks() -> None:
    azimuth_deg = np.arange(0.0, 360.0, 0.1)
    errors = np.abs(100.0 * at_operating_point(azimuth_deg, InstallationConvention.PAPER).star[:, :, 2])
    np.testing.assert_allclose(errors.max(axis=0), [112.07, 70.71, 61.64], atol=0.005)
    # The peak repeats after half a revolution.
    assert azimuth_deg[np.argmax(errors[:1800, 0])] == pytest.approx(105.0, abs=0.5)


def test_physical_convention_ahead_and_abeam() -> None:
    errors = np.abs(100.0 * at_operating_point(np.array([0.0, 90.0]), InstallationConvention.PHYSICAL).star[:, :, 2])
    np.testing.assert_allclose(errors[0], [35.01, 49.75, 61.64], atol=0.005)
    np.testing.assert_allclose(errors[1], [141.42, 0.0, 100.0], atol=0.005)


def test_conventions_differ_where_the_paper_claims_equality() -> None:
    physical, paper = (
        at_operating_point(np.array([90.0]), reading).star[0, 0, 2] for reading in InstallationConvention
    )
    assert abs(physical) == pytest.approx(1.4142, abs=1e-4)
    assert abs(paper) == pytest.approx(1.0641, abs=1e-4)


def test_installation_roll_moves_only_roll_in_the_papers_convention() -> None:
    model = linearise(*random_layouts(InstallationConvention.PAPER, 200), InstallationConvention.PAPER)
    np.testing.assert_allclose(model.installation[:, :, 2], np.tile([0.0, 0.0, 1.0], (200, 1)), atol=1e-12)


def test_installation_roll_is_minus_the_sensors_roll_physically() -> None:
    model = linearise(*random_layouts(InstallationConvention.PHYSICAL, 200), InstallationConvention.PHYSICAL)
    np.testing.assert_allclose(model.installation[:, :, 2], -model.star[:, :, 2], atol=1e-12)


@BOTH
def test_azimuth_of_the_sensor_moves_only_heading(reading: InstallationConvention) -> None:
    model = linearise(*random_layouts(reading, 200), reading)
    np.testing.assert_allclose(model.star[:, :, 0], np.tile([1.0, 0.0, 0.0], (200, 1)), atol=1e-12)


@BOTH
def test_jacobians_are_the_central_differences(reading: InstallationConvention) -> None:
    star, installation = random_layouts(reading, 1000)
    model = linearise(star, installation, reading)
    assert len(star) == 1000
    step = 1e-5
    for column in range(3):
        turn = step * np.eye(3)[column]
        by_star = ship_angles(star + turn, installation, reading) - ship_angles(star - turn, installation, reading)
        by_installation = ship_angles(star, installation + turn, reading) - ship_angles(
            star, installation - turn, reading
        )
        for jacobian, difference in ((model.star, by_star), (model.installation, by_installation)):
            np.testing.assert_allclose(jacobian[:, :, column], wrap_pi(difference) / (2.0 * step), atol=1e-6)


@BOTH
def test_covariance_is_that_of_monte_carlo(reading: InstallationConvention) -> None:
    rng = np.random.default_rng(2014)
    samples = 4000
    star_covariance = _random_covariance(rng, [3.0, 3.0, 100.0])
    installation_covariance = _random_covariance(rng, [1.0, 1.0, 20.0])
    for star, installation in zip(*random_layouts(reading, 5), strict=True):
        model = linearise(star, installation, reading)
        drawn_star = star + rng.multivariate_normal(np.zeros(3), star_covariance, samples)
        drawn_installation = installation + rng.multivariate_normal(np.zeros(3), installation_covariance, samples)
        errors = wrap_pi(ship_angles(drawn_star, drawn_installation, reading) - model.ship_angles)
        covariance = model.star @ star_covariance @ model.star.T
        covariance += model.installation @ installation_covariance @ model.installation.T
        low, high = mean_nees_band(samples, 3)
        assert low < normalized_error_squared(errors, covariance[None]).mean() < high
        low, high = sigma_ratio_band(samples)
        ratios = np.sqrt(np.mean(errors**2, axis=0) / np.diag(covariance))
        assert np.all((low < ratios) & (ratios < high))


def test_errors_add_with_their_signs() -> None:
    model = at_operating_point(np.array([0.0]), InstallationConvention.PHYSICAL)
    both = model.errors(np.array([3.0, 3.0, 100.0]), np.array([1.0, 1.0, 20.0]))
    separately = model.star @ [3.0, 3.0, 100.0] + model.installation @ [1.0, 1.0, 20.0]
    np.testing.assert_allclose(both, separately)
    # The rolls of sensor and installation partly cancel: 100 - 20.
    np.testing.assert_allclose(model.errors([0, 0, 100.0], [0, 0, 20.0]), 80.0 * model.star[:, :, 2], atol=1e-10)


@BOTH
def test_a_sweep_is_its_single_layouts(reading: InstallationConvention) -> None:
    star, installation = random_layouts(reading, 20)
    model = linearise(star.reshape(4, 5, 3), installation.reshape(4, 5, 3), reading)
    assert model.star.shape == (4, 5, 3, 3)
    for number in range(20):
        one = linearise(star[number], installation[number], reading)
        np.testing.assert_allclose(model.star.reshape(20, 3, 3)[number], one.star, atol=1e-12)
        np.testing.assert_allclose(model.installation.reshape(20, 3, 3)[number], one.installation, atol=1e-12)


def test_a_vertical_ship_has_no_defined_heading_error() -> None:
    # Boresight to the zenith, mounted along the keel: the bow points to the zenith.
    model = linearise(np.array([0.3, np.pi / 2, 0.0]), np.zeros(3))
    assert np.isnan(model.star).all()
    assert np.isnan(model.installation).all()


def test_independent_sensors_add_their_information() -> None:
    rng = np.random.default_rng(3)
    covariances = np.array([_random_covariance(rng, [3.0, 3.0, 100.0]) for _ in range(4)])
    combination = combine_attitudes(covariances)
    expected = np.linalg.inv(np.linalg.inv(covariances).sum(axis=0))
    np.testing.assert_allclose(combination.covariance, expected, rtol=1e-9)
    np.testing.assert_allclose(combination.gains.sum(axis=0), np.eye(3), atol=1e-9)


def test_an_equal_common_error_is_not_reduced() -> None:
    rng = np.random.default_rng(4)
    covariances = np.array([_random_covariance(rng, [3.0, 3.0, 100.0]) for _ in range(3)])
    shared = _random_covariance(rng, [0.2, 2.0, 0.2])
    combination = combine_attitudes(covariances, np.tile(np.eye(3), (3, 1, 1)), shared)
    np.testing.assert_allclose(combination.covariance, combine_attitudes(covariances).covariance + shared, rtol=1e-9)


def test_common_terms_agree_with_estimating_them() -> None:
    """An independent algorithm estimates the common errors with a prior, in one large information matrix."""
    rng = np.random.default_rng(5)
    covariances = np.array([_random_covariance(rng, [3.0, 3.0, 100.0]) for _ in range(3)])
    effects, common = rng.normal(size=(3, 3, 2)), np.diag([2.0, 5.0]) ** 2 * ARCSEC**2
    rows = np.concatenate([np.tile(np.eye(3), (3, 1, 1)), effects], axis=-1)
    information = np.einsum("nij,nik,nkl->jl", rows, np.linalg.inv(covariances), rows)
    information[3:, 3:] += np.linalg.inv(common)
    combination = combine_attitudes(covariances, effects, common)
    np.testing.assert_allclose(combination.covariance, np.linalg.inv(information)[:3, :3], rtol=1e-8)


def test_joint_covariance_is_that_of_monte_carlo() -> None:
    rng = np.random.default_rng(6)
    samples = 10_000
    covariances = np.array([_random_covariance(rng, [3.0, 3.0, 100.0]) for _ in range(2)])
    effects, common = rng.normal(size=(2, 3, 1)), np.array([[(3.0 * ARCSEC) ** 2]])
    combination = combine_attitudes(covariances, effects, common)
    shared = rng.multivariate_normal(np.zeros(1), common, samples)
    joint = np.zeros((samples, 3))
    for gain, covariance, effect in zip(combination.gains, covariances, effects, strict=True):
        own = rng.multivariate_normal(np.zeros(3), covariance, samples)
        joint += (own + shared @ effect.T) @ gain.T
    low, high = mean_nees_band(samples, 3)
    assert low < normalized_error_squared(joint, combination.covariance[None]).mean() < high


def test_many_combinations_at_once_are_the_single_ones() -> None:
    rng = np.random.default_rng(7)
    covariances = np.array([[_random_covariance(rng, [3.0, 3.0, 100.0]) for _ in range(3)] for _ in range(5)])
    effects, common = rng.normal(size=(5, 3, 3, 2)), np.diag([1.0, 2.0]) * ARCSEC**2
    together = combine_attitudes(covariances, effects, common)
    for number in range(5):
        one = combine_attitudes(covariances[number], effects[number], common)
        np.testing.assert_allclose(together.covariance[number], one.covariance, rtol=1e-9)
        np.testing.assert_allclose(together.gains[number], one.gains, atol=1e-9)


def _random_covariance(rng: np.random.Generator, sigmas_arcsec: list[float]) -> FloatArray:
    """Return a full covariance with the given sigmas along randomly rotated axes."""
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return (axes * (ARCSEC * np.array(sigmas_arcsec)) ** 2) @ axes.T
