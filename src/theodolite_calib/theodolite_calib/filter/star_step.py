"""Step of the filter by one exposure of stars.

The state is propagated to the time of the exposure and compared with the identified stars
(:mod:`theodolite_calib.filter.star_comparison`). If they pass the gate, the main filter and the subfilters are updated.
A rejection against encoders and ship counts like one of beacons: the pointing has an unresolved fault until stars or
beacons are accepted again.
"""

from dataclasses import replace

import numpy as np

from ship_attitude_star.sky.sky_watch import SkyModel
from ship_estimation.gates import chi_square_gate
from ship_estimation.refusals import Reason, Rejection, singular_covariance
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.alternatives import AXIS_SOURCES
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.filter.star_comparison import StarComparison
from theodolite_calib.filter.step import count_rejection, hypothesis_factors, separations
from theodolite_calib.filter.trust import FaultDetector
from theodolite_calib.measured.samples import ExposureDecision
from theodolite_calib.measured.star_sighting import StarSighting

_CONTRADICTS = (Reason.UNIDENTIFIED, Reason.MISIDENTIFIED)
"""Rejections that contradict the prediction: most stars match a right prediction."""


class StarStep:
    """Step from a state to the next by one exposure of stars.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        watch: sky model.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter, sky: SkyModel) -> None:
        self._filter, self._gate, self._sky = filter_, config.gate, sky
        threshold = hypothesis_factors(config.integrity, filter_.subfilters.sources).false_exclusion
        self._fault_detector = FaultDetector(config.integrity, config.gate, filter_.subfilters, threshold)
        self._turning = axis_state_indices(filter_.model)

    def __call__(self, state: CalibrationState, sighting: StarSighting) -> tuple[CalibrationState, ExposureDecision]:
        """Return state and decision after an exposure; ``state`` is that after the previous sighting."""
        after, decision = self._evaluate(state, sighting)
        return after, replace(decision, excluded=tuple(sorted(after.fault_state.excluded)))

    def _evaluate(self, state: CalibrationState, sighting: StarSighting) -> tuple[CalibrationState, ExposureDecision]:
        predicted = self._filter.predicted(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
        predicted = self._filter.unknown(predicted)
        exposure = sighting.exposure.with_pixel_dwell(state.stays.get(sighting.exposure.source))
        sighting = replace(sighting, exposure=exposure)
        try:
            found = self._filter.stars.compare(predicted.mean, predicted.covariance, sighting, self._sky)
            if not isinstance(found, Rejection):
                return self._compared(state, predicted, sighting, found)
        except np.linalg.LinAlgError:
            found = singular_covariance()
        decision = ExposureDecision(sighting.exposure, found.reason, text=found.text)
        # With encoders or ship excluded there is no prediction that stars could contradict.
        if found.reason in _CONTRADICTS and not state.fault_state.excluded & AXIS_SOURCES:
            return count_rejection(state, decision, self._gate, "stars")
        return state, decision

    def _compared(
        self, state: CalibrationState, predicted: CalibrationState, sighting: StarSighting, found: StarComparison
    ) -> tuple[CalibrationState, ExposureDecision]:
        measurement, (covariance,), (nis,) = found.measurement, found.innovations.covariance, found.innovations.nis.tolist()
        gate = chi_square_gate(self._gate.probability, len(measurement.residual))
        decision = ExposureDecision(
            measurement=sighting.exposure,
            reason=Reason.GATE,
            components=found.stars.components,
            residual=measurement.residual,
            sigma=np.sqrt(np.diagonal(covariance)),
            covariance=covariance,
            noise=measurement.noise,
            nis=nis,
            gate=gate,
            rejected_parts=found.stars.rejected,
        )
        # Written so that NaN fails.
        if not nis <= gate:
            decision = replace(decision, text=f"NIS {nis:.1f} exceeds gate {gate:.1f}")
            return count_rejection(state, decision, self._gate, "stars")
        after = self._filter.used_stars(predicted, sighting.exposure, found)
        contradiction = self._filter.stars.optics_rejection(after.mean, after.covariance, sighting)
        if contradiction is not None:
            decision = replace(decision, reason=contradiction.reason, text=contradiction.text)
            return count_rejection(state, decision, self._gate, "stars")
        alternatives = self._filter.subfilters.seen_stars(
            predicted.subfilters, measurement, predicted.mean, found.stars.rotation_jacobian, self._gate.probability
        )
        separation = separations(after, alternatives, self._turning, found.camera.rotation_ns, found.camera.turn_n)
        trust = self._fault_detector.agreed(predicted.fault_state, sighting.time_ns)
        after = replace(after, alternatives=alternatives, separation=separation, trust=trust)
        return after, replace(decision, reason=Reason.NONE, accepted=True)
