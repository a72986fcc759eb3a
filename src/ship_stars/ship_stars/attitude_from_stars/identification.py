"""Candidate catalogue stars of unidentified detections, from the predicted attitude of the sensor.

A detection and a catalogue star match if a probable error of the predicted attitude explains the angle between them.
With an uncertain prediction (a wide prior) this error is not small; its most likely value is computed iteratively
(Gauss-Newton) for each pair of detection and star. :func:`ship_stars.attitude_from_stars.exposure.identify_stars`
assigns identities from these candidates.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import chi_square_gate
from ship_geometry.rotations import FloatArray, angle_between, exp_rotation, left_jacobian, skew
from ship_stars.attitude_from_stars.selection import (
    GATE_PROBABILITY,
    StarPrior,
    mahalanobis_squared,
    perpendicular_basis,
)
from ship_stars.sky.deck_masks import SensorMasks
from ship_stars.sky.sky_model import LocalSky

MAGNITUDE_TOLERANCE = 1.5
"""Maximum difference between a measured magnitude and the catalogue's magnitude.

Most of the tolerance is for the colours of stars, and for the difference between the bands Hp and V.
"""

_FIELD_MARGIN = np.deg2rad(1.0)
"""Margin of the field for aberration and refraction, which are far smaller than this margin, rad."""

_MAX_PRIOR_SIGMAS = 5.0
"""Number of sigmas by which the predicted attitude may be wrong."""

_MAX_STEPS, _SMALL_TURN = 8, 1e-5

MAX_PRIOR_SIGMA = np.deg2rad(5.0)
"""Maximum root of the summed variances of a predicted attitude, rad; beyond this, too many catalogue stars match."""

_MAX_STARS_IN_GATE = 5.0
"""Maximum expected number of catalogue stars in the smallest gate of an exposure for which gates are applied."""


@dataclass(frozen=True)
class Candidates:
    """Candidate stars of k detections.

    Attributes:
        rows: catalogue rows of the stars in the field, shape (c,).
        is_match: True if a detection may be a star of the field, shape (k, c).
        nearest: angle from the predicted direction of each unmatched detection to the nearest star in the field, rad,
            shape (k,). The angle is infinite without a star in the field, and meaningless for a matched detection.
    """

    rows: NDArray[np.int64]
    is_match: NDArray[np.bool_]
    nearest: FloatArray


def find_candidates(
    directions_s: FloatArray,
    sigma: FloatArray,
    magnitude: FloatArray,
    smear_s: FloatArray | None,
    prior: StarPrior,
    local_sky: LocalSky,
    masks: SensorMasks | None = None,
) -> Candidates:
    """Return the catalogue stars within the gates of detections.

    If the prior is so wide that each gate contains too many stars, all stars in the field are candidates of all
    detections, and ``nearest`` is infinite.

    Args:
        directions_s: directions of the detections, unit vectors in the sensor frame, shape (k, 3).
        sigma: standard deviation of each direction, rad per axis, shape (k,).
        magnitude: measured magnitudes, shape (k,); NaN where unknown.
        smear_s: covariance of the errors due to motion during the exposure, rad², shape (k, 3, 3); None without motion.
        prior: attitude of the sensor.
        local_sky: the sky at the exposure; it also defines which catalogue stars are bright enough.
        masks: deck masks in the sensor's view; None without masks. A masked star is no candidate. A masked detection
            has no candidates, except with so wide a prior.
    """
    rows, catalogue = _rows_in_field(directions_s, prior, local_sky), local_sky.bright.catalogue
    apparent = local_sky.apparent_stars(catalogue.at_j2000[rows])
    seen = apparent.visible
    if masks is not None:
        seen = seen & ~_is_masked(masks, apparent.direction_n, prior)
    rows, reference_n = rows[seen], apparent.direction_n[seen]
    seen_n = directions_s @ prior.rotation_nb.T
    variance = sigma[:, None] ** 2 + catalogue.position_sigma[rows] ** 2
    smear_n = None if smear_s is None else prior.rotation_nb @ smear_s @ prior.rotation_nb.T
    nearest = np.zeros(len(seen_n))
    if prior.is_wide and _min_stars_in_gate(seen_n, magnitude, prior, local_sky) > _MAX_STARS_IN_GATE:
        return Candidates(rows, np.ones((len(seen_n), len(rows)), dtype=bool), nearest + np.inf)
    fitting = _mahalanobis(seen_n, reference_n, variance, smear_n, prior) < chi_square_gate(GATE_PROBABILITY, 2)
    fitting &= ~(np.abs(magnitude[:, None] - catalogue.magnitude[rows]) > MAGNITUDE_TOLERANCE)
    if masks is not None:
        fitting[masks.is_hidden(directions_s)] = False
    alone = np.flatnonzero(~fitting.any(axis=1))
    nearest[alone] = np.min(angle_between(seen_n[alone, None], reference_n), axis=1, initial=np.inf)
    return Candidates(rows, fitting, nearest)


def _min_stars_in_gate(seen_n: FloatArray, magnitude: FloatArray, prior: StarPrior, local_sky: LocalSky) -> float:
    """Return the minimum over the detections of the expected number of catalogue stars in the gate."""
    turned = perpendicular_basis(seen_n) @ skew(seen_n)
    covariance = turned @ prior.covariance_n @ np.swapaxes(turned, -1, -2)
    area = np.pi * chi_square_gate(GATE_PROBABILITY, 2) * np.sqrt(np.maximum(np.linalg.det(covariance), 0.0))
    return float(np.min(area * local_sky.bright.density(magnitude, MAGNITUDE_TOLERANCE)))


def _is_masked(masks: SensorMasks, reference_n: FloatArray, prior: StarPrior) -> NDArray[np.bool_]:
    """Return True for each star that is masked for every probable error of the predicted attitude, shape (c,)."""
    return masks.is_hidden(
        reference_n @ prior.rotation_nb, _MAX_PRIOR_SIGMAS * float(np.sqrt(np.trace(prior.covariance_n)))
    )


def _rows_in_field(directions_s: FloatArray, prior: StarPrior, local_sky: LocalSky) -> NDArray[np.int64]:
    """Return the catalogue rows of the bright stars that may be in the field around the detections."""
    centre_s = np.mean(directions_s, axis=0)
    centre_s /= np.linalg.norm(centre_s)
    prior_sigma = np.sqrt(np.trace(prior.covariance_n))
    radius = np.max(angle_between(directions_s, centre_s)) + _FIELD_MARGIN + _MAX_PRIOR_SIGMAS * prior_sigma
    return local_sky.bright_rows_around(prior.rotation_nb @ centre_s, min(radius, np.pi))


def _mahalanobis(
    seen_n: FloatArray, reference_n: FloatArray, variance: FloatArray, smear_n: FloatArray | None, prior: StarPrior
) -> FloatArray:
    """Return Mahalanobis² between k detections and c candidates under the errors of prior and stars, shape (k, c)."""
    if prior.is_wide:
        return _mahalanobis_wide(seen_n, reference_n, variance, smear_n, prior)
    basis = perpendicular_basis(seen_n)
    residual = np.einsum("kij,kcj->kci", basis, reference_n - seen_n[:, None, :])
    turned = basis @ skew(seen_n)
    covariance = turned @ prior.covariance_n @ np.swapaxes(turned, -1, -2)
    if smear_n is not None:
        covariance += basis @ smear_n @ np.swapaxes(basis, -1, -2)
    near = np.einsum("cj,kj->kc", reference_n, seen_n) > 0.0
    return np.where(
        near, mahalanobis_squared(residual, covariance[:, None] + variance[..., None, None] * np.eye(2)), np.inf
    )


def _mahalanobis_wide(
    seen_n: FloatArray, reference_n: FloatArray, variance: FloatArray, smear_n: FloatArray | None, prior: StarPrior
) -> FloatArray:
    """Return :func:`_mahalanobis` for a wide prior.

    The sum of two terms is minimised over all rotations of the predicted attitude: Mahalanobis² of the rotation under
    the prior, and Mahalanobis² of the remaining displacement under the noise. The result is infinite if the search does
    not converge.
    """
    turn_n, squared = np.zeros((*variance.shape, 3)), np.zeros(variance.shape)
    for _ in range(_MAX_STEPS):
        moved_n = np.einsum("kcij,kj->kci", exp_rotation(turn_n), seen_n)
        basis = perpendicular_basis(moved_n)
        by_turn = -basis @ skew(moved_n) @ left_jacobian(turn_n)
        residual = np.einsum("kcij,kcj->kci", basis, reference_n - moved_n)
        residual += np.einsum("kcij,kcj->kci", by_turn, turn_n)
        cross = by_turn @ prior.covariance_n
        covariance = cross @ np.swapaxes(by_turn, -1, -2) + variance[..., None, None] * np.eye(2)
        if smear_n is not None:
            covariance += basis @ smear_n[:, None] @ np.swapaxes(basis, -1, -2)
        solution = np.linalg.solve(covariance, residual[..., None])[..., 0]
        reached_n = np.einsum("kcij,kci->kcj", cross, solution)
        converged = np.linalg.norm(reached_n - turn_n, axis=-1) < _SMALL_TURN
        turn_n, squared = reached_n, np.sum(residual * solution, axis=-1)
        if converged.all():
            break
    near = np.einsum("kci,ci->kc", moved_n, reference_n) > 0.0
    return np.where(near & converged, squared, np.inf)
