"""Innovation gate for sightings and their beacons.

Two tests apply, each with the probability of the gate. The first tests all residuals together. The second tests only
the angles between the beacons, which do not depend on the attitude of the telescope. A sighting of two or more beacons
that fails is tested for misidentification (:mod:`theodolite_calib.beacon_camera.beacon_check`), so that the rejection
contains the cause. Beacons with exchanged names are used under the correct names. One wrong beacon among three or more
is rejected.
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.innovations.gates import GateConfig, chi_square_gate
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.mount.image import Camera
from ship_geometry.mount.line_of_sight import LinesOfSight
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.beacon_camera.beacon_check import BeaconCheckResult, angle_residuals, check_beacons
from theodolite_calib.beacon_camera.telescope_attitude import AttitudePrior
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison
from theodolite_calib.samples.samples import Exposure, ExposureDecision
from theodolite_calib.samples.sighting import Sighting

_ATTITUDE_DEGREES = 3
"""Number of residual components that an attitude of the telescope explains."""


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
        prior = AttitudePrior(prediction.rotation_nt, _telescope_covariance_by_source(state, comparison))
        check = check_beacons(sighting.image, camera, prediction.lines, self._gate.probability, prior)
        resolved = (
            self._try_exchanged_names(state, sighting, exposure, check.order)
            if check.result is BeaconCheckResult.SWAPPED
            else None
        )
        resolved = resolved or self._try_without_one(state, sighting, exposure)
        if resolved is not None:
            return resolved
        if check.result is BeaconCheckResult.CONFLICT or check.result is BeaconCheckResult.SWAPPED:
            text = _angles_text(sighting, camera, prediction.lines)
            decision = self._decision(exposure, sighting, comparison)
            return SightingDecision(replace(decision, reason=Reason.LIGHT_CONFLICT, text=text))
        decision = self._gate_rejection(exposure, sighting, comparison)
        if not check.attitude.solved:
            return SightingDecision(decision)
        sigma = float(np.sqrt(np.max(np.diagonal(check.attitude.covariance_n))))
        return SightingDecision(
            replace(decision, telescope_dt=(sighting.deck_from_telescope(check.attitude.rotation_nt), sigma))
        )

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
        rejected = (
            sighting.names[row],
            Rejection(Reason.LIGHT_CONFLICT, "the other lights are consistent only without this one"),
        )
        return replace(result, decision=replace(result.decision, rejected_parts=(rejected,)))

    def _acceptance(self, exposure: Exposure, sighting: Sighting, comparison: Comparison) -> SightingDecision:
        """Return the decision for a sighting that passes the gate."""
        rotation_nt = comparison.prediction.rotation_nt
        sigma = float(np.sqrt(np.max(np.linalg.eigvalsh(comparison.covariance)))) / focal_length_m(comparison)
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
        focal_m = focal_length_m(comparison)
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


def _telescope_covariance_by_source(state: CalibrationState, comparison: Comparison) -> dict[str, FloatArray]:
    """Return the covariance of the predicted telescope attitude by source, rotation vector in n, rad², (3, 3) each."""
    by_state_n = comparison.prediction.by_state_n
    return {"state": by_state_n @ state.covariance @ by_state_n.T, **comparison.prediction.noise_n}


def focal_length_m(comparison: Comparison) -> float:
    """Return the focal length used in a comparison, m."""
    return float(comparison.prediction.camera.focal_length_m)


def _angles_text(sighting: Sighting, camera: Camera, lines: LinesOfSight) -> str:
    """Return a text about the angle between two beacons that has the largest chi² of all pairs."""
    angles = angle_residuals(sighting.image, camera, lines)
    worst = int(np.argmax(angles.chi2))
    first, second = (sighting.names[row] for row in angles.pairs[worst])
    return (
        f"angle between {first} and {second}: residual {angles.residual[worst] / ARCSEC:+.1f} arcsec, "
        f"sigma {angles.sigma[worst] / ARCSEC:.1f}: a wrong light, a wrong baseline, or exchanged names"
    )
