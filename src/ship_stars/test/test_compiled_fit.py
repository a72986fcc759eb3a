"""The compiled arithmetic of single stars compared with the same formulas in plain numpy."""

import numpy as np
import pytest

from ship_geometry.rotations import exp_rotation, skew
from ship_kernels import compiled_stars
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars, StarFit, linearise_stars
from ship_stars.camera.camera import tangent_basis

STARS, SENSORS, TURNS, SHARED = 7, 2, 3, 4


def equal(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def random_stars(sensors: int, turns: int) -> MatchedStars:
    """Return random stars of several sensors near their expected directions."""
    rng = np.random.default_rng(1)
    reference_n = rng.normal(size=(STARS, 3))
    reference_n /= np.linalg.norm(reference_n, axis=-1, keepdims=True)
    return MatchedStars(
        measured_b=reference_n @ exp_rotation(np.array([0.1, 0.2, 0.3])) + 1e-3 * rng.normal(size=(STARS, 3)),
        reference_n=reference_n,
        sigma=rng.uniform(1e-5, 2e-5, STARS),
        position_sigma=rng.uniform(1e-6, 2e-6, STARS),
        shared_n=1e-5 * rng.normal(size=(STARS, 3, SHARED)),
        sensor=rng.integers(0, max(sensors, 1), STARS),
        mounting_b=1e-4 * rng.normal(size=(sensors, 3, 3)),
        time_transfer_b=1e-5 * rng.normal(size=(max(sensors, 1), 3, turns)) if turns else None,
    )


@pytest.mark.parametrize(("sensors", "turns"), [(0, 0), (SENSORS, 0), (SENSORS, TURNS), (0, TURNS)])
def test_stars_are_linearised_as_by_numpy(sensors: int, turns: int) -> None:
    stars, rotation_nb = random_stars(sensors, turns), exp_rotation(np.array([0.1, 0.2, 0.3]))
    fit = linearise_stars(stars, rotation_nb)
    per_sigma = 1.0 / stars.white_sigma[:, None, None]
    about_star = -per_sigma * skew(stars.reference_n)
    blocks = [about_star]
    for sensor in range(sensors):
        own = (stars.sensor == sensor)[:, None, None]
        blocks.append(own * (about_star @ rotation_nb @ stars.mounting_b[sensor]))
    if stars.time_transfer_b is not None:
        blocks.append(about_star @ rotation_nb @ stars.time_transfer_b[stars.sensor])
    residual_n = stars.reference_n - stars.measured_b @ rotation_nb.T
    equal(fit.jacobian, np.concatenate([*blocks, -per_sigma * stars.shared_n], axis=-1))
    equal(fit.residual_n, residual_n)
    equal(fit.displacement, residual_n * per_sigma[..., 0])


def test_normal_equations_are_those_of_the_members() -> None:
    fit, members = linearise_stars(random_stars(SENSORS, TURNS), np.eye(3)), np.arange(STARS) % 3 != 1
    rows, flat = fit.jacobian[members].reshape(-1, fit.jacobian.shape[-1]), fit.displacement[members].ravel()
    information, right_side = fit.normal_equations(members)
    equal(information, rows.T @ rows)
    equal(right_side, flat @ rows)
    equal(fit.normal_equations()[1], fit.displacement.ravel() @ fit.jacobian.reshape(STARS * 3, -1))


@pytest.mark.parametrize("without_prior", [0, 3])
def test_stars_are_solved_as_by_numpy(without_prior: int) -> None:
    fit, members = linearise_stars(random_stars(SENSORS, TURNS), np.eye(3)), np.arange(STARS) % 3 != 1
    rows, flat = fit.jacobian[members].reshape(-1, fit.jacobian.shape[-1]), fit.displacement[members].ravel()
    # Unknowns in units of sigma are of order one.
    unit = np.where(np.arange(rows.shape[1]) < 3, 1e5, 1.0)
    rows, fit = rows / unit, StarFit(fit.jacobian / unit, fit.displacement, fit.residual_n, without_prior)
    solution = fit.solve(members)
    prior = np.diag((np.arange(rows.shape[1]) >= without_prior).astype(float))
    expected = np.linalg.solve(rows.T @ rows + prior, flat @ rows)
    equal(solution.information, rows.T @ rows)
    equal(solution.information_with_prior, rows.T @ rows + prior)
    np.testing.assert_allclose(solution.unknowns, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    left = flat - rows @ expected
    assert solution.chi_square == pytest.approx(left @ left + expected @ prior @ expected, rel=1e-9)
    assert solution.degrees == 2 * np.count_nonzero(members) - without_prior


def test_stars_that_do_not_determine_the_attitude_are_refused() -> None:
    fit = linearise_stars(random_stars(0, 0), np.eye(3))
    with pytest.raises(np.linalg.LinAlgError):
        fit.solve(np.zeros(STARS, dtype=bool))
    with pytest.raises(np.linalg.LinAlgError):
        StarFit(np.full_like(fit.jacobian, np.nan), fit.displacement, fit.residual_n).solve()


def test_with_a_prediction_the_attitude_is_in_units_of_its_sigmas() -> None:
    fit, rng = linearise_stars(random_stars(SENSORS, 0), np.eye(3)), np.random.default_rng(3)
    root, turn_n = rng.normal(size=(3, 3)), 1e-4 * rng.normal(size=3)
    covariance_n = root @ root.T
    for expected_n in (None, turn_n):
        found = fit.with_prior(covariance_n, expected_n)
        of_attitude = fit.jacobian[:, :, :3]
        equal(found.jacobian[:, :, 3:], fit.jacobian[:, :, 3:])
        counted = found.jacobian[:, :, :3]
        # Any square root of the covariance is valid: the product with its transpose is the same.
        equal(counted @ counted.swapaxes(1, 2), of_attitude @ covariance_n @ of_attitude.swapaxes(1, 2))
        equal(found.displacement, fit.displacement - (0.0 if expected_n is None else of_attitude @ expected_n))
        assert found.free_count == 0


def test_covariances_by_term_are_as_by_numpy() -> None:
    rng, unknowns = np.random.default_rng(4), 12
    jacobian, root = rng.normal(size=(STARS, 3, unknowns)), rng.normal(size=(3, 3))
    white_n, share = root @ root.T, rng.uniform(0.0, 1.0, STARS) * (np.arange(STARS) != 2)
    information = np.einsum("kia,kib->ab", jacobian, jacobian)
    term_of = np.array([1, 1, 1, 1, 1, 2, 3, 4, 4])
    parts, shares = compiled_stars.attitude_covariances(white_n, information, jacobian, share, term_of, 6)
    turns = white_n @ information[:3, 3:]
    for term in range(6):
        own = turns[:, term_of == term]
        np.testing.assert_allclose(parts[term], own @ own.T, rtol=1e-12, atol=0.0)
    rows = (jacobian[:, :, :3] * share[:, None, None]).reshape(-1, 3) @ white_n
    np.testing.assert_allclose(shares, rows.T @ rows, rtol=1e-12)


def test_residuals_of_stars_are_as_by_numpy() -> None:
    stars, members = random_stars(0, 0), np.arange(STARS) % 4 != 2
    rng = np.random.default_rng(2)
    rotation_ns, to_sensor = exp_rotation(rng.normal(size=3)), rng.normal(size=(3, 9))
    estimate = rng.normal(size=SHARED)
    expected_n = stars.reference_n + stars.shared_n @ estimate
    expected_n /= np.linalg.norm(expected_n, axis=-1, keepdims=True)
    equal(compiled_stars.expected_directions(stars.reference_n, stars.shared_n, estimate), expected_n)
    found = compiled_stars.residuals(
        stars.measured_b, expected_n, stars.shared_n, members.view(np.uint8), rotation_ns, to_sensor, 5
    )
    predicted_s = expected_n[members] @ rotation_ns
    basis = tangent_basis(predicted_s)
    by_turn = basis @ skew(predicted_s)
    jacobian = by_turn @ to_sensor
    jacobian[:, :, 5:] = basis @ rotation_ns.T @ stars.shared_n[members]
    residual = np.einsum("kij,kj->ki", basis, stars.measured_b[members] - predicted_s)
    for one, expected in zip(found, (residual.ravel(), jacobian, by_turn, basis), strict=True):
        equal(one, expected.reshape(one.shape))


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The shapes are checked before the loops, which check no bounds."""
    stars, none = random_stars(0, 0), np.empty((0, 3, 0))
    arguments = (
        stars.measured_b,
        stars.reference_n,
        stars.white_sigma,
        stars.shared_n,
        stars.sensor,
        stars.mounting_b,
        none,
        np.eye(3),
    )
    for place in (0, 1, 2, 3, 4):
        with pytest.raises(ValueError, match="do not fit together"):
            compiled_stars.linearise_stars(*arguments[:place], arguments[place][1:], *arguments[place + 1 :])
    for place, wrong in ((5, np.zeros((1, 3, 2))), (6, np.zeros((1, 2, 1))), (7, np.eye(2))):
        with pytest.raises(ValueError, match="do not fit together"):
            compiled_stars.linearise_stars(*arguments[:place], wrong, *arguments[place + 1 :])
    of_another = [*arguments[:4], stars.sensor + 1, np.zeros((1, 3, 3)), none, np.eye(3)]
    with pytest.raises(ValueError, match="sensor"):
        compiled_stars.linearise_stars(*of_another)
    everyone = np.ones(STARS, dtype=np.uint8)
    with pytest.raises(ValueError, match="stars"):
        compiled_stars.normal_equations(np.zeros((STARS, 3, 7)), np.zeros((STARS, 3)), everyone[1:])
    with pytest.raises(ValueError, match="stars"):
        compiled_stars.solve_normal_equations(np.zeros((STARS, 3, 7)), np.zeros((STARS - 1, 3)), everyone, 3)
    with pytest.raises(ValueError, match="vectors"):
        compiled_stars.solve_normal_equations(np.zeros((STARS, 2, 7)), np.zeros((STARS, 3)), everyone, 3)
    with pytest.raises(ValueError, match="vectors"):
        compiled_stars.apply_prior(np.zeros((STARS, 3, 7)), np.zeros((STARS, 3)), np.eye(2), np.zeros(3))
    for term_of in (np.zeros(5, dtype=np.intp), np.full(4, 2)):
        with pytest.raises(ValueError, match=r"unknowns|terms"):
            compiled_stars.attitude_covariances(
                np.eye(3), np.eye(7), np.zeros((STARS, 3, 7)), np.zeros(STARS), term_of, 2
            )
    with pytest.raises(ValueError, match="estimate"):
        compiled_stars.expected_directions(stars.reference_n, stars.shared_n, np.zeros(SHARED + 1))
    with pytest.raises(ValueError, match="states"):
        compiled_stars.residuals(
            stars.measured_b, stars.reference_n, stars.shared_n, everyone, np.eye(3), np.zeros((3, 9)), 6
        )
