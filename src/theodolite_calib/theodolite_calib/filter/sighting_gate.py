"""Innovation gate for sightings, and the check of their beacons for misidentification.

Two tests apply, each with the probability of the gate. The first tests all residuals together. The second tests only
the angles between the beacons, which do not depend on the attitude of the telescope. A sighting of two or more beacons
that fails is tested for misidentification, so that the rejection contains the cause. Beacons with exchanged names are
used under the correct names. One wrong beacon among three or more is rejected.

The angle between two beacons is a check of baselines, identification and scale. If two beacons exchange names, the
angle stays and the image rotates by half a turn. Only a prior attitude or a third beacon can reveal this exchange. An
error of the principal point N' is not detected if all beacons have the same distance, because this error then shifts
all beacons equally.
"""

from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import GateConfig, chi_square_gate, normalized_error_squared
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.mount.image import Camera, Image
from ship_geometry.mount.line_of_sight import LinesOfSight, covariance_by_source
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, log_rotation
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison
from theodolite_calib.filter.telescope_attitude import (
    AttitudePrior,
    TelescopeAttitude,
    solve_attitude,
    total_covariance,
)
from theodolite_calib.samples.samples import Exposure, ExposureDecision
from theodolite_calib.samples.sighting import Sighting

_MAX_BEACONS = 4
"""Maximum number of beacons for which exchanged names are tried; the number of exchanges grows as the factorial."""
_ATTITUDE_DEGREES = 3
"""Number of residual components that an attitude of the telescope explains."""


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
    """Check of the beacons of one exposure in one order of their names.

    Attributes:
        order: the point ``order[i]`` of the image is beacon i; as named unless SWAPPED or a trial of exchanged names.
        attitude: attitude of the telescope from the beacons alone in this order.
        prior_chi2: chi-square of the difference between this attitude and the prior, 3 degrees of freedom; None without
            a prior.
        result: consistent, swapped or in conflict; CONSISTENT in a trial that is not yet checked.
    """

    order: tuple[int, ...]
    attitude: TelescopeAttitude
    prior_chi2: float | None
    result: BeaconCheckResult = BeaconCheckResult.CONSISTENT

    @property
    def chi2(self) -> float:
        """Chi-square of angles and prior; infinite without a solution."""
        chi2 = float(self.attitude.chi2) + (self.prior_chi2 or 0.0)
        return chi2 if np.isfinite(chi2) else np.inf


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
        return named_trial
    orders = permutations(range(count)) if count <= _MAX_BEACONS else ()
    trials = [_trial(image, camera, lines, order, prior) for order in orders if order != named_order]
    consistent_trials = [trial for trial in trials if _is_consistent(trial, probability)]
    # The improvement must be significant, because without a prior two beacons fit equally well in both orders.
    if len(consistent_trials) == 1 and named_trial.chi2 > consistent_trials[0].chi2 + chi_square_gate(probability, 3):
        return replace(consistent_trials[0], result=BeaconCheckResult.SWAPPED)
    angles_fit = any(_are_angles_consistent(trial.attitude, probability) for trial in [named_trial, *trials])
    is_prior_conflict = angles_fit and not consistent_trials
    result = BeaconCheckResult.PRIOR_CONFLICT if is_prior_conflict else BeaconCheckResult.CONFLICT
    return replace(named_trial, result=result)


def _trial(
    image: Image, camera: Camera, lines: LinesOfSight, order: tuple[int, ...], prior: AttitudePrior | None
) -> BeaconCheck:
    attitude = solve_attitude(image.select(order), camera, lines)
    if prior is None:
        return BeaconCheck(order, attitude, None)
    attitude_difference = log_rotation(attitude.rotation_nt @ prior.rotation_nt.T)
    chi2 = float(normalized_error_squared(attitude_difference, attitude.covariance_n + prior.covariance_n))
    return BeaconCheck(order, attitude, chi2)


def _are_angles_consistent(attitude: TelescopeAttitude, probability: float) -> bool:
    # An attitude that is not solved has the chi-square NaN, which compares as not consistent.
    return bool(attitude.chi2 <= chi_square_gate(probability, attitude.degrees))


def _is_consistent(trial: BeaconCheck, probability: float) -> bool:
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


@dataclass(frozen=True)
class SightingDecision:
    """Usable part of a sighting, or the reason of its rejection.

    Attributes:
        decision: decision about the exposure.
        sighting: sighting with the accepted beacons under their correct names; None after a rejection.
        comparison: comparison of ``sighting`` with the propagated state; None after a rejection.
    """

    decision: ExposureDecision
    sighting: Sighting | None = None
    comparison: Comparison | None = None


class SightingGate:
    """Innovation gate for sightings.

    Args:
        filter_: the filter.
        gate: probability of the gate.
    """

    def __init__(self, filter_: CalibrationFilter, gate: GateConfig) -> None:
        self._filter, self._gate = filter_, gate

    def evaluate_sighting(self, state: CalibrationState, sighting: Sighting, exposure: Exposure) -> SightingDecision:
        """Evaluate a sighting against ``state``, which is propagated to the time of the sighting."""
        comparison = self._filter.compare(state, sighting)
        if comparison is None:
            text = "a light would be behind the telescope: large error of baseline, encoders or ship's attitude"
            return SightingDecision(ExposureDecision(exposure, Reason.LIGHT_CONFLICT, text=text))
        if self._is_within_gate(comparison):
            return self._acceptance(exposure, sighting, comparison)
        if len(sighting.names) == 1:
            return SightingDecision(self._gate_rejection(exposure, sighting, comparison))
        return self._resolve_misidentification(state, sighting, exposure, comparison)

    def _is_within_gate(self, comparison: Comparison) -> bool:
        probability, components = self._gate.probability, len(comparison.measurement.residual)
        # The condition is written so that NaN fails.
        if not comparison.nis <= chi_square_gate(probability, components):
            return False
        if components == 2:
            return True
        return comparison.angles_nis <= chi_square_gate(probability, components - _ATTITUDE_DEGREES)

    def _resolve_misidentification(
        self, state: CalibrationState, sighting: Sighting, exposure: Exposure, comparison: Comparison
    ) -> SightingDecision:
        """Test two or more beacons for misidentification after their given names have failed the gate."""
        prediction, camera = comparison.prediction, self._camera(state, comparison)
        covariance_n = prediction.by_state_n @ state.covariance @ prediction.by_state_n.T
        prior = AttitudePrior(prediction.rotation_nt, {"state": covariance_n, **prediction.noise_n})
        check = check_beacons(sighting.image, camera, prediction.lines, self._gate.probability, prior)
        resolved = None
        if check.result is BeaconCheckResult.SWAPPED:
            resolved = self._try_exchanged_names(state, sighting, exposure, check.order)
        resolved = resolved or self._try_without_one(state, sighting, exposure)
        if resolved is not None:
            return resolved
        if check.result in (BeaconCheckResult.CONFLICT, BeaconCheckResult.SWAPPED):
            text = _angles_text(sighting, camera, prediction.lines)
            decision = self._decision(exposure, sighting, comparison)
            return SightingDecision(replace(decision, reason=Reason.LIGHT_CONFLICT, text=text))
        decision = self._gate_rejection(exposure, sighting, comparison)
        if not check.attitude.solved:
            return SightingDecision(decision)
        sigma = float(np.sqrt(np.max(np.diagonal(check.attitude.covariance_n))))
        telescope_dt = sighting.deck_from_telescope(check.attitude.rotation_nt), sigma
        return SightingDecision(replace(decision, telescope_dt=telescope_dt))

    def _camera(self, state: CalibrationState, comparison: Comparison) -> Camera:
        """Return the camera with the standard deviation of the focal length from the state."""
        row = self._filter.model.slices["focal_length"].start
        return replace(comparison.prediction.camera, focal_length_sigma_m=float(np.sqrt(state.covariance[row, row])))

    def _try_exchanged_names(
        self, state: CalibrationState, sighting: Sighting, exposure: Exposure, order: tuple[int, ...]
    ) -> SightingDecision | None:
        """Evaluate the sighting with exchanged names (point ``order[i]`` is beacon i); None if it fails the gate."""
        renamed = sighting.select(list(range(len(sighting.names))), list(order))
        comparison = self._filter.compare(state, renamed)
        if comparison is None or not self._is_within_gate(comparison):
            return None
        result = self._acceptance(exposure, renamed, comparison)
        exchanged = [f"{sighting.names[j]} is {name}" for name, j in zip(sighting.names, order, strict=True)]
        text = f"lights used with exchanged names, the only consistent assignment: {', '.join(exchanged)}"
        return replace(result, decision=replace(result.decision, reason=Reason.LIGHT_CONFLICT, text=text))

    def _try_without_one(
        self, state: CalibrationState, sighting: Sighting, exposure: Exposure
    ) -> SightingDecision | None:
        """Evaluate three or more beacons without each beacon in turn; return the acceptance of least NIS, or None."""
        rows = range(len(sighting.names))
        if len(rows) < 3:
            return None
        trials = []
        for row in rows:
            others = sighting.select([other for other in rows if other != row])
            comparison = self._filter.compare(state, others)
            if comparison is not None and self._is_within_gate(comparison):
                trials.append((comparison.nis, row, others, comparison))
        if not trials:
            return None
        _, row, others, comparison = min(trials, key=lambda trial: trial[:2])
        result = self._acceptance(exposure, others, comparison)
        rejection = Rejection(Reason.LIGHT_CONFLICT, "the other lights are consistent only without this one")
        decision = replace(result.decision, rejected_parts=((sighting.names[row], rejection),))
        return replace(result, decision=decision)

    def _acceptance(self, exposure: Exposure, sighting: Sighting, comparison: Comparison) -> SightingDecision:
        rotation_nt = comparison.prediction.rotation_nt
        sigma = float(np.sqrt(np.max(np.linalg.eigvalsh(comparison.covariance)))) / comparison.focal_length_m
        decision = replace(
            self._decision(exposure, sighting, comparison),
            reason=Reason.NONE,
            accepted=True,
            telescope_dt=(sighting.deck_from_telescope(rotation_nt), sigma),
        )
        return SightingDecision(decision, sighting, comparison)

    def _gate_rejection(self, exposure: Exposure, sighting: Sighting, comparison: Comparison) -> ExposureDecision:
        """Return the decision for beacons that are inconsistent with encoders and ship."""
        decision = self._decision(exposure, sighting, comparison)
        return replace(decision, text=f"NIS {decision.nis:.1f} exceeds gate {decision.gate:.1f}")

    def _decision(self, exposure: Exposure, sighting: Sighting, comparison: Comparison) -> ExposureDecision:
        """Return the decision with residuals, as a rejection by the gate that callers can change."""
        focal_m = comparison.focal_length_m
        return ExposureDecision(
            measurement=exposure,
            reason=Reason.GATE,
            components=tuple(f"{name} {axis}" for name in sighting.names for axis in ("x", "z")),
            residual=comparison.measurement.residual / focal_m,
            sigma=np.sqrt(np.diagonal(comparison.covariance)) / focal_m,
            covariance=comparison.covariance / focal_m**2,
            noise=comparison.measurement.noise / focal_m**2,
            nis=comparison.nis,
            gate=chi_square_gate(self._gate.probability, len(comparison.measurement.residual)),
        )


def _angles_text(sighting: Sighting, camera: Camera, lines: LinesOfSight) -> str:
    """Return a text about the angle between two beacons that has the largest chi² of all pairs."""
    angles = angle_residuals(sighting.image, camera, lines)
    worst = int(np.argmax(angles.chi2))
    first, second = (sighting.names[row] for row in angles.pairs[worst])
    return (
        f"angle between {first} and {second}: residual {angles.residual[worst] / ARCSEC:+.1f} arcsec, "
        f"sigma {angles.sigma[worst] / ARCSEC:.1f}: a wrong light, a wrong baseline, or exchanged names"
    )
