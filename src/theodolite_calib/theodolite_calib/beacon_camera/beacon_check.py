"""Check of the beacons of an exposure for misidentification, by their angles and by a prior attitude.

The angle between two beacons does not depend on the attitude, so it is a check of baselines, identification and scale.
If two beacons exchange names, the angle stays and the image rotates by half a turn. Only a prior attitude or a third
beacon can reveal this exchange. An error of the principal point N' is not detected if all beacons have the same
distance, because this error then shifts all beacons equally.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import chi_square_gate, normalized_error_squared
from ship_geometry.mount.image import Camera, Image
from ship_geometry.mount.line_of_sight import LinesOfSight, covariance_by_source
from ship_geometry.rotations import FloatArray, angle_between, log_rotation
from theodolite_calib.beacon_camera.telescope_attitude import (
    AttitudePrior,
    TelescopeAttitude,
    solve_attitude,
    total_covariance,
)

_MAX_BEACONS = 4
"""Maximum number of beacons for which exchanged names are tried; the number of exchanges grows as the factorial."""


class BeaconCheckResult(Enum):
    """Result of the check of the beacons' names."""

    CONSISTENT = "consistent"
    SWAPPED = "swapped"
    """The beacons are inconsistent as named, and significantly more consistent with exactly one exchange of names."""
    CONFLICT = "conflict"
    """No order of names fits the angles, or exchanged names fit, but no single exchange fits significantly better."""
    PRIOR_CONFLICT = "prior_conflict"
    """The angles are consistent as named or with exchanged names, but the attitude then disagrees with the prior."""


@dataclass(frozen=True)
class BeaconCheck:
    """Result of the check of the beacons of one exposure.

    Attributes:
        result: consistent, swapped or in conflict.
        order: the point ``order[i]`` of the image is beacon i; as named unless SWAPPED.
        attitude: attitude of the telescope from the beacons alone in this order.
        prior_chi2: chi-square of the difference between this attitude and the prior, 3 degrees of freedom; None without
            a prior.
    """

    result: BeaconCheckResult
    order: tuple[int, ...]
    attitude: TelescopeAttitude
    prior_chi2: float | None


@dataclass(frozen=True)
class AngleResiduals:
    """Angles between beacons on the detector minus angles between their lines of sight.

    Attributes:
        pairs: indices of the two beacons of each pair, shape (P, 2).
        residual: residual of each angle, rad, shape (..., P).
        sigma: standard deviation of each residual, error of the focal length included, rad, shape (..., P).
        chi2: (residual / sigma)², one degree of freedom each, shape (..., P).
    """

    pairs: NDArray[np.intp]
    residual: FloatArray
    sigma: FloatArray
    chi2: FloatArray


def angle_residuals(image: Image, camera: Camera, lines: LinesOfSight) -> AngleResiduals:
    """Return the residuals of the angles between all pairs of N beacons."""
    count = lines.direction_n.shape[-2]
    pairs = np.array(list(combinations(range(count), 2)))
    seen_t = camera.directions(image.point_m)
    residual = _angles(seen_t, pairs) - _angles(lines.direction_n, pairs)

    by_seen = _angle_gradients(seen_t, pairs)
    by_line = _angle_gradients(lines.direction_n, pairs)
    detection = camera.direction_covariance(image.point_m, image.sigma_m)
    if image.smear_m2 is not None:
        by_point = camera.direction_by_point(image.point_m)
        detection = detection + by_point @ image.smear_m2 @ np.swapaxes(by_point, -1, -2)
    variance = np.einsum("...pix,...ixy,...piy->...p", by_seen, detection, by_seen)
    of_focal_length = np.einsum("...pix,...ix->...p", by_seen, camera.direction_by_focal_length(image.point_m))
    variance += (of_focal_length * np.asarray(camera.focal_length_sigma_m, dtype=float)[..., None]) ** 2
    rows = by_line.reshape(*by_line.shape[:-2], 3 * count)
    line_covariance = total_covariance(covariance_by_source(lines.terms))
    variance += np.einsum("...pi,...ij,...pj->...p", rows, line_covariance, rows)
    return AngleResiduals(pairs, residual, np.sqrt(variance), residual**2 / variance)


def check_beacons(
    image: Image, camera: Camera, lines: LinesOfSight, probability: float, prior: AttitudePrior | None = None
) -> BeaconCheck:
    """Check the two or more beacons of one exposure.

    Args:
        image: beacons on the detector, shape (N, 2).
        camera: geometry of the telescope.
        lines: lines of sight to the beacons of the same names, in the same order.
        probability: probability that correct beacons pass each of the two tests.
        prior: prior attitude.
    """
    count = lines.direction_n.shape[-2]
    named_order = tuple(range(count))
    named_trial = _trial(image, camera, lines, named_order, prior)
    if _is_consistent(named_trial, probability):
        return named_trial.check(BeaconCheckResult.CONSISTENT)
    exchanged_orders = (
        [order for order in permutations(range(count)) if order != named_order] if count <= _MAX_BEACONS else []
    )
    trials = [_trial(image, camera, lines, order, prior) for order in exchanged_orders]
    consistent_trials = [trial for trial in trials if _is_consistent(trial, probability)]
    # The improvement must be significant, because without a prior two beacons fit equally well in both orders.
    if len(consistent_trials) == 1 and named_trial.chi2 > consistent_trials[0].chi2 + chi_square_gate(probability, 3):
        return consistent_trials[0].check(BeaconCheckResult.SWAPPED)
    angles_fit = any(_are_angles_consistent(trial.attitude, probability) for trial in [named_trial, *trials])
    return named_trial.check(
        BeaconCheckResult.PRIOR_CONFLICT if angles_fit and not consistent_trials else BeaconCheckResult.CONFLICT
    )


@dataclass(frozen=True)
class _Trial:
    order: tuple[int, ...]
    attitude: TelescopeAttitude
    prior_chi2: float | None

    @property
    def chi2(self) -> float:
        """Chi-square of angles and prior; infinite without a solution."""
        chi2 = float(self.attitude.chi2) + (self.prior_chi2 or 0.0)
        return chi2 if np.isfinite(chi2) else np.inf

    def check(self, result: BeaconCheckResult) -> BeaconCheck:
        return BeaconCheck(result, self.order, self.attitude, self.prior_chi2)


def _trial(
    image: Image, camera: Camera, lines: LinesOfSight, order: tuple[int, ...], prior: AttitudePrior | None
) -> _Trial:
    attitude = solve_attitude(image.select(order), camera, lines)
    if prior is None:
        return _Trial(order, attitude, None)
    attitude_difference = log_rotation(attitude.rotation_nt @ prior.rotation_nt.T)
    chi2 = float(normalized_error_squared(attitude_difference, attitude.covariance_n + prior.covariance_n))
    return _Trial(order, attitude, chi2)


def _are_angles_consistent(attitude: TelescopeAttitude, probability: float) -> bool:
    # An attitude that is not solved has the chi-square NaN, which compares as not consistent.
    return bool(attitude.chi2 <= chi_square_gate(probability, attitude.degrees))


def _is_consistent(trial: _Trial, probability: float) -> bool:
    if not _are_angles_consistent(trial.attitude, probability):
        return False
    return trial.prior_chi2 is None or trial.prior_chi2 <= chi_square_gate(probability, 3)


def _angles(direction: FloatArray, pairs: NDArray[np.intp]) -> FloatArray:
    return angle_between(direction[..., pairs[:, 0], :], direction[..., pairs[:, 1], :])


def _angle_gradients(direction: FloatArray, pairs: NDArray[np.intp]) -> FloatArray:
    """Return the derivative of each pair's angle with respect to each direction, shape (..., P, N, 3)."""
    gradients = np.zeros((*direction.shape[:-2], len(pairs), *direction.shape[-2:]))
    for p, (i, j) in enumerate(pairs):
        first, second = direction[..., i, :], direction[..., j, :]
        cosine = np.sum(first * second, axis=-1, keepdims=True)
        sine = np.linalg.norm(np.cross(first, second), axis=-1, keepdims=True)
        # The gradient is along the arc, away from the other beacon; undefined for beacons in the same direction.
        sine = np.where(sine > 0.0, sine, np.nan)
        gradients[..., p, i, :] = (first * cosine - second) / sine
        gradients[..., p, j, :] = (second * cosine - first) / sine
    return gradients
