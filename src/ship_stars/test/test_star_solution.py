"""The joint solution: consistent covariance, terms of models.md §2, false stars. Long runs: `make campaign`."""

import os
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import poisson

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC, angle_between, exp_rotation, log_rotation
from ship_kernels.compiled_innovations import square_root
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars, StarFitSolution, linearise_stars
from ship_stars.attitude_from_stars.selection import StarPrior, select_stars
from ship_stars.attitude_from_stars.solution import SOLUTION_TERMS, SolutionStatus, solve_stars
from ship_testing.star_scenes import SIGMA, Scene, attitude_error, draw_scene

WRONG = 30.7
"""NEES that one in a million consistent attitudes exceeds: chi², three degrees of freedom."""
SCENES = int(os.environ.get("STAR_SCENES", "150"))
EPOCHS = int(os.environ.get("STAR_EPOCHS", "400"))
"""`make campaign` runs 10 000 of each."""


def nees(scene: Scene, solution) -> float:
    return float(normalized_error_squared(attitude_error(scene, solution.rotation_nb), solution.covariance_n))


def test_a_star_with_nan_is_never_selected():
    stars = draw_scene(np.random.default_rng(8), (6, 6)).stars
    measured_b = stars.measured_b.copy()
    measured_b[2, 1] = np.nan
    assert np.isnan(StarFitSolution(np.eye(3), np.eye(3), np.zeros(3), np.nan, -1).probability)
    assert np.isnan(StarFitSolution(np.eye(3), np.eye(3), np.zeros(3), np.nan, 3).probability)
    prior = StarPrior(np.eye(3), np.eye(3) * ARCSEC**2)
    for given in (None, prior):
        try:
            members = select_stars(replace(stars, measured_b=measured_b), given).members
        except np.linalg.LinAlgError:
            continue
        assert not members[2]


@pytest.mark.statistics
@pytest.mark.parametrize("counts", [(8, 8), (2, 2), (1, 1)])
def test_the_error_matches_the_covariance(counts):
    values = []
    for seed in range(EPOCHS):
        scene = draw_scene(np.random.default_rng([11, seed]), counts)
        solution = solve_stars(scene.stars)
        if solution.status is not SolutionStatus.INVALID:
            values.append(nees(scene, solution))
    # One in a thousand correct sets is rejected as inconsistent; the number of rejected sets has a 99.9 % limit.
    assert len(values) >= EPOCHS - poisson.ppf(0.999, 1e-3 * EPOCHS) - 1
    low, high = mean_nees_band(len(values), 3)
    print(f"{counts}: mean NEES {np.mean(values):.3f} in [{low:.2f}, {high:.2f}], {EPOCHS - len(values)} refused")
    assert low < np.mean(values) < high


def mean_parts(counts: tuple[int, int]) -> np.ndarray:
    """Return the covariance by source of a level ship heading North, averaged over star positions in the fields."""
    rngs = (np.random.default_rng([20, seed]) for seed in range(300))
    scenes = [draw_scene(rng, counts, heading_deg=0.0, tilt_deg=0.0) for rng in rngs]
    return np.mean([solve_stars(scene.stars).covariance_by_source_n for scene in scenes], axis=0)


def sigma_arcsec(covariance_n: np.ndarray) -> np.ndarray:
    """Return the sigmas of heading, pitch, roll (about Up, East, North) of a level ship heading North, arcsec."""
    return np.sqrt(np.diagonal(covariance_n, axis1=-2, axis2=-1))[..., [1, 2, 0]] / ARCSEC


def test_the_terms_are_those_of_the_design():
    """Numbers: models.md §2, two sensors at 0 and 90 degrees, 45 degrees up, eight stars each of 3″."""
    parts_n = mean_parts((8, 8))
    terms = dict(zip(SOLUTION_TERMS, sigma_arcsec(parts_n), strict=False))
    expected = {
        "star_noise": (1.29, 0.97, 0.97),
        "installation": (1.30, 0.97, 0.97),
        "refraction": (0.01, 0.40, 0.40),
        "earth_rotation": (0.08, 0.0, 0.13),
        "ship_position": (0.10, 0.16, 0.16),
    }
    for term, values in expected.items():
        # 3 %, and half of the last digit given.
        np.testing.assert_allclose(terms[term], values, rtol=0.03, atol=0.005, err_msg=term)
    np.testing.assert_allclose(sigma_arcsec(parts_n.sum(axis=0)), (1.84, 1.44, 1.44), rtol=0.03)
    assert not terms["catalogue"].any()


def test_one_star_per_sensor_has_the_covariance_of_the_design():
    np.testing.assert_allclose(sigma_arcsec(mean_parts((1, 1)).sum(axis=0)), (4.08, 3.08, 3.07), rtol=0.03)


def test_catalogue_errors_are_separate_from_noise():
    stars = draw_scene(np.random.default_rng(21), (8, 8)).stars
    poor = replace(stars, position_sigma=stars.sigma)
    parts = dict(zip(SOLUTION_TERMS, solve_stars(poor).covariance_by_source_n, strict=False))
    np.testing.assert_allclose(parts["catalogue"], parts["star_noise"], rtol=1e-9)
    np.testing.assert_allclose(parts["star_noise"], solve_stars(stars).covariance_by_source_n[0], rtol=1e-3)


def test_scipy_finds_the_same_attitude():
    for seed in range(20):
        scene = draw_scene(np.random.default_rng([12, seed]), (5, 3))
        stars = scene.stars
        scipys, _ = Rotation.align_vectors(stars.reference_n, stars.measured_b, 1.0 / stars.sigma**2)
        ours = solve_stars(stars)
        assert np.linalg.norm(log_rotation(scipys.as_matrix() @ ours.rotation_nb.T)) < 1e-9


def test_the_linear_model_is_the_derivative():
    """The Jacobian equals finite differences of 1e-6 rad for exp(δ) R and for rotated mountings."""
    scene = draw_scene(np.random.default_rng(13), (3, 2))
    rotation, stars = scene.rotation_nd, scene.stars
    fit = linearise_stars(stars, rotation)
    step = 1e-6
    for axis in range(3):
        turn = exp_rotation(step * np.eye(3)[axis])
        moved = linearise_stars(stars, turn @ rotation)
        numeric = (fit.displacement - moved.displacement) / step
        np.testing.assert_allclose(numeric, fit.jacobian[:, :, axis], atol=3e-4 / SIGMA)
        mounting = exp_rotation(step * np.eye(3)[axis])
        rows = stars.sensor == 1
        turned = stars.measured_b.copy()
        turned[rows] = turned[rows] @ mounting.T
        moved = linearise_stars(replace(stars, measured_b=turned), rotation)
        column = fit.jacobian[:, :, 6:9] @ np.linalg.inv(stars.mounting_b[1])[:, axis]
        numeric = (fit.displacement - moved.displacement) / step
        np.testing.assert_allclose(numeric, column, atol=3e-4 / SIGMA)


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("kind", "least_solved", "most_wrong"),
    [("false_stars", 0.99, 0.0), ("swapped_pairs", 0.99, 0.0), ("neighbours", 0.95, 0.005)],
)
def test_false_identities_are_found(kind, least_solved, most_wrong):
    solved, solvable, errors = 0, 0, []
    for seed in range(SCENES):
        rng = np.random.default_rng([14, seed])
        counts, extra = tuple(rng.integers(1, 13, 2).tolist()), int(rng.integers(0, 6))
        scene = draw_scene(rng, counts, **{kind: extra})
        solution = solve_stars(scene.stars)
        right = solution.status is not SolutionStatus.INVALID and nees(scene, solution) < WRONG
        if solution.status is SolutionStatus.VALID and not right:
            errors.append(float(np.linalg.norm(attitude_error(scene, solution.rotation_nb))) / ARCSEC)
        if sum(counts) >= 3:
            solvable += 1
            solved += solution.status is SolutionStatus.VALID and right
        elif extra == 0:
            assert solution.status is SolutionStatus.UNVERIFIED
    print(f"{kind}: solved {solved} of {solvable}, wrong {len(errors)}, by (arcsec) {np.sort(errors).round(1)}")
    assert len(errors) <= most_wrong * SCENES
    assert solved >= least_solved * solvable


PRIOR_SIGMA = np.array([10.0, 72.0, 10.0]) * ARCSEC
"""Standard deviations of an INS about North, Up, East, as in models.md §2."""


def error_with_prior(scene: Scene, error_n: np.ndarray) -> float | None:
    """Return the NEES of prior and selected stars together, in one linear step; None if no star was selected."""
    prior = StarPrior(exp_rotation(-error_n) @ scene.rotation_nd, np.diag(PRIOR_SIGMA**2))
    members = select_stars(scene.stars, prior).members
    if not members.any():
        return None
    fit = linearise_stars(scene.stars, prior.rotation_nb).with_prior(prior.covariance_n)
    solution = fit.solve(members)
    # The unknowns of the solution are in units of their standard deviations.
    roots = square_root(prior.covariance_n)
    covariance_n = roots @ np.linalg.inv(solution.information_with_prior)[:3, :3] @ roots.T
    return float(normalized_error_squared(error_n - roots @ solution.unknowns[:3], covariance_n))


@pytest.mark.parametrize("kind", ["false_stars", "swapped_pairs"])
@pytest.mark.parametrize("single", [False, True])
def test_with_a_prior_even_one_star_is_enough_and_none_is_wrong(kind, single):
    values = []
    for seed in range(SCENES):
        rng = np.random.default_rng([22, seed])
        counts = (1, 0) if single else tuple(rng.integers(1, 13, 2).tolist())
        scene = draw_scene(rng, counts, **{kind: int(rng.integers(0, 6))})
        values.append(error_with_prior(scene, PRIOR_SIGMA * rng.standard_normal(3)))
    solved = [value for value in values if value is not None]
    seen = "one star" if single else "two sensors"
    print(f"{kind}, prior, {seen}: solved {len(solved)} of {SCENES}, worst NEES {max(solved):.1f}")
    assert max(solved) < WRONG
    assert len(solved) >= 0.99 * SCENES


def test_a_misidentified_star_is_named_with_its_angle():
    scene = draw_scene(np.random.default_rng(15), (4, 4), neighbours=1)
    solution = solve_stars(scene.stars)
    assert np.flatnonzero(~solution.members).tolist() == [8]
    rejection = solution.rejected[8]
    angle = angle_between(scene.stars.measured_b[8] @ solution.rotation_nb.T, scene.stars.reference_n[8]) / ARCSEC
    assert rejection.reason is Reason.MISIDENTIFIED
    assert f'{angle:.1f}" from its expected direction, sigma 3.0"' in rejection.text


def test_a_prior_verifies_two_stars_and_does_not_enter_the_attitude():
    scene = draw_scene(np.random.default_rng(16), (1, 1))
    prior = StarPrior(exp_rotation(0.5 * PRIOR_SIGMA) @ scene.rotation_nd, np.diag(PRIOR_SIGMA**2))
    alone, helped = solve_stars(scene.stars), solve_stars(scene.stars, prior)
    assert (alone.status, helped.status) == (SolutionStatus.UNVERIFIED, SolutionStatus.VALID)
    np.testing.assert_array_equal(alone.rotation_nb, helped.rotation_nb)


def test_a_prior_detects_swapped_identities_of_two_stars():
    scene = draw_scene(np.random.default_rng(17), (0, 0), swapped_pairs=1)
    prior = StarPrior(scene.rotation_nd, np.diag(PRIOR_SIGMA**2))
    assert solve_stars(scene.stars).status is SolutionStatus.UNVERIFIED
    rejected = solve_stars(scene.stars, prior)
    assert rejected.status is SolutionStatus.INVALID
    assert rejected.rejection.reason is Reason.TOO_FEW_STARS


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_stars_are_rejected(count):
    scene = draw_scene(np.random.default_rng(18), (count, 0))
    solution = solve_stars(scene.stars)
    assert solution.status is SolutionStatus.INVALID
    assert solution.rejection.reason is Reason.TOO_FEW_STARS
    assert np.isnan(solution.covariance_n).all()


def test_stars_in_one_direction_are_rejected_with_the_reason():
    """Two stars 10″ apart do not determine the rotation about them."""
    scene = draw_scene(np.random.default_rng(19), (1, 0))
    star = scene.stars
    turn = exp_rotation(10.0 * ARCSEC * np.cross(star.measured_b[0], [0.0, 0.0, 1.0]))
    small_turn = scene.rotation_nd @ turn @ scene.rotation_nd.T
    stars = MatchedStars(
        np.array([star.measured_b[0], turn @ star.measured_b[0]]),
        np.array([star.reference_n[0], small_turn @ star.reference_n[0]]),
        np.repeat(star.sigma, 2),
        np.zeros(2),
        np.repeat(star.shared_n, 2, axis=0),
        np.zeros(2, dtype=int),
        star.mounting_b,
    )
    solution = solve_stars(stars)
    assert solution.status is SolutionStatus.INVALID
    assert "the rotation about it is undetermined" in solution.rejection.text


def with_optics(scene: Scene, rng: np.random.Generator) -> tuple[MatchedStars, np.ndarray]:
    """Return the stars of a scene in cameras with drawn errors of their optics, and these errors in sigmas."""
    stars, count = scene.stars, len(scene.stars)
    field_b, sources = np.zeros((count, 3, 8)), ("optics",) * 8
    for sensor in range(2):
        rows = stars.sensor == sensor
        middle = stars.measured_b[rows].mean(axis=0)
        # A longer focal length and three other patterns, 3" at 6 degrees from the middle.
        patterns = rng.standard_normal((3, 3, 3)) * 30.0 * ARCSEC
        away = stars.measured_b[rows] - middle
        field_b[rows, :, 4 * sensor] = 30.0 * ARCSEC * away
        field_b[rows, :, 4 * sensor + 1 : 4 * sensor + 4] = np.einsum("mij,kj->kim", patterns, away)
    errors = rng.standard_normal(8)
    measured = stars.measured_b + field_b @ errors
    measured /= np.linalg.norm(measured, axis=-1, keepdims=True)
    return replace(stars, measured_b=measured, field_b=field_b, field_sources=sources), errors


def test_scipy_finds_the_same_attitude_with_errors_of_the_optics() -> None:
    """The least sum of squares over the attitude and the errors of the cameras, which have the prior sigma 1."""
    for seed in range(10):
        rng = np.random.default_rng([14, seed])
        scene = draw_scene(rng, (8, 6))
        stars, _ = with_optics(scene, rng)
        ours = solve_stars(stars)

        def residuals(unknown: np.ndarray, stars: MatchedStars = stars, start: np.ndarray = ours.rotation_nb):
            turned = (stars.measured_b - stars.field_b @ unknown[3:]) @ (exp_rotation(unknown[:3]) @ start).T
            return np.concatenate([((stars.reference_n - turned) / stars.white_sigma[:, None]).ravel(), unknown[3:]])

        found = least_squares(residuals, np.zeros(11), x_scale=[1e-5] * 3 + [1.0] * 8, xtol=1e-14, ftol=1e-14)
        assert np.linalg.norm(found.x[:3]) < 1e-3 * ARCSEC
        parts = dict(zip(SOLUTION_TERMS, ours.covariance_by_source_n, strict=False))
        covariance_n = np.linalg.inv(found.jac.T @ found.jac)[:3, :3]
        np.testing.assert_allclose(parts["star_noise"] + parts["optics"], covariance_n, rtol=1e-3, atol=1e-15)
        # A catalogue as poor as the centroids causes half of the noise.
        poor = dict(
            zip(
                SOLUTION_TERMS,
                solve_stars(replace(stars, position_sigma=stars.sigma)).covariance_by_source_n,
                strict=False,
            )
        )
        np.testing.assert_allclose(poor["catalogue"], poor["star_noise"], rtol=1e-6, atol=1e-16)
        # One sigma of each camera's error rotates the attitude by its part of the covariance by source.
        turns = []
        for mode in range(8):
            shifted = stars.measured_b + 0.1 * stars.field_b[..., mode]
            turned = solve_stars(replace(stars, measured_b=shifted)).rotation_nb
            turns.append(10.0 * log_rotation(turned @ ours.rotation_nb.T))
        np.testing.assert_allclose(parts["optics"], np.transpose(turns) @ turns, rtol=0.02, atol=1e-14)
