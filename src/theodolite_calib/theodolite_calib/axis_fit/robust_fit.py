"""Axis errors of sightings by a robust fit of the exact chain.

Huber's loss of the angle on the sky, r = |residual|, against the scale s (sigma of one component):

    rho(r) = r² / 2  for r <= k s,   k s (r - k s / 2)  beyond,   k = 1.345

so that a sighting within 1.3 s counts in full and one far out with the weight k s / r. The loss is convex: with errors
as small as these there is one minimum, whatever the start. s is the median of r over 1.177, which it is for a normal
error in two components. Minimised by iteratively reweighted Gauss-Newton steps.

Huber, "Robust Statistics" (1981), ch. 7.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.axes import NAMES, AxisErrors, main_axis_rotation
from theodolite_calib.axis_fit.sightings import Sightings

HUBER_K = 1.345
"""Where the loss turns from quadratic to linear, in scales."""

OUTLIER_AT = 3.5
"""A sighting is an outlier when it is off by more scales than this: of clean ones two in a thousand are."""

PRIOR_SIGMAS = np.array([np.pi, np.pi, *[3600.0 * ARCSEC] * 5])
"""Known of each error before any sighting (rad): zero points may be anywhere, the rest is surely below some degrees.

It keeps what the sightings do not see at zero, with a sigma that says so, and does nothing to what they see.
"""

_MEDIAN_OF_TWO = np.sqrt(2.0 * np.log(2.0))
# No encoder reads finer; sightings without any error still have a scale.
_LEAST_INFORMATION = 1e-13
"""Of the best known combination's: what is below it is the rounding of sums."""

_LEAST_SCALE = 1e-4 * ARCSEC
_MOST_STEPS = 200
# The scale is then held: what remains is convex and must converge.
_STEPS_WITH_NEW_SCALE = 50
_CONVERGED_SIGMAS = 1e-6


@dataclass(frozen=True)
class AxisFit:
    """What the sightings say.

    Attributes:
        errors: axis errors, fixed ones included, rad.
        fitted: names of the fitted ones, in the order of the covariance.
        covariance: of the fitted errors, shape (k, k), rad².
        scale: robust sigma of one component of a sighting, rad.
        before: residuals without any model, to the right and up, shape (n, 2), rad.
        residuals: with the fitted model, shape (n, 2), rad.
        left_out: of each sighting with the model that the others alone give, shape (n, 2), rad.
        weights: with which each sighting counted, shape (n,), at most 1.
        design: change of direction per fitted error, shape (n, 2, k).
    """

    errors: AxisErrors
    fitted: tuple[str, ...]
    covariance: FloatArray
    scale: float
    before: FloatArray
    residuals: FloatArray
    left_out: FloatArray
    weights: FloatArray
    design: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Of the fitted errors, shape (k,), rad."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """Of the fitted errors, shape (k, k)."""
        return self.covariance / np.outer(self.sigmas, self.sigmas)

    @property
    def outliers(self) -> NDArray[np.bool_]:
        """Which sightings are off by more than :data:`OUTLIER_AT` scales, shape (n,)."""
        return ~(sizes(self.residuals) <= OUTLIER_AT * self.scale)


def fit(sightings: Sightings, fixed: Mapping[str, float]) -> AxisFit:
    """Fit all axis errors but the fixed ones.

    Args:
        sightings: at least as many as errors to fit.
        fixed: errors that are not fitted, by name, with their values, rad.
    """
    free = np.array([name not in fixed for name in NAMES])
    vector = np.array([fixed.get(name, start) for name, start in zip(NAMES, _start(sightings), strict=True)])
    information = np.diag(PRIOR_SIGMAS[free] ** -2.0)
    scale = 0.0
    for step in range(_MOST_STEPS):
        residuals, design = _linearized(sightings, vector, free)
        if step < _STEPS_WITH_NEW_SCALE:
            scale = _scale(residuals, int(np.sum(free)))
        weights = _weights(residuals, scale)
        normal = _normal(design, weights[:, None, None] * np.eye(2)) + scale**2 * information
        gradient = _gradient(design, weights, residuals) - scale**2 * information @ vector[free]
        change = np.linalg.solve(normal, gradient)
        vector[free] += change
        if np.sqrt(change @ normal @ change) < _CONVERGED_SIGMAS * scale:
            break
    return _result(sightings, vector, free, scale)


def sizes(residuals: FloatArray) -> FloatArray:
    """Angles on the sky of residuals, shape (n,)."""
    return np.linalg.norm(residuals, axis=-1)


def rms(residuals: FloatArray) -> float:
    """Root mean square of the angles on the sky."""
    return float(np.sqrt(np.mean(sizes(residuals) ** 2)))


def _start(sightings: Sightings) -> FloatArray:
    """Zero points that fit on the average; they may be anywhere. All else is small."""
    axis_d = main_axis_rotation(AxisErrors(), sightings.azimuth, sightings.elevation)[..., 0]
    seen, true = (d[..., 0] + 1j * d[..., 2] for d in (axis_d, sightings.direction_d))
    return np.array([np.angle(np.sum(seen * np.conj(true))), *[0.0] * (len(NAMES) - 1)])


def _linearized(sightings: Sightings, vector: FloatArray, free: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    residuals, change = sightings.linearized(AxisErrors.from_vector(vector))
    return residuals, change[..., free]


def _scale(residuals: FloatArray, terms: int) -> float:
    components = residuals.size
    lost = np.sqrt(components / (components - terms))
    return max(float(np.median(sizes(residuals)) / _MEDIAN_OF_TWO * lost), _LEAST_SCALE)


def _weights(residuals: FloatArray, scale: float) -> FloatArray:
    size = sizes(residuals)
    return np.where(size > HUBER_K * scale, HUBER_K * scale / np.maximum(size, scale), 1.0)


def _normal(design: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Sum of Jᵀ D J, shape (k, k), for a stiffness D per sighting, shape (n, 2, 2)."""
    terms = design.shape[-1]
    return design.reshape(-1, terms).T @ (stiffness @ design).reshape(-1, terms)


def _gradient(design: FloatArray, weights: FloatArray, residuals: FloatArray) -> FloatArray:
    return design.reshape(-1, design.shape[-1]).T @ (weights[:, None] * residuals).ravel()


def _result(sightings: Sightings, vector: FloatArray, free: NDArray[np.bool_], scale: float) -> AxisFit:
    residuals, design = _linearized(sightings, vector, free)
    weights = _weights(residuals, scale)
    information = np.diag(PRIOR_SIGMAS[free] ** -2.0)
    return AxisFit(
        errors=AxisErrors.from_vector(vector),
        fitted=tuple(name for name, fitted in zip(NAMES, free, strict=True) if fitted),
        covariance=_covariance(residuals, design, weights, information),
        scale=scale,
        before=sightings.residuals(AxisErrors()),
        residuals=residuals,
        left_out=_left_out(residuals, design, weights, scale**2 * information),
        weights=weights,
        design=design,
    )


def _covariance(residuals: FloatArray, design: FloatArray, weights: FloatArray, information: FloatArray) -> FloatArray:
    """Huber (1981) §7.6, for residuals of two components, and the prior.

    The loss beyond k s resists a change along the residual not at all and one across it with its weight: on the average
    over both with half the weight.
    """
    stiffness = np.where(weights < 1.0, 0.5 * weights, 1.0)
    freedom = residuals.size - design.shape[-1]
    variance = np.sum((weights * sizes(residuals)) ** 2) / freedom / np.mean(stiffness)
    seen = _normal(design, stiffness[:, None, None] * np.eye(2)) / max(variance, _LEAST_SCALE**2)
    return np.linalg.inv(seen + information)


def _left_out(residuals: FloatArray, design: FloatArray, weights: FloatArray, information: FloatArray) -> FloatArray:
    """Residual of each sighting when the others alone are fitted: one Newton step of the loss without it."""
    along = residuals / np.maximum(sizes(residuals), _LEAST_SCALE)[:, None]
    flat = np.where(weights < 1.0, weights, 0.0)[:, None, None] * along[:, :, None] * along[:, None, :]
    stiffness = weights[:, None, None] * np.eye(2) - flat
    of_one = np.swapaxes(design, -1, -2) @ stiffness @ design
    pull = np.swapaxes(design, -1, -2) @ (weights[:, None] * residuals)[..., None]
    of_others = np.sum(of_one, axis=0) + information - of_one
    # What the others say nothing of stays as it is: equal sightings without noise leave no inverse.
    change = np.linalg.pinv(of_others, rcond=_LEAST_INFORMATION, hermitian=True) @ -pull
    return residuals - (design @ change)[..., 0]
