"""Compiled Jacobian of beacon points by states against numpy."""

import numpy as np
import pytest

from ship_geometry.mount.image import block_diagonal
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_pointing

RNG_SEED = 5
LIGHTS, STATES, ERRORS, FOCAL_LENGTH = 3, 11, 7, 4
PLACES = np.array([[-1, 0, 2], [-1, 1, 3], [0, 0, 9], [2, 6, 9], [1, 5, 10]])


def assert_equal(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)


def random_arguments(*shape: int) -> FloatArray:
    return np.random.default_rng([RNG_SEED, *shape]).standard_normal(shape)


def arguments() -> list[FloatArray]:
    shapes = (LIGHTS, 2, 3), (LIGHTS, 2, 3), (LIGHTS, 2), (LIGHTS, 3, ERRORS), (3, STATES)
    return [random_arguments(number, *shape)[number - 1] for number, shape in enumerate(shapes, start=1)]


def test_points_move_by_states_as_by_numpy() -> None:
    by_attitude, by_direction, by_focal_length, lines, turn_n = arguments()
    jacobian, by_error = compiled_pointing.jacobian_by_states(*arguments(), FOCAL_LENGTH, PLACES)
    expected = by_attitude.reshape(-1, 3) @ turn_n
    expected[:, FOCAL_LENGTH] = by_focal_length.ravel()
    assert_equal(by_error, by_direction @ lines)
    for light, error, state in PLACES.tolist():
        for row in range(LIGHTS) if light < 0 else [light]:
            expected[2 * row : 2 * row + 2, state] += (by_direction @ lines)[row, :, error]
    assert_equal(jacobian, expected)


@pytest.mark.parametrize("lights", [1, 2, 5])
def test_covariances_of_points_are_as_by_numpy(lights: int) -> None:
    rows, turns = random_arguments(2 * lights, 3), random_arguments(2, 3, 3)
    assert_equal(compiled_pointing.covariances_by_rotation(rows, turns), rows @ turns @ rows.T)
    by_error, roots = random_arguments(lights, 2, 5), random_arguments(lights, 3, 3)
    own = roots @ roots.swapaxes(1, 2)
    assert_equal(
        compiled_pointing.covariance_by_own_error(by_error, own),
        block_diagonal(by_error[..., :3] @ own @ by_error[..., :3].swapaxes(1, 2)),
    )


@pytest.mark.parametrize("number", range(5))
def test_mismatched_shapes_are_refused(number: int) -> None:
    """The loops check no bounds."""
    wrong = arguments()
    wrong[number] = wrong[number][:-1].copy()
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_pointing.jacobian_by_states(*wrong, FOCAL_LENGTH, PLACES)


@pytest.mark.parametrize("place", [[LIGHTS, 0, 0], [-2, 0, 0], [0, ERRORS, 0], [0, -1, 0], [0, 0, STATES], [0, 0, -1]])
def test_invalid_couplings_are_refused(place: list[int]) -> None:
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_pointing.jacobian_by_states(*arguments(), FOCAL_LENGTH, np.array([place]))
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_pointing.jacobian_by_states(*arguments(), STATES, PLACES)


def test_mismatched_covariances_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_pointing.covariances_by_rotation(random_arguments(4, 2), random_arguments(2, 3, 3))
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_pointing.covariance_by_own_error(random_arguments(2, 2, 2), random_arguments(2, 3, 3))
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_pointing.covariance_by_own_error(random_arguments(3, 2, 3), random_arguments(2, 3, 3))
