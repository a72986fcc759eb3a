"""Telescope attitude from beacons: exact cases, scipy's rotations, consistent covariance, error budget."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.mount.image import Camera
from ship_geometry.mount.line_of_sight import LeverArm
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation, log_rotation
from ship_testing.consistency import sigma_ratio_band
from ship_testing.simulated_sightings import (
    BEACONS_DEG,
    CAMERA,
    DISTANCE_M,
    FOUR_BEACONS_DEG,
    SURVEY,
    Epochs,
    error_free_epochs,
    paper_epochs,
    truth_of,
)
from theodolite_calib.filter.telescope_attitude import AttitudePrior, TelescopeAttitude, solve_attitude

RTK_ONLY = replace(SURVEY, rtk_bias_sigma_m=np.full(3, 0.027))


def solve_epochs(epochs: Epochs, prior: AttitudePrior | None = None) -> TelescopeAttitude:
    return solve_attitude(epochs.image, epochs.camera, epochs.lines(), prior)


def error_n(epochs: Epochs, attitude: TelescopeAttitude) -> FloatArray:
    return log_rotation(epochs.truth.rotation_nt @ np.swapaxes(attitude.rotation_nt, -1, -2))


def test_all_azimuths_elevations_and_image_rotations_are_recovered():
    grid = np.meshgrid(
        np.arange(0.0, 360.0, 15.0), [-5.0, 0.0, 20.0, 45.0, 70.0, 89.0, 89.99, 90.0], np.arange(-180.0, 181.0, 20.0)
    )
    epochs = error_free_epochs(truth_of(*grid), RTK_ONLY)
    attitude = solve_epochs(epochs)
    assert attitude.solved.all()
    # The refraction of the simulation is the same to 1e-9 rad.
    assert np.abs(error_n(epochs, attitude)).max() < 1e-8
    assert np.abs(attitude.focal_length_m - 0.1).max() < 1e-9


def test_rotation_of_exact_directions_is_scipys():
    epochs = error_free_epochs(truth_of(250.0, 35.0, -130.0, FOUR_BEACONS_DEG), RTK_ONLY)
    lines = epochs.lines()
    expected, _ = Rotation.align_vectors(lines.direction_n, epochs.camera.directions(epochs.image.point_m))
    assert solve_epochs(epochs).rotation_nt == pytest.approx(expected.as_matrix(), abs=1e-9)


def test_rotation_by_weights_is_scipys():
    # Only baselines have errors, each with another sigma, isotropic across the line of sight as in Wahba's problem.
    sigma_m = np.array([0.02, 0.05, 0.1, 0.3])
    epochs = error_free_epochs(truth_of(250.0, 35.0, -130.0, FOUR_BEACONS_DEG), SURVEY, Camera(0.1, 0.0, np.zeros(2)))
    noise = sigma_m[:, None] * np.random.default_rng(1).standard_normal((4, 3))
    lights = replace(
        epochs.beacons,
        baseline_n=epochs.beacons.baseline_n + noise,
        baseline_covariance_n=sigma_m[:, None, None] ** 2 * np.eye(3),
    )
    epochs = replace(epochs, beacons=lights, image=replace(epochs.image, sigma_m=np.full(4, 1e-10)))
    expected, _, sensitivity = Rotation.align_vectors(
        epochs.lines().direction_n,
        epochs.camera.directions(epochs.image.point_m),
        weights=sigma_m**-2.0,
        return_sensitivity=True,
    )
    attitude = solve_epochs(epochs)
    assert np.abs(log_rotation(attitude.rotation_nt @ expected.as_matrix().T)).max() / ARCSEC < 1e-3
    # scipy's sensitivity is the covariance divided by the harmonic mean of the variances.
    harmonic = 1.0 / np.mean((sigma_m / DISTANCE_M) ** -2.0)
    assert attitude.covariance_n / ARCSEC**2 == pytest.approx(sensitivity * harmonic / ARCSEC**2, rel=2e-3, abs=1e-3)


@pytest.mark.parametrize("source", ["rtk", "image", "focal_length", "refraction"])
def test_a_part_of_the_budget_is_what_its_source_does(source):
    """Only one error is drawn, all are modelled."""
    count = 5_000
    truth = truth_of(np.full(count, 33.0), 20.0, -60.0)
    exact, drawn = error_free_epochs(truth, seed=9), paper_epochs(truth, seed=9)
    lines = drawn.lines()
    match source:
        case "rtk":
            epochs = replace(drawn, image=exact.image)
        case "image":
            noise = 0.65e-6 * np.random.default_rng(3).standard_normal(exact.image.point_m.shape)
            epochs = replace(
                drawn,
                beacons=replace(drawn.beacons, baseline_n=exact.beacons.baseline_n),
                image=replace(exact.image, point_m=exact.image.point_m + noise),
            )
        case "focal_length":
            scale = (drawn.focal_length_m / 0.1)[:, None, None]
            point_m = (exact.image.point_m - CAMERA.principal_point_m) * scale + CAMERA.principal_point_m
            epochs = replace(
                drawn,
                beacons=replace(drawn.beacons, baseline_n=exact.beacons.baseline_n),
                image=replace(exact.image, point_m=point_m),
            )
        case "refraction":
            sigma = drawn.survey.refraction_beacon_sigma
            k = 0.13 + sigma * np.random.default_rng(4).standard_normal(sigma.shape)
            epochs = replace(
                drawn,
                beacons=replace(drawn.beacons, baseline_n=exact.beacons.baseline_n),
                image=exact.image,
                survey=replace(drawn.survey, refraction_coefficient=k),
            )
    assert lines.direction_n.shape == (count, 2, 3)
    attitude = solve_epochs(epochs)
    part = attitude.covariance_by_source_n[source].mean(axis=0)
    error = error_n(epochs, attitude)
    values, axes = np.linalg.eigh(part)
    # Some sources move the telescope in fewer than three ways.
    significant = values > 1e-3 * values[-1]
    ratio = np.sqrt(np.mean((error @ axes[:, significant]) ** 2, axis=0) / values[significant])
    low, high = sigma_ratio_band(count)
    assert np.all((ratio > low) & (ratio < high))


@pytest.mark.parametrize("count", [3, 4])
def test_more_beacons_match_their_covariance(count):
    epochs = paper_epochs(truth_of(np.full(4_000, 33.0), 50.0, 100.0, FOUR_BEACONS_DEG[:count]), seed=11)
    attitude = solve_epochs(epochs)
    low, high = mean_nees_band(4_000, 3)
    assert low < normalized_error_squared(error_n(epochs, attitude), attitude.covariance_n).mean() < high
    low, high = mean_nees_band(4_000, attitude.degrees)
    assert attitude.degrees == 2 * count - 3
    assert low < attitude.chi2.mean() < high


def one_light(count: int, sigma: FloatArray) -> tuple[Epochs, AttitudePrior]:
    epochs = paper_epochs(truth_of(np.full(count, 300.0), 40.0, 20.0, BEACONS_DEG[:1]), seed=13)
    off = sigma * np.random.default_rng(14).standard_normal((count, 3))
    return epochs, AttitudePrior(exp_rotation(off) @ epochs.truth.rotation_nt, {"prior": np.diag(sigma**2)})


def test_one_beacon_with_a_prior_matches_its_covariance():
    count, sigma = 4_000, np.array([30.0, 90.0, 50.0]) * ARCSEC
    epochs, prior = one_light(count, sigma)
    attitude = solve_epochs(epochs, prior)
    low, high = mean_nees_band(count, 3)
    assert low < normalized_error_squared(error_n(epochs, attitude), attitude.covariance_n).mean() < high
    low, high = mean_nees_band(count, 2)
    assert attitude.degrees == 2
    assert low < attitude.chi2.mean() < high
    # Across the line to the light: 0.1 % of the focal length at 3.6° from the axis gives 13", the rest is below 5".
    light_n = epochs.lines().direction_n[:, 0]
    across = np.sqrt(np.einsum("nii->n", attitude.covariance_n) - variance_about(light_n, attitude.covariance_n))
    assert across.max() / ARCSEC == pytest.approx(13.4, abs=0.5)


def variance_about(direction_n: FloatArray, covariance_n: FloatArray) -> FloatArray:
    """Return the variance of the rotation about a direction."""
    return np.einsum("ni,nij,nj->n", direction_n, covariance_n, direction_n)


def test_one_beacon_keeps_the_prior_rotation_about_it():
    sigma = np.full(3, 60.0 * ARCSEC)
    epochs, prior = one_light(50, sigma)
    attitude = solve_epochs(epochs, prior)
    # About the line to the light, the attitude keeps the rotation and the sigma of the prior. The errors of the light
    # change them by 0.1 % of 60".
    light_n = epochs.lines().direction_n[:, 0]
    turned = np.einsum("ni,ni->n", light_n, log_rotation(attitude.rotation_nt @ np.swapaxes(prior.rotation_nt, -1, -2)))
    assert np.abs(turned).max() / ARCSEC < 0.06
    assert np.sqrt(variance_about(light_n, attitude.covariance_n)) / ARCSEC == pytest.approx(
        np.full(50, 60.0), rel=1e-3
    )


def test_one_beacon_without_a_prior_is_refused():
    with pytest.raises(ValueError, match="prior attitude is needed"):
        solve_epochs(error_free_epochs(truth_of(0.0, 10.0, 0.0, BEACONS_DEG[:1])))


def test_close_beacons_need_a_prior():
    truth = truth_of(np.array([120.0, 120.0]), 25.0, 0.0, np.array([[3.0, 2.0], [3.0005, 2.0]]))
    # In the second epoch the beacons are apart.
    direction_n = truth.direction_n.copy()
    direction_n[1] = truth_of(120.0, 25.0, 0.0).direction_n
    epochs = error_free_epochs(replace(truth, direction_n=direction_n), RTK_ONLY)
    alone = solve_epochs(epochs)
    assert alone.solved.tolist() == [False, True]
    assert np.isnan(alone.rotation_nt[0]).all()
    assert np.isnan(alone.covariance_n[0]).all()
    assert np.isnan([alone.chi2[0], alone.focal_length_m[0]]).all()
    assert np.abs(error_n(epochs, alone)[1]).max() < 1e-8
    prior = AttitudePrior(truth.rotation_nt, {"prior": (60.0 * ARCSEC) ** 2 * np.eye(3)})
    assert solve_epochs(epochs, prior).solved.all()


def test_beacon_behind_the_telescope_is_not_solved():
    # According to the prior, the telescope looks away from the only light, which has no image.
    epochs = error_free_epochs(truth_of(0.0, 10.0, 0.0, BEACONS_DEG[:1]), RTK_ONLY)
    away = truth_of(180.0, 10.0, 0.0).rotation_nt
    attitude = solve_epochs(epochs, AttitudePrior(away, {"prior": 1e-6 * np.eye(3)}))
    assert not attitude.solved
    assert np.isnan(attitude.rotation_nt).all()


def test_principal_point_off_its_place_is_seen_by_nothing():
    """An error of N' of 60 mm shifts both beacons by 6-7" (models.md §5), which only the budget contains, no
    residual."""
    truth = truth_of(np.full(500, 210.0), 15.0, 30.0)
    epochs = paper_epochs(truth, seed=17)
    lens = epochs.survey.principal_point.vector_m
    wrong = replace(
        epochs, survey=replace(epochs.survey, principal_point=LeverArm(lens + 0.06 * np.eye(3)[1], np.zeros(3)))
    )
    right, off = solve_epochs(epochs), solve_epochs(wrong)
    shift = angle_between(right.rotation_nt[..., 0], off.rotation_nt[..., 0]) / ARCSEC
    assert np.all((shift > 6.0) & (shift < 7.0))
    # One degree of freedom is left, and it changes by a hundredth of a sigma.
    assert np.abs(np.sqrt(off.chi2) - np.sqrt(right.chi2)).max() < 0.01
    assert np.abs(off.focal_length_m - right.focal_length_m).max() < 0.01 * right.focal_length_sigma_m.min()
    stated = replace(wrong, survey=replace(epochs.survey, principal_point=LeverArm(lens, np.array([0.0, 0.06, 0.0]))))
    budget = np.sqrt(np.trace(solve_epochs(stated).covariance_by_source_n["lever_arms"], axis1=-1, axis2=-2)) / ARCSEC
    assert np.all((budget > 6.0) & (budget < 7.0))


def test_epochs_at_once_are_epochs_one_by_one():
    epochs = paper_epochs(truth_of(np.array([10.0, 100.0, 200.0]), 20.0, 5.0), seed=3)
    together = solve_epochs(epochs)
    for i in range(3):
        lights = replace(
            epochs.beacons,
            baseline_n=epochs.beacons.baseline_n[i],
            rotation_nb=epochs.beacons.rotation_nb[i],
            baseline_covariance_n=epochs.beacons.baseline_covariance_n[i],
        )
        ship = replace(epochs.ship, rotation_nd=epochs.ship.rotation_nd[i], rotation_dm=epochs.ship.rotation_dm[i])
        survey = replace(epochs.survey, refraction_beacon_sigma=epochs.survey.refraction_beacon_sigma[i])
        image = replace(epochs.image, point_m=epochs.image.point_m[i], sigma_m=epochs.image.sigma_m[i])
        alone = solve_epochs(replace(epochs, beacons=lights, ship=ship, survey=survey, image=image))
        assert alone.rotation_nt == pytest.approx(together.rotation_nt[i], abs=1e-12)
        assert alone.covariance_n == pytest.approx(together.covariance_n[i], rel=1e-6, abs=1e-16)
        assert alone.chi2 == pytest.approx(together.chi2[i], abs=1e-6)
