"""Filter step for one exposure of stars.

The state is propagated to the time of the exposure and compared with the identified stars
(:mod:`theodolite_calib.filter.star_comparison`). If the stars pass the gate of the main filter, the main filter is
updated. Each subfilter is then updated if the stars pass the gate of this subfilter. Stars that contradict encoders and
ship are counted together with rejected beacons. The pointing is then DEGRADED until stars or beacons are accepted
again.
"""

from dataclasses import replace

import numpy as np

from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.rejection_rules import Reason, Rejection, singular_covariance
from ship_stars.sky.sky_model import SkyModel
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.fault_detection import record_acceptance
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.filter.star_comparison import StarComparison
from theodolite_calib.filter.step import count_rejection, solution_separations
from theodolite_calib.filter.subfilters import AXIS_SOURCES
from theodolite_calib.samples.samples import ExposureDecision
from theodolite_calib.samples.sighting import StarSighting

_CONFLICT_REASONS = (Reason.UNIDENTIFIED, Reason.MISIDENTIFIED)
"""Reasons for which a rejection of stars contradicts the prediction: a correct prediction identifies most stars."""


class StarStep:
    """Filter step from one state to the next for one exposure of stars.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        sky: sky model.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter, sky: SkyModel) -> None:
        self._filter, self._gate, self._sky = filter_, config.gate, sky
        self._return_after_s = config.integrity.return_after_s
        self._axis_indices = axis_state_indices(filter_.model)

    def __call__(self, state: CalibrationState, sighting: StarSighting) -> tuple[CalibrationState, ExposureDecision]:
        """Return state and decision after an exposure; ``state`` is the state after the previous beacons or stars."""
        after, decision = self._evaluate(state, sighting)
        return after, replace(decision, excluded_sources=tuple(sorted(after.fault_state.excluded)))

    def _evaluate(self, state: CalibrationState, sighting: StarSighting) -> tuple[CalibrationState, ExposureDecision]:
        predicted = self._filter.propagate(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
        predicted = self._filter.add_unknown_errors(predicted)
        exposure = sighting.exposure.with_pixel_dwell(state.pixel_dwells.get(sighting.exposure.source))
        sighting = replace(sighting, exposure=exposure)
        try:
            comparison = self._filter.stars.compare(predicted.mean, predicted.covariance, sighting, self._sky)
            if not isinstance(comparison, Rejection):
                return self._gate_and_update(state, predicted, sighting, comparison)
        except np.linalg.LinAlgError:
            comparison = singular_covariance()
        decision = ExposureDecision(sighting.exposure, comparison.reason, text=comparison.text)
        # If encoders or ship are excluded, the prediction is unknown and stars cannot contradict it.
        if comparison.reason in _CONFLICT_REASONS and not state.fault_state.excluded.keys() & AXIS_SOURCES:
            return count_rejection(state, decision, self._gate, "stars")
        return state, decision

    def _gate_and_update(
        self, state: CalibrationState, predicted: CalibrationState, sighting: StarSighting, comparison: StarComparison
    ) -> tuple[CalibrationState, ExposureDecision]:
        measurement, (covariance,), (nis,) = (
            comparison.measurement,
            comparison.innovations.covariance,
            comparison.innovations.nis.tolist(),
        )
        gate = chi_square_gate(self._gate.probability, len(measurement.residual))
        decision = ExposureDecision(
            measurement=sighting.exposure,
            reason=Reason.GATE,
            components=comparison.stars.components,
            residual=measurement.residual,
            sigma=np.sqrt(np.diagonal(covariance)),
            covariance=covariance,
            noise=measurement.noise,
            nis=nis,
            gate=gate,
            rejected_parts=comparison.stars.rejected,
        )
        # The condition is written so that NaN fails.
        if not nis <= gate:
            decision = replace(decision, text=f"NIS {nis:.1f} exceeds gate {gate:.1f}")
            return count_rejection(state, decision, self._gate, "stars")
        after = self._filter.update_by_stars(predicted, sighting.exposure, comparison)
        contradiction = self._filter.stars.optics_rejection(after.mean, after.covariance, sighting)
        if contradiction is not None:
            decision = replace(decision, reason=contradiction.reason, text=contradiction.text)
            return count_rejection(state, decision, self._gate, "stars")
        subfilters = self._filter.subfilters.update_by_stars(
            predicted.subfilters,
            measurement,
            predicted.mean,
            comparison.stars.rotation_jacobian,
            self._gate.probability,
        )
        separation = solution_separations(
            after, subfilters, self._axis_indices, comparison.camera.rotation_ns, comparison.camera.by_state_n
        )
        fault_state = record_acceptance(predicted.fault_state, sighting.time_ns, self._return_after_s)
        after = replace(after, subfilters=subfilters, solution_separation=separation, fault_state=fault_state)
        return after, replace(decision, reason=Reason.NONE, accepted=True)
