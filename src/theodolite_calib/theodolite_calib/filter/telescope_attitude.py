"""Attitude of the telescope from the image of N beacons: maximum likelihood, with covariance and error budget.

The unknowns are the attitude (a rotation vector), the focal length and the errors of the lines of sight. Focal length
and line errors have priors, and the image is practically linear in them. These quantities are therefore marginalised
exactly, as part of the covariance of the points' residuals,

    S = σ² I  +  F Σ_w Fᵀ  +  σ_f² p_f p_fᵀ          detection, joint errors of the directions, focal length

A prior attitude is one more measurement, of three components. Gauss–Newton in the attitude alone minimises rᵀ S⁻¹ r.
Optimum and covariance (Hᵀ S⁻¹ H)⁻¹ equal the results of a fit of all unknowns. The estimate is linear in each error,
with the gain K = (Hᵀ S⁻¹ H)⁻¹ Hᵀ S⁻¹, so the error budget is K S_source Kᵀ.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_geometry import wahba
from ship_geometry.mount.image import Camera, Image, block_diagonal, predict_points
from ship_geometry.mount.line_of_sight import LinesOfSight, covariance_by_source
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation

SOURCE_IMAGE = "image"
SOURCE_FOCAL_LENGTH = "focal_length"

_MAX_STEPS = 20
# Step size, rad, below which the iteration ends. Each step is less than a thousandth of the previous step, so the error
# that remains after such a step is below rounding.
_CONVERGED = 1e-9


@dataclass(frozen=True)
class AttitudePrior:
    """Prior of the telescope's attitude, without the beacons.

    The errors of prior and lines of sight are assumed to be independent. An error of the ship's attitude is part of
    both errors, but for a lever of 10 m and beacons at 2 km its effect on the lines of sight is 200 times smaller.

    Attributes:
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        covariance_by_source_n: covariance of the attitude's rotation vector in n by source, rad², shape (..., 3, 3)
            each.
    """

    rotation_nt: FloatArray
    covariance_by_source_n: Mapping[str, FloatArray]

    @property
    def covariance_n(self) -> FloatArray:
        """Total covariance, rad², shape (..., 3, 3)."""
        return total_covariance(self.covariance_by_source_n)


@dataclass(frozen=True)
class Equations:
    """Linearised equations residual = jacobian @ δ + noise, with 2 N rows for points and 3 rows for a prior attitude.

    Attributes:
        residual: residuals r, shape (..., m).
        jacobian: derivative H with respect to the attitude, shape (..., m, 3).
        by_directions: derivative of the points' rows with respect to all directions, shape (..., 2 N, 3 N).
        by_focal_length: derivative of the points' rows with respect to the focal length, shape (..., 2 N).
        inverse: S⁻¹, shape (..., m, m).
        weighted_jacobian: Hᵀ S⁻¹, shape (..., 3, m).
    """

    residual: FloatArray
    jacobian: FloatArray
    by_directions: FloatArray
    by_focal_length: FloatArray
    inverse: FloatArray
    weighted_jacobian: FloatArray


@dataclass(frozen=True)
class TelescopeAttitude:
    """Attitude of the telescope; NaN if not solved.

    Attributes:
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        covariance_by_source_n: covariance of the rotation vector δ in n, R_true = exp(δ) R, by source, rad², shape
            (..., 3, 3) each.
        focal_length_m: focal length estimated from its prior and the angles between beacons, shape (...).
        focal_length_sigma_m: standard deviation of the focal length, shape (...).
        chi2: rᵀ S⁻¹ r of the residuals after the fit, shape (...).
        degrees: degrees of freedom of chi2: 2 N - 3, and 3 more with a prior attitude.
        solved: True for solved attitudes, shape (...).
    """

    rotation_nt: FloatArray
    covariance_by_source_n: dict[str, FloatArray]
    focal_length_m: FloatArray
    focal_length_sigma_m: FloatArray
    chi2: FloatArray
    degrees: int
    solved: NDArray[np.bool_]

    @property
    def covariance_n(self) -> FloatArray:
        """Total covariance of the rotation vector in n, rad², shape (..., 3, 3)."""
        return total_covariance(self.covariance_by_source_n)


def solve_attitude(
    image: Image, camera: Camera, lines: LinesOfSight, prior: AttitudePrior | None = None
) -> TelescopeAttitude:
    """Return the maximum-likelihood attitude of the telescope.

    The attitude is not solved (NaN) if the information is insufficient. An example, without a prior, is beacons so
    close together that the rotation of the image has a sigma of more than a degree
    (:data:`ship_geometry.wahba.WORST_SIGMA`).

    Args:
        image: N beacons on the detector.
        camera: geometry of the telescope.
        lines: lines of sight of the same beacons, in the same order.
        prior: prior attitude.

    Raises:
        ValueError: one beacon and no prior attitude.
    """
    if prior is None and lines.direction_n.shape[-2] < 2:
        raise ValueError("the rotation of the image is not observable from one light: a prior attitude is needed")
    line_parts = covariance_by_source(lines.terms)
    line_covariance = total_covariance(line_parts)
    rotation_nt = _initial_attitude(image, camera, lines, line_covariance, prior)
    for _ in range(_MAX_STEPS):
        equations = linearise(image, camera, lines.direction_n, line_covariance, rotation_nt, prior)
        information = equations.weighted_jacobian @ equations.jacobian
        gain = np.asarray(np.linalg.solve(information, equations.weighted_jacobian), dtype=float)
        step = (gain @ equations.residual[..., None])[..., 0]
        rotation_nt = exp_rotation(step) @ rotation_nt
        converged = np.all(np.abs(step) < _CONVERGED, axis=-1)
        # An attitude that is not solved has steps of NaN, which never become small.
        if np.all(converged | np.isnan(step[..., 0])):
            break
    misfit = equations.residual - (equations.jacobian @ step[..., None])[..., 0]
    focal_length_m, focal_length_sigma_m = _focal_length(equations, camera, gain, misfit)
    chi2 = np.einsum("...i,...ij,...j", misfit, equations.inverse, misfit)
    blank = np.where(converged, 1.0, np.nan)
    return TelescopeAttitude(
        rotation_nt=rotation_nt * blank[..., None, None],
        covariance_by_source_n={
            source: part * blank[..., None, None]
            for source, part in _parts(equations, gain, image, camera, line_parts, prior).items()
        },
        focal_length_m=focal_length_m * blank,
        focal_length_sigma_m=focal_length_sigma_m * blank,
        chi2=chi2 * blank,
        degrees=equations.residual.shape[-1] - 3,
        solved=converged,
    )


def _initial_attitude(
    image: Image, camera: Camera, lines: LinesOfSight, line_covariance: FloatArray, prior: AttitudePrior | None
) -> FloatArray:
    """Return the initial attitude: Wahba's solution of the beacons, or the prior if there is no solution."""
    diagonal = np.einsum("...ii->...i", line_covariance).reshape(*line_covariance.shape[:-2], -1, 3)
    # The trace is the sum for two components across the line of sight.
    line_variance = 0.5 * diagonal.sum(axis=-1)
    image_variance = (image.sigma_m / np.asarray(camera.focal_length_m, dtype=float)[..., None]) ** 2
    solution = wahba.solve(lines.direction_n, camera.directions(image.point_m), np.sqrt(line_variance + image_variance))
    if prior is None or np.all(solution.solved):
        return solution.rotation_nd
    return np.where(np.asarray(solution.solved)[..., None, None], solution.rotation_nd, prior.rotation_nt)


def _focal_length(
    equations: Equations, camera: Camera, gain: FloatArray, misfit: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the focal length and its standard deviation, from prior and residuals after the fit of the attitude."""
    variance = np.asarray(camera.focal_length_sigma_m, dtype=float) ** 2
    rows = equations.by_focal_length.shape[-1]
    weighted = (equations.by_focal_length[..., None, :] @ equations.inverse[..., :rows, :])[..., 0, :]
    change = variance * np.einsum("...i,...i", weighted, misfit)
    # The information left after the fit of the attitude is pᵀ (S⁻¹ - S⁻¹ H K) p.
    kept = (gain[..., :rows] @ equations.by_focal_length[..., None])[..., 0]
    through_attitude = (weighted[..., None, :] @ equations.jacobian @ kept[..., None])[..., 0, 0]
    left = np.einsum("...i,...i", weighted[..., :rows], equations.by_focal_length) - through_attitude
    return camera.focal_length_m + change, np.sqrt(variance * (1.0 - variance * left))


def _parts(
    equations: Equations,
    gain: FloatArray,
    image: Image,
    camera: Camera,
    line_parts: dict[str, FloatArray],
    prior: AttitudePrior | None,
) -> dict[str, FloatArray]:
    rows = equations.by_focal_length.shape[-1]
    by_directions = gain[..., :rows] @ equations.by_directions
    parts = {source: _propagate_covariance(by_directions, part) for source, part in line_parts.items()}
    parts[SOURCE_IMAGE] = _propagate_covariance(gain[..., :rows], image.covariance_m2)
    by_focal_length = gain[..., :rows] @ equations.by_focal_length[..., None]
    by_focal_length = by_focal_length * np.asarray(camera.focal_length_sigma_m, dtype=float)[..., None, None]
    parts[SOURCE_FOCAL_LENGTH] = by_focal_length @ np.swapaxes(by_focal_length, -1, -2)
    if prior is not None:
        for source, part in prior.covariance_by_source_n.items():
            propagated = _propagate_covariance(gain[..., rows:], part)
            parts[source] = parts[source] + propagated if source in parts else propagated
    return parts


def _propagate_covariance(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    return matrix @ covariance @ np.swapaxes(matrix, -1, -2)


def total_covariance(parts: Mapping[str, FloatArray]) -> FloatArray:
    """Return the total covariance of an error budget."""
    covariance: FloatArray = np.sum(np.stack(np.broadcast_arrays(*parts.values())), axis=0)
    return covariance


def linearise(
    image: Image,
    camera: Camera,
    direction_n: FloatArray,
    line_covariance: FloatArray,
    rotation_nt: FloatArray,
    prior: AttitudePrior | None,
) -> Equations:
    """Linearise the equations at a trial attitude.

    Args:
        image: N beacons on the detector.
        camera: geometry of the telescope.
        direction_n: unit vectors to the same beacons, shape (..., N, 3).
        line_covariance: joint covariance of the unit vectors, rad², shape (..., 3 N, 3 N).
        rotation_nt: trial attitude, horizon from telescope, shape (..., 3, 3).
        prior: prior attitude.
    """
    predicted = predict_points(camera, rotation_nt, direction_n)
    rows = 2 * direction_n.shape[-2]
    leading = predicted.point_m.shape[:-2]
    residual = (image.point_m - predicted.point_m).reshape(*leading, rows)
    jacobian = predicted.by_attitude_n.reshape(*leading, rows, 3)
    by_directions = block_diagonal(predicted.by_direction_n)
    by_focal_length = predicted.by_focal_length.reshape(*leading, rows)
    of_focal_length = np.asarray(camera.focal_length_sigma_m, dtype=float)[..., None] * by_focal_length
    covariance = by_directions @ line_covariance @ np.swapaxes(by_directions, -1, -2)
    covariance = covariance + of_focal_length[..., :, None] * of_focal_length[..., None, :]
    covariance = covariance + image.covariance_m2
    inverse = np.asarray(np.linalg.inv(covariance), dtype=float)
    if prior is not None:
        # log(exp(δ) R R_priorᵀ) = d + J⁻¹ δ is the error of the prior attitude, with the prior's covariance.
        prior_difference = log_rotation(rotation_nt @ np.swapaxes(prior.rotation_nt, -1, -2))
        residual = np.concatenate([residual, -prior_difference], axis=-1)
        jacobian = np.concatenate([jacobian, np.linalg.inv(left_jacobian(prior_difference))], axis=-2)
        inverse = _join_diagonally(inverse, np.asarray(np.linalg.inv(prior.covariance_n), dtype=float))
    weighted_jacobian = np.swapaxes(jacobian, -1, -2) @ inverse
    return Equations(residual, jacobian, by_directions, by_focal_length, inverse, weighted_jacobian)


def _join_diagonally(first: FloatArray, second: FloatArray) -> FloatArray:
    m, n = first.shape[-1], second.shape[-1]
    matrix = np.zeros((*first.shape[:-2], m + n, m + n))
    matrix[..., :m, :m] = first
    matrix[..., m:, m:] = second
    return matrix
