import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_geometry.wahba import solve


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def noisy(rng, directions, sigma):
    """Return directions with white errors of sigma (rad, shape (..., k)) per axis across the line of sight."""
    errors = rng.normal(size=directions.shape) * np.asarray(sigma)[..., None]
    return unit(directions + errors)


def scene(rng, count):
    rotation_nd = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    measured_d = unit(rng.normal(size=(count, 3)))
    return rotation_nd, measured_d @ rotation_nd.T, measured_d


@pytest.mark.parametrize("count", [2, 3, 16])
def test_scipy_finds_the_same_rotation(count):
    rng = np.random.default_rng(count)
    for _ in range(50):
        _, reference_n, measured_d = scene(rng, count)
        sigma = rng.uniform(1.0, 10.0, count) * ARCSEC
        measured_d = noisy(rng, measured_d, sigma)
        ours = solve(reference_n, measured_d, sigma)
        theirs, _ = Rotation.align_vectors(reference_n, measured_d, weights=sigma**-2)
        assert ours.solved
        assert np.linalg.norm(log_rotation(ours.rotation_nd @ theirs.as_matrix().T)) < 1e-9


def test_exact_directions_give_the_rotation_back():
    rng = np.random.default_rng(1)
    rotation_nd, reference_n, measured_d = scene(rng, 5)
    solution = solve(reference_n, measured_d, 3.0 * ARCSEC)
    assert np.linalg.norm(log_rotation(solution.rotation_nd @ rotation_nd.T)) < 1e-14
    assert np.linalg.det(solution.rotation_nd) == pytest.approx(1.0)


# One star in each of two sensors, eight in each, and stars of unequal error.
@pytest.mark.parametrize(
    ("in_each", "sigmas_arcsec"), [(1, (3.0, 3.0)), (8, (3.0, 3.0)), (2, (1.0, 30.0))], ids=["one", "eight", "unequal"]
)
def test_covariance_equals_monte_carlo(in_each, sigmas_arcsec):
    rng = np.random.default_rng(in_each)
    runs = 20_000
    boresights = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0]]) / np.sqrt(2.0)
    measured_d = unit(np.repeat(boresights, in_each, axis=0) + 0.1 * rng.normal(size=(2 * in_each, 3)))
    sigma = np.repeat(np.array(sigmas_arcsec), in_each) * ARCSEC
    rotation_nd = exp_rotation(np.array([0.3, -2.0, 0.1]))
    reference_n = np.broadcast_to(measured_d @ rotation_nd.T, (runs, *measured_d.shape))
    many = noisy(rng, np.broadcast_to(measured_d, reference_n.shape), sigma)
    solution = solve(reference_n, many, sigma)
    errors = log_rotation(rotation_nd @ np.swapaxes(solution.rotation_nd, -1, -2))
    # R_true = exp(δ) R. NEES of three components over 20 000 runs: 3 ± 0.06 at 3.5 standard errors.
    nees = np.einsum("...i,...ij,...j", errors, np.linalg.inv(solution.covariance_n), errors)
    assert np.mean(nees) == pytest.approx(3.0, abs=0.06)
    claimed = solution.covariance_n[0]
    scale = np.sqrt(np.diagonal(claimed))
    assert np.cov(errors.T) / np.outer(scale, scale) == pytest.approx(claimed / np.outer(scale, scale), abs=0.04)


def test_sizes_of_the_models_page():
    # models.md §2: two sensors at 0° and 90°, 45° up, eight stars of 3" each: star noise 1.29" in heading (about Up),
    # 0.97" in pitch and roll. By hand, with all stars at the boresights: 3"/sqrt(8) times sqrt(3/2), sqrt(5/6).
    boresights = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0]]) / np.sqrt(2.0)
    directions = np.repeat(boresights, 8, axis=0)
    sigma_arcsec = np.sqrt(np.diagonal(solve(directions, directions, 3.0 * ARCSEC).covariance_n)) / ARCSEC
    assert sigma_arcsec == pytest.approx(3.0 / np.sqrt(8.0) * np.sqrt([5 / 6, 3 / 2, 5 / 6]), rel=1e-9)
    assert sigma_arcsec == pytest.approx([0.97, 1.29, 0.97], rel=0.01)


def test_batches_give_what_single_ones_give():
    rng = np.random.default_rng(8)
    scenes = [scene(rng, 4) for _ in range(6)]
    reference_n = np.array([s[1] for s in scenes]).reshape(2, 3, 4, 3)
    measured_d = noisy(rng, np.array([s[2] for s in scenes]).reshape(2, 3, 4, 3), 1e-5)
    sigma = rng.uniform(1e-5, 2e-5, (2, 3, 4))
    together = solve(reference_n, measured_d, sigma)
    for index in np.ndindex(2, 3):
        alone = solve(reference_n[index], measured_d[index], sigma[index])
        assert together.rotation_nd[index] == pytest.approx(alone.rotation_nd, abs=1e-13)
        assert together.covariance_n[index] == pytest.approx(alone.covariance_n, rel=1e-9, abs=1e-20)


def test_star_with_infinite_sigma_is_not_used():
    rng = np.random.default_rng(9)
    _, reference_n, measured_d = scene(rng, 4)
    measured_d = noisy(rng, measured_d, 1e-5)
    wrong = measured_d.copy()
    wrong[3] = -wrong[3]
    without = solve(reference_n, wrong, np.array([1e-5, 1e-5, 1e-5, np.inf]))
    three = solve(reference_n[:3], measured_d[:3], 1e-5)
    assert without.rotation_nd == pytest.approx(three.rotation_nd, abs=1e-13)
    assert without.covariance_n == pytest.approx(three.covariance_n, rel=1e-9)


def test_residuals_are_across_the_line_of_sight_and_put_the_star_right():
    rng = np.random.default_rng(10)
    _, reference_n, measured_d = scene(rng, 6)
    measured_d = noisy(rng, measured_d, 20.0 * ARCSEC)
    solution = solve(reference_n, measured_d, 20.0 * ARCSEC)
    turned_n = measured_d @ solution.rotation_nd.T
    residuals = np.cross(turned_n, reference_n)
    put_right = np.einsum("kij,kj->ki", exp_rotation(residuals), turned_n)
    assert put_right == pytest.approx(reference_n, abs=1e-11)
    assert np.sum(residuals * reference_n, axis=-1) == pytest.approx(np.zeros(6), abs=1e-16)
    # At the minimum the weighted residuals balance.
    assert np.sum(residuals, axis=0) == pytest.approx(np.zeros(3), abs=1e-14)


def test_one_star_is_not_solved_but_has_information_on_two_components():
    star = np.array([[0.6, 0.8, 0.0]])
    solution = solve(star, star, 1e-5)
    assert not solution.solved
    assert np.all(np.isnan(solution.rotation_nd))
    assert np.all(np.isnan(solution.covariance_n))
    assert np.linalg.eigvalsh(solution.information_n) == pytest.approx([0.0, 1e10, 1e10], abs=1.0)


@pytest.mark.parametrize("second", [1.0, -1.0], ids=["parallel", "antiparallel"])
def test_two_stars_nearly_in_line_are_not_solved(second):
    # Two stars of 3" that are 10" apart determine the rotation about their line to 3" sqrt(2) / 10" = 24°, two stars
    # that are 10' apart to 0.4°.
    for separation_arcsec, solved in ((10.0, False), (600.0, True)):
        turn = exp_rotation(np.array([0.0, separation_arcsec * ARCSEC, 0.0]))
        stars = np.array([[1.0, 0.0, 0.0], second * (turn @ [1.0, 0.0, 0.0])])
        solution = solve(stars, stars, 3.0 * ARCSEC)
        assert bool(solution.solved) is solved
        assert np.all(np.isfinite(solution.rotation_nd)) == solved


def test_unsolved_attitude_does_not_disturb_its_batch():
    rng = np.random.default_rng(11)
    _, reference_n, measured_d = scene(rng, 2)
    references = np.stack([reference_n, reference_n[[0, 0]]])
    measured = np.stack([measured_d, measured_d[[0, 0]]])
    solution = solve(references, measured, 1e-5)
    assert solution.solved.tolist() == [True, False]
    assert solution.rotation_nd[0] == pytest.approx(solve(reference_n, measured_d, 1e-5).rotation_nd, abs=1e-14)
    assert np.all(np.isnan(solution.rotation_nd[1]))


def test_a_mirrored_scene_gives_a_rotation_not_a_reflection():
    rng = np.random.default_rng(12)
    measured_d = unit(rng.normal(size=(6, 3)))
    solution = solve(measured_d * [1.0, 1.0, -1.0], measured_d, 1e-5)
    assert solution.solved
    assert np.linalg.det(solution.rotation_nd) == pytest.approx(1.0)
    best, _ = Rotation.align_vectors(measured_d * [1.0, 1.0, -1.0], measured_d)
    assert np.linalg.norm(log_rotation(solution.rotation_nd @ best.as_matrix().T)) < 1e-9
