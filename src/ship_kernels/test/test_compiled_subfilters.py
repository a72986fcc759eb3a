"""Compiled beacon innovations of subfilters against numpy, where unused components have the identity as covariance.

The tolerance is 1e-12 for numbers of about one: the covariances have condition numbers of some tens.
"""

from typing import Any

import numpy as np
import pytest

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_kalman

RNG_SEED = 4
FILTERS, STATES = 4, 11


def sighting(lights: int) -> tuple[Any, ...]:
    """Return subfilters and beacons; the first subfilter excludes the first beacon, three condition on other
    beacons."""
    rng, m = np.random.default_rng(RNG_SEED), 2 * lights
    roots, root = rng.standard_normal((FILTERS, STATES, STATES)), rng.standard_normal((m, m))
    jacobian = rng.standard_normal((m, STATES)) * (rng.random((m, STATES)) < 0.7)
    parts = roots @ roots.swapaxes(1, 2) + np.eye(STATES)
    sees = np.ones((FILTERS, m), dtype=np.uint8)
    sees[0, :2] = 0
    others = ~np.repeat(np.eye(lights, dtype=bool), 2, axis=1)[:, None]
    taken = np.vstack([np.zeros((1, m)), sees]) * np.array([0, 1, 1, 0, 1])[:, None] > 0
    known = (taken & others).astype(np.uint8)
    noise = root @ root.T + np.eye(m)
    first = jacobian @ parts[0] @ jacobian.T + noise
    return rng.standard_normal((FILTERS, STATES)), parts, rng.standard_normal(m), jacobian, noise, first, sees, known


def assert_equal(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def inverse_root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = (vectors / np.sqrt(values)) @ vectors.T
    return root


@pytest.mark.parametrize("lights", [1, 2, 5])
def test_beacon_innovations_equal_numpy(lights: int) -> None:
    distance, parts, residual, h, noise, first, sees, known = sighting(lights)
    residuals, gains, nis, turns = compiled_kalman.beacon_innovations(*sighting(lights))
    every = [residual, *(residual - distance @ h.T)]
    covariances = [first, *(h @ parts @ h.T + noise)]
    for index in range(FILTERS):
        seen = sees[index].astype(bool)
        covariance = np.where(np.outer(seen, seen), covariances[index + 1], np.eye(len(h)))
        left = every[index + 1] * seen
        assert_equal(residuals[index], left)
        assert_equal(gains[index], (parts[index] @ h.T * seen) @ np.linalg.inv(covariance))
        assert_equal(nis[index], left @ np.linalg.solve(covariance, left))
    for index, light in np.ndindex(FILTERS + 1, lights):
        own, others = slice(2 * light, 2 * light + 2), known[light, index].astype(bool)
        covariance = covariances[index]
        weights = covariance[own, others] @ np.linalg.inv(covariance[np.ix_(others, others)])
        left = every[index][own] - weights @ every[index][others]
        assert_equal(
            turns[index, light, :2], inverse_root(covariance[own, own] - weights @ covariance[others, own]) @ left
        )
        assert turns[index, light, 2] == 0.0


def test_indefinite_covariance_is_refused() -> None:
    arrays = list(sighting(2))
    arrays[4] = -1e3 * np.eye(4)
    with pytest.raises(np.linalg.LinAlgError):
        compiled_kalman.beacon_innovations(*arrays)


@pytest.mark.parametrize("number", range(8))
def test_mismatched_shapes_are_refused(number: int) -> None:
    """The compiled loops check no bounds, so the shapes are checked before."""
    arrays = list(sighting(2))
    arrays[number] = arrays[number][:-1].copy()
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_kalman.beacon_innovations(*arrays)
