"""Combinations of axis errors and deformation that the sightings cannot separate, computed live with the filter.

If star cameras are configured, the vector to N' (principal point of the telescope's lens) is included, because beacons
depend on N' and stars do not.

A second covariance is propagated for this purpose. In this covariance, axis errors, deformation and N' are practically
unknown at the start. The deformation is a random walk with the rate of the filter's process. All other states,
correlated errors included, are as in the filter. If this covariance shows no information about a combination, the
sightings contain no information about it, and more sightings of the same kind will not help. In a combination, the
ratio of N' to an angle is in metres per radian.

In a covariance with such large variances, errors known to an arcsecond would be lost in rounding. The root of the
covariance is therefore propagated. Stacked roots are combined by QR decomposition, so that no variance can become
negative (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977).
"""

from dataclasses import replace

import numpy as np

from ship_estimation.kalman.kalman_filter import StateModel, block
from ship_estimation.kalman.unobservable_combinations import unobservable_combinations
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import FloatArray
from ship_kernels.compiled_innovations import square_root
from theodolite_calib.filter.model import ShipErrorStep

DEFORMATION_NAMES = ("deformation_bow", "deformation_up", "deformation_starboard")

LENS_NAMES = ("lens_forward", "lens_up", "lens_right")

_ELIMINATION_ORDER = (*DEFORMATION_NAMES, "c", "I", "h", "flexure", "beta_x", "beta_y", "g", *LENS_NAMES)
"""Order in which errors lead the reported combinations. A leading error is eliminated from all other combinations.
Axis errors that are similar to the deformation come after the other axis errors."""

_UNKNOWN = 1000.0
"""Initial standard deviation of an unknown error, in standard deviations of the configuration."""


class SightingObservability:
    """Observability of the states of a filter from its sightings.

    ``root`` is the root of the covariance from the sightings alone, shape (n, n); covariance = root @ root.T.

    Args:
        model: states of the filter.
        includes_lens: True to include the vector to N', if the filter has the states ``lens``.
    """

    def __init__(self, model: StateModel, includes_lens: bool = False) -> None:
        deformation = model.blocks["deformation"]
        unknown = {
            "axes": replace(model.blocks["axes"], sigma=_UNKNOWN * model.blocks["axes"].sigma),
            "deformation": block(
                "deformation",
                _UNKNOWN * deformation.sigma,
                "any",
                walk=deformation.sigma * np.sqrt(2.0 / deformation.time_s),
            ),
        }
        reported = {"axes": NAMES, "deformation": DEFORMATION_NAMES}
        if includes_lens and "lens" in model.slices:
            unknown["lens"] = replace(model.blocks["lens"], sigma=_UNKNOWN * model.blocks["lens"].sigma)
            reported["lens"] = LENS_NAMES
        blocks = [replace(unknown.get(name, entry), source="any") for name, entry in model.blocks.items()]
        self._model = StateModel(blocks, [])
        self._ship = model.slices["ship.attitude"]
        names = [name for of_block in reported.values() for name in of_block]
        sigma = np.concatenate([model.blocks[name].sigma for name in reported])
        rows = np.concatenate([model.state_indices(name) for name in reported])
        self._reported_names = names
        # An error with a sigma of 0 is fixed and not reported.
        order = [names.index(name) for name in _ELIMINATION_ORDER if name in names and sigma[names.index(name)] > 0.0]
        self._names, self._sigma, self._state_indices = [names[i] for i in order], sigma[order], rows[order]

    def initial_root(self) -> FloatArray:
        """Return the root before any sighting."""
        return np.diag(np.concatenate([entry.sigma for entry in self._model.blocks.values()]))

    def propagate(self, root: FloatArray, dt_s: float, ship_covariance_n: FloatArray | None) -> FloatArray:
        """Propagate by ``dt_s``; ``ship_covariance_n`` is the stated stationary covariance of the ship's error."""
        decay, noise = self._model.transition(dt_s)
        roots = [decay[:, None] * root, np.diag(np.sqrt(noise))[:, noise > 0.0]]
        if ship_covariance_n is not None:
            roots.append(self._ship_root((1.0 - decay[self._ship][0] ** 2) * ship_covariance_n))
        return _triangle(np.hstack(roots))

    def with_ship_step(self, root: FloatArray, step: ShipErrorStep) -> FloatArray:
        """Return the root after a step of the ship's error."""
        root = root.copy()
        root[self._ship] *= step.retained[:, None]
        return _triangle(np.hstack([root, self._ship_root(step.added_n)]))

    def update(self, root: FloatArray, jacobian: FloatArray, noise: FloatArray) -> FloatArray:
        """Update with a sighting that has the filter's Jacobian (m, n) and noise (m, m)."""
        size, states = jacobian.shape
        both = np.block([[np.linalg.cholesky(noise), jacobian @ root], [np.zeros((states, size)), root]])
        # The upper rows are the root of the innovation's covariance; the lower right is the root after the update.
        return _triangle(both)[size:, size:]

    def _ship_root(self, covariance_n: FloatArray) -> FloatArray:
        """Return the root of a covariance of the ship's error, rad², shape (3, 3), for all states, shape (n, 3)."""
        root = np.zeros((self._model.size, 3))
        root[self._ship] = square_root(covariance_n)
        return root

    def unobservable_combinations(self, root: FloatArray) -> tuple[str, ...]:
        """Return the combinations of errors that the sightings cannot separate, such as ``g - deformation_up``."""
        root = root[self._state_indices]
        return unobservable_combinations(root @ root.T, self._sigma, self._names, self._reported_names)


def _triangle(root: FloatArray) -> FloatArray:
    """Return the lower triangle L with L Lᵀ = root rootᵀ, shape (n, n); root has n rows and at least n columns."""
    lower: FloatArray = np.asarray(np.linalg.qr(root.T, mode="r"), dtype=float).T
    return lower
