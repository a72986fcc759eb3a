"""Likelihood of one epoch against scipy, with every error as an unknown, and the budget of the solution."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ship_geometry.mount.line_of_sight import LeverArm, covariance_by_source
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation
from ship_testing.simulated_sightings import (
    BEACONS_DEG,
    CAMERA,
    FOUR_BEACONS_DEG,
    SURVEY,
    error_free_epochs,
    project,
    raise_elevation,
    truth_of,
)
from theodolite_calib.filter.telescope_attitude import (
    AttitudePrior,
    TelescopeAttitude,
    linearise,
    solve_attitude,
    total_covariance,
)


def solve_problem(problem: "FullProblem") -> TelescopeAttitude:
    epoch = problem.epoch
    return solve_attitude(epoch.image, epoch.camera, epoch.lines(), problem.prior)


class FullProblem:
    """One epoch with every error as an unknown, standardised, formulated independently for scipy's least squares."""

    survey = replace(
        SURVEY,
        theodolite_lever=LeverArm(np.array([12.0, 3.0, -2.0]), np.array([0.02, 0.03, 0.01])),
        principal_point=LeverArm(np.array([0.4, 0.3, 0.0]), np.array([0.01, 0.02, 0.03])),
        beacon_lever=LeverArm(np.array([0.1, -0.3, 0.05]), np.array([0.01, 0.03, 0.02])),
        rtk_base_sigma_m=np.array([0.03, 0.05, 0.02]),
        rtk_bias_sigma_m=np.array([0.02, 0.01, 0.03]),
        refraction_sigma=0.06,
        refraction_beacon_sigma=0.04,
    )
    drone_sigma, ship_sigma, rtk_m, detection_m, focal_sigma_m = 0.03, 3e-3, 0.02, 2e-6, 1e-4

    def __init__(self, lights_deg: FloatArray, prior: AttitudePrior | None = None) -> None:
        count = self.count = len(lights_deg)
        self.prior = prior
        epoch = error_free_epochs(truth_of(140.0, 30.0, 70.0, lights_deg), self.survey, seed=6)
        self.camera = replace(CAMERA, focal_length_sigma_m=self.focal_sigma_m)
        lights = replace(
            epoch.beacons,
            baseline_covariance_n=self.rtk_m**2 * np.eye(3),
            attitude_covariance_n=self.drone_sigma**2 * np.eye(3),
        )
        ship = replace(epoch.ship, attitude_covariance_n=self.ship_sigma**2 * np.eye(3))
        # Unknowns: attitude 3, focal length 1, common errors 13, errors of each light 13; unit variance except the
        # attitude.
        self.size = 17 + 13 * count
        self.epoch = replace(epoch, camera=self.camera, beacons=lights, ship=ship)
        drawn = np.random.default_rng(21).standard_normal(self.size)
        drawn[:3] = 0.0
        noise = self.detection_m * np.random.default_rng(22).standard_normal((count, 2))
        image = replace(epoch.image, point_m=self.points(drawn) + noise, sigma_m=np.full(count, self.detection_m))
        self.epoch = replace(self.epoch, image=image)

    def points(self, x: FloatArray) -> FloatArray:
        survey, lights, ship = self.survey, self.epoch.beacons, self.epoch.ship
        base, lever, lens, turn = x[4:16].reshape(4, 3)
        own = x[17:].reshape(self.count, 13)
        rotation_nd = Rotation.from_rotvec(self.ship_sigma * turn).as_matrix() @ ship.rotation_nd
        to_lens_n = rotation_nd @ (
            survey.theodolite_lever.vector_m
            + survey.theodolite_lever.sigma_m * lever
            + ship.rotation_dm @ (survey.principal_point.vector_m + survey.principal_point.sigma_m * lens)
        )
        rotation_nb = Rotation.from_rotvec(self.drone_sigma * own[:, :3]).as_matrix() @ lights.rotation_nb
        light_lever = survey.beacon_lever.vector_m + survey.beacon_lever.sigma_m * own[:, 3:6]
        path_n = (
            lights.baseline_n
            + self.rtk_m * own[:, 6:9]
            + survey.rtk_bias_sigma_m * own[:, 9:12]
            + survey.rtk_base_sigma_m * base
            + np.einsum("kij,kj->ki", rotation_nb, light_lever)
            - to_lens_n
        )
        distance = np.linalg.norm(path_n, axis=-1)
        k = 0.13 + survey.refraction_sigma * x[16] + survey.refraction_beacon_sigma * own[:, 12]
        angle = k * np.hypot(path_n[:, 0], path_n[:, 2]) / (2.0 * 6_371_000.0)
        direction_n = raise_elevation(path_n / distance[:, None], angle)
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


def make_prior(rotation_nt: FloatArray, sigma_deg: float) -> AttitudePrior:
    """Return an anisotropic, correlated prior from two sources, with an error of its stated size."""
    root = np.deg2rad(sigma_deg) * np.array([[1.0, 0.0, 0.0], [0.5, 0.8, 0.0], [-0.3, 0.2, 0.6]])
    off = root @ np.array([0.8, -1.1, 0.5])
    whole = root @ root.T
    return AttitudePrior(exp_rotation(off) @ rotation_nt, {"encoder": 0.3 * whole, "ship_attitude": 0.7 * whole})


CASES = {
    "two lights": (BEACONS_DEG, None),
    "four lights": (FOUR_BEACONS_DEG, None),
    "one light, prior of 40 arcseconds": (BEACONS_DEG[:1], 40.0 / 3600.0),
    "one light, prior of ten degrees": (BEACONS_DEG[:1], 10.0),
    "two lights with a prior": (BEACONS_DEG, 10.0 / 3600.0),
}


@pytest.mark.parametrize("name", CASES)
def test_optimum_covariance_and_misfit_are_those_of_the_full_problem(name):
    lights_deg, sigma_deg = CASES[name]
    rotation_nt = truth_of(140.0, 30.0, 70.0).rotation_nt
    prior = None if sigma_deg is None else make_prior(rotation_nt, sigma_deg)
    problem = FullProblem(lights_deg, prior)
    full, attitude = problem.solution(), solve_problem(problem)

    expected = exp_rotation(full.x[:3]) @ problem.epoch.truth.rotation_nt
    sigma = np.sqrt(np.diag(attitude.covariance_n))
    assert np.all(np.abs(log_rotation(attitude.rotation_nt @ expected.T)) < 2e-3 * sigma)
    # The full problem's rotation vector is relative to the truth: its covariance is transformed to the estimate.
    inverse = np.linalg.inv(full.jac.T @ full.jac)
    to_vector_n = left_jacobian(full.x[:3])
    assert attitude.covariance_n / np.outer(sigma, sigma) == pytest.approx(
        to_vector_n @ inverse[:3, :3] @ to_vector_n.T / np.outer(sigma, sigma), abs=5e-3
    )
    assert attitude.focal_length_m == pytest.approx(0.1 + 1e-4 * full.x[3], abs=2e-3 * attitude.focal_length_sigma_m)
    assert attitude.focal_length_sigma_m == pytest.approx(1e-4 * np.sqrt(inverse[3, 3]), rel=5e-3)
    assert attitude.chi2 == pytest.approx(2.0 * full.cost, rel=5e-3)
    assert attitude.degrees == 2 * len(lights_deg) - 3 + (0 if prior is None else 3)


@pytest.mark.parametrize("name", CASES)
def test_the_budget_adds_up_to_the_covariance(name):
    lights_deg, sigma_deg = CASES[name]
    prior = None if sigma_deg is None else make_prior(truth_of(140.0, 30.0, 70.0).rotation_nt, sigma_deg)
    problem = FullProblem(lights_deg, prior)
    attitude, epoch = solve_problem(problem), problem.epoch
    sources = {"rtk", "lever_arms", "ship_attitude", "drone_attitude", "refraction", "image", "focal_length"}
    assert set(attitude.covariance_by_source_n) == (sources if prior is None else sources | {"encoder"})
    parts = np.array(list(attitude.covariance_by_source_n.values()))
    # Expected is the inverse of the information matrix, without sources. The matrix is linearised one step later, up to
    # 1e-9 rad away.
    lines = epoch.lines()
    line_covariance = total_covariance(covariance_by_source(lines.terms))
    equations = linearise(epoch.image, epoch.camera, lines.direction_n, line_covariance, attitude.rotation_nt, prior)
    expected = np.linalg.inv(equations.weighted_jacobian @ equations.jacobian)
    assert parts.sum(axis=0) == pytest.approx(attitude.covariance_n, rel=1e-9)
    assert np.abs(attitude.covariance_n - expected).max() < 1e-8 * np.abs(expected).max()
    assert np.linalg.eigvalsh(parts).min() > -1e-9 * np.trace(attitude.covariance_n)
    assert np.all(np.trace(parts, axis1=1, axis2=2) > 0.0)
