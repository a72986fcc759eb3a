"""The compiled lines of sight and image points against plain numpy.

Tests of the callers also compare the derivatives with finite differences. "Close" is 1e-13 of the numbers' size.
"""

import numpy as np
import pytest

from ship_geometry.rotations import FloatArray, exp_rotation, skew
from ship_kernels import compiled_pointing

RNG_SEED = 3
EPOCHS, LIGHTS = 4, 3
EARTH_RADIUS_M = 6_371_000.0


def random_exposures() -> list[FloatArray]:
    """Return arrays of exposures: baselines, drone attitudes, light levers, ship attitudes, mounts, refraction."""
    rng = np.random.default_rng(RNG_SEED)
    turns = [rng.uniform(-2.0, 2.0, shape) for shape in ((EPOCHS, LIGHTS, 3), (EPOCHS, 3), (EPOCHS, 3))]
    baselines = 1000.0 * rng.standard_normal((EPOCHS, LIGHTS, 3))
    drones, ships, mounts = (exp_rotation(turn) for turn in turns)
    return [baselines, drones, rng.standard_normal((EPOCHS, LIGHTS, 3)), ships, mounts, rng.random((EPOCHS, LIGHTS))]


LEVER, PRINCIPAL_POINT = np.array([12.0, 3.0, -2.0]), np.array([0.4, 0.3, 0.1])


def lines(of_each: list[FloatArray]) -> tuple[FloatArray, ...]:
    *arrays, refraction = of_each
    found: tuple[FloatArray, ...] = compiled_pointing.sight_lines(
        *arrays, LEVER, PRINCIPAL_POINT, refraction, EARTH_RADIUS_M
    )
    return found


def close(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13 * np.max(np.abs(expected)))


def test_lines_of_sight_equal_numpy() -> None:
    baselines, drones, levers, ships, mounts, refraction = random_exposures()
    directions, distances, changes = lines(random_exposures())
    for epoch, light in np.ndindex(EPOCHS, LIGHTS):
        rotation_nb, rotation_nd = drones[epoch, light], ships[epoch]
        rotation_nm = rotation_nd @ mounts[epoch]
        lens_n, lever_n = rotation_nd @ LEVER + rotation_nm @ PRINCIPAL_POINT, rotation_nb @ levers[epoch, light]
        path_n = baselines[epoch, light] + lever_n - lens_n
        raised_n = np.array([0.0, path_n @ path_n / (2.0 * EARTH_RADIUS_M), 0.0])
        seen_n = path_n + refraction[epoch, light] * raised_n
        length = np.linalg.norm(seen_n)
        close(distances[epoch, light], np.linalg.norm(path_n))
        close(directions[epoch, light], seen_n / length)
        per_metre = (np.eye(3) - np.outer(seen_n, seen_n) / length**2) / length
        by_turn, by_drone_turn = skew(lens_n), -skew(lever_n)
        frames = [np.eye(3), -rotation_nd, -rotation_nm, rotation_nb, by_turn, by_drone_turn, raised_n[:, None]]
        for block, frame in enumerate(frames):
            columns = slice(3 * block, 3 * block + frame.shape[1])
            close(changes[epoch, light][:, columns], per_metre @ frame)


def test_image_points_equal_numpy_and_are_nan_behind_the_telescope() -> None:
    rng = np.random.default_rng(RNG_SEED)
    directions, telescopes = random_exposures()[0], random_exposures()[3]
    focal_lengths, principal_points = rng.uniform(0.1, 0.2, EPOCHS), rng.standard_normal((EPOCHS, 2))
    points, by_attitude, by_direction, by_focal_length = compiled_pointing.image_points(
        directions, telescopes, focal_lengths, principal_points
    )
    behind = np.zeros((EPOCHS, LIGHTS), dtype=bool)
    for epoch, light in np.ndindex(EPOCHS, LIGHTS):
        seen_n, rotation_nt = directions[epoch, light], telescopes[epoch]
        forward, up, right = seen_n @ rotation_nt
        behind[epoch, light] = forward <= 0.0
        if not forward > 0.0:
            assert np.isnan(points[epoch, light]).all()
            continue
        across = np.array([right, up]) / forward
        close(points[epoch, light], principal_points[epoch] - focal_lengths[epoch] * across)
        close(by_focal_length[epoch, light], -across)
        per_forward = -focal_lengths[epoch] / forward
        by_seen_t = per_forward * np.array([[-across[0], 0.0, 1.0], [-across[1], 1.0, 0.0]])
        close(by_direction[epoch, light], by_seen_t @ rotation_nt.T)
        close(by_attitude[epoch, light], by_seen_t @ rotation_nt.T @ skew(seen_n))
    assert 0 < behind.sum() < behind.size
    for values in (points, by_attitude, by_direction, by_focal_length):
        assert np.isnan(values).any(axis=tuple(range(2, values.ndim))).tolist() == behind.tolist()


def test_exposure_does_not_depend_on_the_block() -> None:
    together = lines(random_exposures())
    for number in range(EPOCHS):
        alone = lines([values[number : number + 1] for values in random_exposures()])
        for one, among_others in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], among_others[number])


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The compiled loops do not check bounds, so the functions check shapes."""
    fewer = [[v[:3] if n == number else v for n, v in enumerate(random_exposures())] for number in range(6)]
    calls = [
        *(lambda arrays=arrays: lines(arrays) for arrays in fewer),
        lambda: compiled_pointing.image_points(
            random_exposures()[0], random_exposures()[3][:3], np.ones(EPOCHS), np.ones((EPOCHS, 2))
        ),
        lambda: compiled_pointing.image_points(
            random_exposures()[0], random_exposures()[3], np.ones(EPOCHS), np.ones((EPOCHS, 3))
        ),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="do not fit together"):
            call()
