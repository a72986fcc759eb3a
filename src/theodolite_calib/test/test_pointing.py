"""The telescope's attitude from lights: exact cases, scipy's solutions, honest covariance, error budget."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from simulated_sightings import (
    CAMERA,
    DISTANCE_M,
    LIGHTS_DEG,
    SURVEY,
    Epochs,
    error_free,
    paper_epochs,
    project,
    raised,
    truth_of,
)

from ship_estimation.consistency import mean_nees_band, normalized_error_squared, sigma_ratio_band
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation, left_jacobian, log_rotation
from theodolite_calib.equations import AttitudePrior
from theodolite_calib.image import Camera
from theodolite_calib.line_of_sight import LeverArm
from theodolite_calib.pointing import Pointing, solve

FOUR_LIGHTS_DEG = np.array([[3.0, 2.0], [-2.0, -3.0], [-3.0, 1.5], [0.5, -1.0]])
RTK_ONLY = replace(SURVEY, rtk_bias_sigma_m=np.full(3, 0.027))


def solved(epochs: Epochs, prior: AttitudePrior | None = None) -> Pointing:
    return solve(epochs.image, epochs.camera, epochs.lines(), prior)


def error_n(epochs: Epochs, pointing: Pointing) -> FloatArray:
    return log_rotation(epochs.truth.rotation_nt @ np.swapaxes(pointing.rotation_nt, -1, -2))


def test_all_azimuths_elevations_and_image_rotations_are_recovered():
    grid = np.meshgrid(
        np.arange(0.0, 360.0, 15.0), [-5.0, 0.0, 20.0, 45.0, 70.0, 89.0, 89.99, 90.0], np.arange(-180.0, 181.0, 20.0)
    )
    epochs = error_free(truth_of(*grid), RTK_ONLY)
    pointing = solved(epochs)
    assert pointing.solved.all()
    # The refraction of the simulation is the same to 1e-9 rad.
    assert np.abs(error_n(epochs, pointing)).max() < 1e-8
    assert np.abs(pointing.focal_length_m - 0.1).max() < 1e-9


def test_rotation_of_exact_directions_is_scipys():
    epochs = error_free(truth_of(250.0, 35.0, -130.0, FOUR_LIGHTS_DEG), RTK_ONLY)
    lines = epochs.lines()
    expected, _ = Rotation.align_vectors(lines.direction_n, epochs.camera.directions(epochs.image.point_m))
    assert solved(epochs).rotation_nt == pytest.approx(expected.as_matrix(), abs=1e-9)


def test_rotation_by_weights_is_scipys():
    # Only baselines err, by amounts of their own: isotropic across the line of sight, as Wahba's problem has it.
    sigma_m = np.array([0.02, 0.05, 0.1, 0.3])
    epochs = error_free(truth_of(250.0, 35.0, -130.0, FOUR_LIGHTS_DEG), SURVEY, Camera(0.1, 0.0, np.zeros(2)))
    noise = sigma_m[:, None] * np.random.default_rng(1).standard_normal((4, 3))
    lights = replace(
        epochs.lights,
        baseline_n=epochs.lights.baseline_n + noise,
        baseline_covariance_n=sigma_m[:, None, None] ** 2 * np.eye(3),
    )
    epochs = replace(epochs, lights=lights, image=replace(epochs.image, sigma_m=np.full(4, 1e-10)))
    expected, _, sensitivity = Rotation.align_vectors(
        epochs.lines().direction_n,
        epochs.camera.directions(epochs.image.point_m),
        weights=sigma_m**-2.0,
        return_sensitivity=True,
    )
    pointing = solved(epochs)
    assert np.abs(log_rotation(pointing.rotation_nt @ expected.as_matrix().T)).max() / ARCSEC < 1e-3
    # scipy's sensitivity is the covariance divided by the harmonic mean of the variances, over their number.
    harmonic = 1.0 / np.mean((sigma_m / DISTANCE_M) ** -2.0)
    assert pointing.covariance_n / ARCSEC**2 == pytest.approx(sensitivity * harmonic / ARCSEC**2, rel=2e-3, abs=1e-3)


class FullProblem:
    """One epoch with every error an unknown of its own, standardised, written out anew for scipy's least squares."""

    survey = replace(
        SURVEY,
        theodolite_lever=LeverArm(np.array([12.0, 3.0, -2.0]), np.array([0.02, 0.03, 0.01])),
        principal_point=LeverArm(np.array([0.4, 0.3, 0.0]), np.array([0.01, 0.02, 0.03])),
        light_lever=LeverArm(np.array([0.1, -0.3, 0.05]), np.array([0.01, 0.03, 0.02])),
        rtk_base_sigma_m=np.array([0.03, 0.05, 0.02]),
        rtk_bias_sigma_m=np.array([0.02, 0.01, 0.03]),
        refraction_sigma=0.06,
        refraction_light_sigma=0.04,
    )
    drone_sigma, ship_sigma, rtk_m, detection_m, focal_sigma_m = 0.03, 3e-3, 0.02, 2e-6, 1e-4

    def __init__(self, lights_deg: FloatArray, prior: AttitudePrior | None = None) -> None:
        count = self.count = len(lights_deg)
        self.prior = prior
        epoch = error_free(truth_of(140.0, 30.0, 70.0, lights_deg), self.survey, seed=6)
        self.camera = replace(CAMERA, focal_length_sigma_m=self.focal_sigma_m)
        lights = replace(
            epoch.lights,
            baseline_covariance_n=self.rtk_m**2 * np.eye(3),
            attitude_covariance_n=self.drone_sigma**2 * np.eye(3),
        )
        ship = replace(epoch.ship, attitude_covariance_n=self.ship_sigma**2 * np.eye(3))
        # Attitude 3, focal length 1, common 13, each light's own 13; all but the attitude of unit variance.
        self.size = 17 + 13 * count
        self.epoch = replace(epoch, camera=self.camera, lights=lights, ship=ship)
        drawn = np.random.default_rng(21).standard_normal(self.size)
        drawn[:3] = 0.0
        noise = self.detection_m * np.random.default_rng(22).standard_normal((count, 2))
        image = replace(epoch.image, point_m=self.points(drawn) + noise, sigma_m=np.full(count, self.detection_m))
        self.epoch = replace(self.epoch, image=image)

    def points(self, x: FloatArray) -> FloatArray:
        survey, lights, ship = self.survey, self.epoch.lights, self.epoch.ship
        base, lever, lens, turn = x[4:16].reshape(4, 3)
        own = x[17:].reshape(self.count, 13)
        rotation_nd = Rotation.from_rotvec(self.ship_sigma * turn).as_matrix() @ ship.rotation_nd
        to_lens_n = rotation_nd @ (
            survey.theodolite_lever.vector_m
            + survey.theodolite_lever.sigma_m * lever
            + ship.rotation_dm @ (survey.principal_point.vector_m + survey.principal_point.sigma_m * lens)
        )
        rotation_nb = Rotation.from_rotvec(self.drone_sigma * own[:, :3]).as_matrix() @ lights.rotation_nb
        light_lever = survey.light_lever.vector_m + survey.light_lever.sigma_m * own[:, 3:6]
        path_n = (
            lights.baseline_n
            + self.rtk_m * own[:, 6:9]
            + survey.rtk_bias_sigma_m * own[:, 9:12]
            + survey.rtk_base_sigma_m * base
            + np.einsum("kij,kj->ki", rotation_nb, light_lever)
            - to_lens_n
        )
        distance = np.linalg.norm(path_n, axis=-1)
        k = 0.13 + survey.refraction_sigma * x[16] + survey.refraction_light_sigma * own[:, 12]
        angle = k * np.hypot(path_n[:, 0], path_n[:, 2]) / (2.0 * 6_371_000.0)
        direction_n = raised(path_n / distance[:, None], angle)
        rotation_nt = Rotation.from_rotvec(x[:3]).as_matrix() @ self.epoch.truth.rotation_nt
        focal_length_m = np.array(0.1 + self.focal_sigma_m * x[3])
        return project(self.camera, focal_length_m, direction_n @ rotation_nt)

    def residuals(self, x: FloatArray) -> FloatArray:
        of_points = (self.epoch.image.point_m - self.points(x)).ravel() / self.detection_m
        if self.prior is None:
            return np.concatenate([of_points, x[3:]])
        turn = Rotation.from_rotvec(x[:3]) * Rotation.from_matrix(
            self.epoch.truth.rotation_nt @ self.prior.rotation_nt.T
        )
        whiten = np.linalg.inv(np.linalg.cholesky(self.prior.covariance_n))
        return np.concatenate([of_points, x[3:], whiten @ turn.as_rotvec()])

    def solution(self):
        return least_squares(
            self.residuals, np.zeros(self.size), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, jac="3-point"
        )


def a_prior(rotation_nt: FloatArray, sigma_deg: float) -> AttitudePrior:
    """Anisotropic, correlated, off by as much as it says, of two sources."""
    root = np.deg2rad(sigma_deg) * np.array([[1.0, 0.0, 0.0], [0.5, 0.8, 0.0], [-0.3, 0.2, 0.6]])
    off = root @ np.array([0.8, -1.1, 0.5])
    whole = root @ root.T
    return AttitudePrior(exp_rotation(off) @ rotation_nt, {"encoder": 0.3 * whole, "ship_attitude": 0.7 * whole})


CASES = {
    "two lights": (LIGHTS_DEG, None),
    "four lights": (FOUR_LIGHTS_DEG, None),
    "one light, prior of 40 arcseconds": (LIGHTS_DEG[:1], 40.0 / 3600.0),
    "one light, prior of ten degrees": (LIGHTS_DEG[:1], 10.0),
    "two lights with a prior": (LIGHTS_DEG, 10.0 / 3600.0),
}


@pytest.mark.parametrize("name", CASES)
def test_optimum_covariance_and_misfit_are_those_of_the_full_problem(name):
    lights_deg, sigma_deg = CASES[name]
    rotation_nt = truth_of(140.0, 30.0, 70.0).rotation_nt
    prior = None if sigma_deg is None else a_prior(rotation_nt, sigma_deg)
    problem = FullProblem(lights_deg, prior)
    full, pointing = problem.solution(), solved(problem.epoch, prior)

    expected = exp_rotation(full.x[:3]) @ problem.epoch.truth.rotation_nt
    sigma = np.sqrt(np.diag(pointing.covariance_n))
    assert np.all(np.abs(log_rotation(pointing.rotation_nt @ expected.T)) < 2e-3 * sigma)
    # The full problem's vector starts at the truth, from which the prior is off.
    inverse = np.linalg.inv(full.jac.T @ full.jac)
    to_vector_n = left_jacobian(full.x[:3])
    assert pointing.covariance_n / np.outer(sigma, sigma) == pytest.approx(
        to_vector_n @ inverse[:3, :3] @ to_vector_n.T / np.outer(sigma, sigma), abs=5e-3
    )
    assert pointing.focal_length_m == pytest.approx(0.1 + 1e-4 * full.x[3], abs=2e-3 * pointing.focal_length_sigma_m)
    assert pointing.focal_length_sigma_m == pytest.approx(1e-4 * np.sqrt(inverse[3, 3]), rel=5e-3)
    assert pointing.chi2 == pytest.approx(2.0 * full.cost, rel=5e-3)
    assert pointing.degrees == 2 * len(lights_deg) - 3 + (0 if prior is None else 3)


@pytest.mark.parametrize("name", CASES)
def test_the_budget_adds_up_to_the_covariance(name):
    lights_deg, sigma_deg = CASES[name]
    prior = None if sigma_deg is None else a_prior(truth_of(140.0, 30.0, 70.0).rotation_nt, sigma_deg)
    pointing = solved(FullProblem(lights_deg, prior).epoch, prior)
    sources = {"rtk", "lever_arms", "ship_attitude", "drone_attitude", "refraction", "image", "focal_length"}
    assert set(pointing.parts_n) == (sources if prior is None else sources | {"encoder"})
    parts = np.array(list(pointing.parts_n.values()))
    assert parts.sum(axis=0) == pytest.approx(pointing.covariance_n, rel=1e-9, abs=1e-24)
    assert np.linalg.eigvalsh(parts).min() > -1e-9 * np.trace(pointing.covariance_n)
    assert np.all(np.trace(parts, axis1=1, axis2=2) > 0.0)


@pytest.mark.parametrize("source", ["rtk", "image", "focal_length", "refraction"])
def test_a_part_of_the_budget_is_what_its_source_does(source):
    """Only one error is drawn, all are believed in."""
    count = 5_000
    truth = truth_of(np.full(count, 33.0), 20.0, -60.0)
    exact, drawn = error_free(truth, seed=9), paper_epochs(truth, seed=9)
    lines = drawn.lines()
    match source:
        case "rtk":
            epochs = replace(drawn, image=exact.image)
        case "image":
            noise = 0.65e-6 * np.random.default_rng(3).standard_normal(exact.image.point_m.shape)
            epochs = replace(
                drawn,
                lights=replace(drawn.lights, baseline_n=exact.lights.baseline_n),
                image=replace(exact.image, point_m=exact.image.point_m + noise),
            )
        case "focal_length":
            scale = (drawn.focal_length_m / 0.1)[:, None, None]
            point_m = (exact.image.point_m - CAMERA.principal_point_m) * scale + CAMERA.principal_point_m
            epochs = replace(
                drawn,
                lights=replace(drawn.lights, baseline_n=exact.lights.baseline_n),
                image=replace(exact.image, point_m=point_m),
            )
        case "refraction":
            sigma = drawn.survey.refraction_light_sigma
            k = 0.13 + sigma * np.random.default_rng(4).standard_normal(sigma.shape)
            epochs = replace(
                drawn,
                lights=replace(drawn.lights, baseline_n=exact.lights.baseline_n),
                image=exact.image,
                survey=replace(drawn.survey, refraction_coefficient=k),
            )
    assert lines.direction_n.shape == (count, 2, 3)
    pointing = solved(epochs)
    part = pointing.parts_n[source].mean(axis=0)
    error = error_n(epochs, pointing)
    values, axes = np.linalg.eigh(part)
    # Some sources move the telescope in fewer than three ways.
    told = values > 1e-3 * values[-1]
    ratio = np.sqrt(np.mean((error @ axes[:, told]) ** 2, axis=0) / values[told])
    low, high = sigma_ratio_band(count)
    assert np.all((ratio > low) & (ratio < high))


@pytest.mark.parametrize("count", [3, 4])
def test_more_lights_are_as_good_as_they_say(count):
    epochs = paper_epochs(truth_of(np.full(4_000, 33.0), 50.0, 100.0, FOUR_LIGHTS_DEG[:count]), seed=11)
    pointing = solved(epochs)
    low, high = mean_nees_band(4_000, 3)
    assert low < normalized_error_squared(error_n(epochs, pointing), pointing.covariance_n).mean() < high
    low, high = mean_nees_band(4_000, pointing.degrees)
    assert pointing.degrees == 2 * count - 3
    assert low < pointing.chi2.mean() < high


def one_light(count: int, sigma: FloatArray) -> tuple[Epochs, AttitudePrior]:
    epochs = paper_epochs(truth_of(np.full(count, 300.0), 40.0, 20.0, LIGHTS_DEG[:1]), seed=13)
    off = sigma * np.random.default_rng(14).standard_normal((count, 3))
    return epochs, AttitudePrior(exp_rotation(off) @ epochs.truth.rotation_nt, {"prior": np.diag(sigma**2)})


def test_one_light_with_a_prior_is_as_good_as_it_says():
    count, sigma = 4_000, np.array([30.0, 90.0, 50.0]) * ARCSEC
    epochs, prior = one_light(count, sigma)
    pointing = solved(epochs, prior)
    low, high = mean_nees_band(count, 3)
    assert low < normalized_error_squared(error_n(epochs, pointing), pointing.covariance_n).mean() < high
    low, high = mean_nees_band(count, 2)
    assert pointing.degrees == 2
    assert low < pointing.chi2.mean() < high
    # Across the light: 13" are 0.1 % of focal length at 3.6° from the axis, the rest is below 5"; the prior has 60".
    light_n = epochs.lines().direction_n[:, 0]
    across = np.sqrt(np.einsum("nii->n", pointing.covariance_n) - about(light_n, pointing.covariance_n))
    assert across.max() / ARCSEC == pytest.approx(13.4, abs=0.5)


def about(direction_n: FloatArray, covariance_n: FloatArray) -> FloatArray:
    """Variance of the rotation about a direction."""
    return np.einsum("ni,nij,nj->n", direction_n, covariance_n, direction_n)


def test_one_light_leaves_the_rotation_about_it_as_the_prior_has_it():
    sigma = np.full(3, 60.0 * ARCSEC)
    epochs, prior = one_light(50, sigma)
    pointing = solved(epochs, prior)
    # About the light as the telescope sees it, the attitude does not turn, and is no better known: 0.1 % of 60" is
    # what the light's own errors do.
    light_n = epochs.lines().direction_n[:, 0]
    turned = np.einsum("ni,ni->n", light_n, log_rotation(pointing.rotation_nt @ np.swapaxes(prior.rotation_nt, -1, -2)))
    assert np.abs(turned).max() / ARCSEC < 0.06
    assert np.sqrt(about(light_n, pointing.covariance_n)) / ARCSEC == pytest.approx(np.full(50, 60.0), rel=1e-3)


def test_one_light_without_a_prior_is_refused():
    with pytest.raises(ValueError, match="prior attitude is needed"):
        solved(error_free(truth_of(0.0, 10.0, 0.0, LIGHTS_DEG[:1])))


def test_lights_too_near_to_each_other_need_a_prior():
    truth = truth_of(np.array([120.0, 120.0]), 25.0, 0.0, np.array([[3.0, 2.0], [3.0005, 2.0]]))
    # The second epoch has them apart.
    direction_n = truth.direction_n.copy()
    direction_n[1] = truth_of(120.0, 25.0, 0.0).direction_n
    epochs = error_free(replace(truth, direction_n=direction_n), RTK_ONLY)
    alone = solved(epochs)
    assert alone.solved.tolist() == [False, True]
    assert np.isnan(alone.rotation_nt[0]).all()
    assert np.isnan(alone.covariance_n[0]).all()
    assert np.isnan([alone.chi2[0], alone.focal_length_m[0]]).all()
    assert np.abs(error_n(epochs, alone)[1]).max() < 1e-8
    prior = AttitudePrior(truth.rotation_nt, {"prior": (60.0 * ARCSEC) ** 2 * np.eye(3)})
    assert solved(epochs, prior).solved.all()


def test_a_light_behind_the_telescope_is_not_solved():
    # By its prior the telescope looks away from the only light: there is no image of it.
    epochs = error_free(truth_of(0.0, 10.0, 0.0, LIGHTS_DEG[:1]), RTK_ONLY)
    away = truth_of(180.0, 10.0, 0.0).rotation_nt
    pointing = solved(epochs, AttitudePrior(away, {"prior": 1e-6 * np.eye(3)}))
    assert not pointing.solved
    assert np.isnan(pointing.rotation_nt).all()


def test_principal_point_off_its_place_is_seen_by_nothing():
    """models.md §5: N' 60 mm off shifts both lights alike, 6-7" that no residual shows; only the budget can say so."""
    truth = truth_of(np.full(500, 210.0), 15.0, 30.0)
    epochs = paper_epochs(truth, seed=17)
    lens = epochs.survey.principal_point.vector_m
    wrong = replace(
        epochs, survey=replace(epochs.survey, principal_point=LeverArm(lens + 0.06 * np.eye(3)[1], np.zeros(3)))
    )
    right, off = solved(epochs), solved(wrong)
    shift = angle_between(right.rotation_nt[..., 0], off.rotation_nt[..., 0]) / ARCSEC
    assert np.all((shift > 6.0) & (shift < 7.0))
    # One degree of freedom is left, and it changes by a hundredth of a sigma.
    assert np.abs(np.sqrt(off.chi2) - np.sqrt(right.chi2)).max() < 0.01
    assert np.abs(off.focal_length_m - right.focal_length_m).max() < 0.01 * right.focal_length_sigma_m.min()
    said = replace(wrong, survey=replace(epochs.survey, principal_point=LeverArm(lens, np.array([0.0, 0.06, 0.0]))))
    budget = np.sqrt(np.trace(solved(said).parts_n["lever_arms"], axis1=-1, axis2=-2)) / ARCSEC
    assert np.all((budget > 6.0) & (budget < 7.0))


def test_epochs_at_once_are_epochs_one_by_one():
    epochs = paper_epochs(truth_of(np.array([10.0, 100.0, 200.0]), 20.0, 5.0), seed=3)
    together = solved(epochs)
    for i in range(3):
        lights = replace(
            epochs.lights,
            baseline_n=epochs.lights.baseline_n[i],
            rotation_nb=epochs.lights.rotation_nb[i],
            baseline_covariance_n=epochs.lights.baseline_covariance_n[i],
        )
        ship = replace(epochs.ship, rotation_nd=epochs.ship.rotation_nd[i], rotation_dm=epochs.ship.rotation_dm[i])
        survey = replace(epochs.survey, refraction_light_sigma=epochs.survey.refraction_light_sigma[i])
        image = replace(epochs.image, point_m=epochs.image.point_m[i], sigma_m=epochs.image.sigma_m[i])
        alone = solved(replace(epochs, lights=lights, ship=ship, survey=survey, image=image))
        assert alone.rotation_nt == pytest.approx(together.rotation_nt[i], abs=1e-12)
        assert alone.covariance_n == pytest.approx(together.covariance_n[i], rel=1e-6, abs=1e-16)
        assert alone.chi2 == pytest.approx(together.chi2[i], abs=1e-6)
