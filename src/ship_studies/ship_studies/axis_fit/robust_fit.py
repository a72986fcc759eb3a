"""Robust fit of the axis errors to sightings, with the exact axis geometry.

The sum of Huber's loss ρ over the sightings is minimised. r is the angle on the sky of a residual, and s the scale, the
standard deviation of one component of a residual:

    ρ(r) = r² / 2  for r <= k s,   k s (r - k s / 2)  beyond,   k = 1.345

A sighting has the weight 1 for r <= k s, and k s / r beyond. The loss is convex in the residuals, which are nearly
linear in such small errors, so there is one minimum for any initial values. s is the median of r divided by 1.177,
times a correction for the degrees of freedom of the fit. 1.177 is the median length of a vector of two normal
components of sigma 1. The loss is minimised by iteratively reweighted Gauss-Newton steps.

Errors common to several sightings (:mod:`ship_studies.axis_fit.sightings`) are further unknowns, each with its
sigma as prior; the rest of a residual is the sighting's own error. If a table states no common errors, the sightings
are assumed to be independent. If the residuals of neighbours are correlated, this assumption is wrong, and no sigmas
are given.

Huber, "Robust Statistics" (1981), ch. 7.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_geometry.mount.axes import NAMES, AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.axis_fit.sightings import Sightings

HUBER_K = 1.345
"""Residual at which the loss changes from quadratic to linear, in multiples of the scale."""

OUTLIER_AT = 3.5
"""Residual above which a sighting is an outlier, in multiples of the scale; 0.2 % of normal residuals exceed it."""

PRIOR_SIGMAS = np.array([np.pi, np.pi, *[3600.0 * ARCSEC] * 5])
"""Prior standard deviation of each error, rad: half a turn for zero points, a degree for other errors.

An unobservable error stays at zero, with its prior sigma. The prior hardly affects observable errors."""

CORRELATION_LIMIT = 0.3
"""Maximum correlation between the residuals of neighbouring sightings for which sigmas are given.

At this correlation the true sigmas are a third larger than the given sigmas, which assume independence."""

_CHANCE_SIGMAS = 3.0
"""Maximum chance correlation of independent residuals, in standard deviations of the correlation. Sigmas are given up
to the larger of this correlation and :data:`CORRELATION_LIMIT`."""
_MEDIAN_OF_TWO = np.sqrt(2.0 * np.log(2.0))
"""Median length of a vector of two normal components of sigma 1."""
_LEAST_SCALE = 1e-4 * ARCSEC
"""Minimum scale, rad, below the resolution of any encoder, for sightings without any error."""
_ROUNDING = 1e-12
_MOST_STEPS = 200
_STEPS_WITH_NEW_SCALE = 50
"""Number of steps after which the scale is fixed; the remaining problem is convex and converges."""
_CONVERGED_SIGMAS = 1e-6


@dataclass(frozen=True)
class AxisFit:
    """Result of a fit.

    Attributes:
        errors: axis errors, fixed errors included, rad.
        fitted: names of the fitted errors, in the order of the covariance.
        covariance: covariance of the fitted errors, rad², shape (k, k); it includes only common errors stated by the
            table.
        neighbour_correlation: correlation between the residuals of neighbouring sightings.
        sigmas_known: False if neighbour_correlation shows common errors that the table does not state.
        scale: robust sigma of one component of a sighting's own error, rad, without common errors.
        before: residuals with all axis errors zero, to the right and up, rad, shape (n, 2).
        shared: estimated effect of the common errors, rad, shape (n, 2).
        residuals: residuals with the fitted model and without the common errors, rad, shape (n, 2).
        leave_one_out: residual of each sighting against the fit of the other sightings, rad, shape (n, 2).
        weights: weight of each sighting, at most 1, shape (n,).
        design: derivative of the direction with respect to the fitted errors, shape (n, 2, k).
    """

    errors: AxisErrors
    fitted: tuple[str, ...]
    covariance: FloatArray
    neighbour_correlation: float
    sigmas_known: bool
    scale: float
    before: FloatArray
    shared: FloatArray
    residuals: FloatArray
    leave_one_out: FloatArray
    weights: FloatArray
    design: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the fitted errors, rad, shape (k,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """Correlation of the fitted errors, shape (k, k)."""
        return self.covariance / np.outer(self.sigmas, self.sigmas)

    @property
    def outliers(self) -> NDArray[np.bool_]:
        """True for each sighting with a residual of more than :data:`OUTLIER_AT` scales, shape (n,)."""
        return ~(sizes(self.residuals) <= OUTLIER_AT * self.scale)


def fit(sightings: Sightings, fixed: Mapping[str, float]) -> AxisFit:
    """Fit all axis errors except the fixed errors.

    Args:
        sightings: the sightings, at least as many as there are errors to fit.
        fixed: errors that are not fitted, by name, with their values, rad.
    """
    free = np.array([name not in fixed for name in NAMES])
    terms = int(np.sum(free))
    vector = np.array([fixed.get(name, start) for name, start in zip(NAMES, _initial_errors(sightings), strict=True)])
    problem = _Problem(sightings, free, sightings.correlated_map())
    shared = np.zeros(problem.correlated_map.shape[-1])
    scale, used_degrees = 0.0, float(terms)
    for step in range(_MOST_STEPS):
        residuals, design = problem.linearise(vector, shared)
        if step < _STEPS_WITH_NEW_SCALE:
            scale = _scale(residuals, used_degrees)
        weights = _weights(residuals, scale)
        unknowns = np.concatenate([vector[free], shared])
        by_residuals = design.reshape(-1, design.shape[-1]).T @ (weights[:, None] * residuals).ravel()
        gradient = by_residuals / scale**2 - problem.information @ unknowns
        root = _root_of_inverse(np.sqrt(weights)[:, None, None] * design / scale, problem.information)
        change = root @ (root.T @ gradient)
        vector[free] += change[:terms]
        shared = shared + change[terms:]
        # An observable common error takes a degree of freedom from the residuals, as an axis error does.
        used_degrees = terms + float(np.sum(1.0 - np.sum(root[terms:] ** 2, axis=1)))
        # Square root: size of the step in sigmas of the result.
        if np.sqrt(gradient @ change) < _CONVERGED_SIGMAS:
            break
    return _result(problem, vector, shared, scale, used_degrees)


def sizes(residuals: FloatArray) -> FloatArray:
    """Return the angles on the sky of residuals, shape (n,)."""
    angles: FloatArray = np.linalg.norm(residuals, axis=-1)
    return angles


def rms(residuals: FloatArray) -> float:
    """Return the root mean square of the angles on the sky."""
    return float(np.sqrt(np.mean(sizes(residuals) ** 2)))


def _initial_errors(sightings: Sightings) -> FloatArray:
    """Return the initial errors: zeros, except for the zero point of the azimuth, which may have any value."""
    axis_d = main_axis_rotation(AxisErrors(), sightings.azimuth, sightings.elevation)[..., 0]
    encoder_axis, true = (d[..., 0] + 1j * d[..., 2] for d in (axis_d, sightings.direction_d))
    return np.array([np.angle(np.sum(encoder_axis * np.conj(true))), *[0.0] * (len(NAMES) - 1)])


@dataclass(frozen=True)
class _Problem:
    """Least-squares problem; the unknowns are the fitted axis errors, and common errors in units of their sigma.

    Attributes:
        sightings: the sightings.
        free: True for each fitted axis error, shape (7,).
        correlated_map: effect of the common errors on the sightings, shape (n, 2, q).
    """

    sightings: Sightings
    free: NDArray[np.bool_]
    correlated_map: FloatArray

    @property
    def information(self) -> FloatArray:
        """Prior information of the unknowns, shape (k + q, k + q)."""
        return np.diag(np.concatenate([PRIOR_SIGMAS[self.free] ** -2.0, np.ones(self.correlated_map.shape[-1])]))

    def linearise(self, vector: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (n, 2), and the model's derivative with respect to all unknowns, shape (n, 2, k + q)."""
        residuals, change = self.sightings.linearise(AxisErrors.from_vector(vector))
        return residuals - self.correlated_map @ shared, np.concatenate(
            [change[..., self.free], self.correlated_map], axis=-1
        )


def _scale(residuals: FloatArray, used_degrees: float) -> float:
    components = residuals.size
    lost = np.sqrt(components / (components - used_degrees))
    return max(float(np.median(sizes(residuals)) / _MEDIAN_OF_TWO * lost), _LEAST_SCALE)


def _weights(residuals: FloatArray, scale: float) -> FloatArray:
    size = sizes(residuals)
    return np.where(size > HUBER_K * scale, HUBER_K * scale / np.maximum(size, scale), 1.0)


def _result(problem: _Problem, vector: FloatArray, shared: FloatArray, scale: float, used_degrees: float) -> AxisFit:
    sightings, terms = problem.sightings, int(np.sum(problem.free))
    residuals, design = problem.linearise(vector, shared)
    weights = _weights(residuals, scale)
    neighbours = _neighbour_correlation(sightings, weights[:, None] * residuals)
    chance = _CHANCE_SIGMAS / np.sqrt(residuals.size)
    return AxisFit(
        errors=AxisErrors.from_vector(vector),
        fitted=tuple(name for name, fitted in zip(NAMES, problem.free, strict=True) if fitted),
        covariance=_covariance(residuals, design, weights, problem.information, used_degrees)[:terms, :terms],
        neighbour_correlation=neighbours,
        sigmas_known=neighbours <= max(CORRELATION_LIMIT, chance),
        scale=scale,
        before=sightings.residuals(AxisErrors()),
        shared=problem.correlated_map @ shared,
        residuals=residuals,
        leave_one_out=_leave_one_out_residuals(residuals, design, weights, scale**2 * problem.information),
        weights=weights,
        design=design[..., :terms],
    )


def _neighbour_correlation(sightings: Sightings, residuals: FloatArray) -> float:
    """Return the correlation between the residuals of neighbours in time, or in the table without times."""
    if sightings.time_s is not None:
        residuals = residuals[np.argsort(sightings.time_s, kind="stable")]
    squares = float(np.sum(residuals**2))
    return float(np.sum(residuals[1:] * residuals[:-1])) / squares if squares > 0.0 else 0.0


def _covariance(
    residuals: FloatArray, design: FloatArray, weights: FloatArray, information: FloatArray, used_degrees: float
) -> FloatArray:
    """Return the covariance of the unknowns by Huber (1981) §7.6, for residuals of two components, with the prior.

    The stiffness is the second derivative of the loss. For residuals beyond k s the stiffness is zero along the
    residual, and equals the sighting's weight across the residual. The mean of these two values, half the weight, is
    used.
    """
    stiffness = np.where(weights < 1.0, 0.5 * weights, 1.0)
    freedom = residuals.size - used_degrees
    variance = np.sum((weights * sizes(residuals)) ** 2) / freedom / np.mean(stiffness)
    sigma = np.sqrt(np.maximum(variance, _LEAST_SCALE**2))
    root = _root_of_inverse(np.sqrt(stiffness)[:, None, None] * design / sigma, information)
    covariance: FloatArray = root @ root.T
    return covariance


def _root_of_inverse(design: FloatArray, information: FloatArray) -> FloatArray:
    """Return W with W Wᵀ = (Jᵀ J + information)⁻¹ for a weighted design J; the prior's ``information`` is diagonal.

    J is decomposed, not Jᵀ J, whose condition number is the square of that of J. The prior of a zero point is half a
    turn and the resulting sigmas are arcseconds, so that Jᵀ J would leave only two or three digits of the covariance.
    """
    known = 1.0 / np.sqrt(np.diagonal(information))
    rows = np.vstack([design.reshape(-1, len(known)) * known, np.eye(len(known))])
    root: FloatArray = known[:, None] * np.linalg.inv(np.linalg.qr(rows, mode="r"))
    return root


def _leave_one_out_residuals(
    residuals: FloatArray, design: FloatArray, weights: FloatArray, information: FloatArray
) -> FloatArray:
    """Return each sighting's residual against a fit without this sighting, by one Newton step from the full fit."""
    along = residuals / np.maximum(sizes(residuals), _LEAST_SCALE)[:, None]
    # Beyond k s the loss is linear along the residual, and has a stiffness only across it.
    is_beyond = (weights < 1.0)[:, None, None]
    across = np.eye(2) - is_beyond * along[:, :, None] * along[:, None, :]
    stiffness = weights[:, None, None] * across
    of_one = design @ _root_of_inverse(np.sqrt(weights)[:, None, None] * (across @ design), information)
    # Each sighting reduces its own residual, which is larger in a fit without the sighting.
    own_pull = of_one @ np.swapaxes(of_one, -1, -2)
    kept = np.eye(2) - stiffness @ own_pull
    # The residual of a sighting that alone determines an error is only rounding, which must not be enlarged.
    stretched = own_pull @ np.linalg.inv(kept + _ROUNDING * np.eye(2))
    return residuals + (stretched @ (weights[:, None] * residuals)[..., None])[..., 0]
