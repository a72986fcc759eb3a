"""One sighting in time order: predict to it, judge it, use it or hold the estimate."""

from dataclasses import replace

import numpy as np

from ship_estimation.refusals import Reason
from theodolite_calib.config.optical_axis import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, FilterState
from theodolite_calib.filter.judgement import SightingJudge
from theodolite_calib.measured.samples import Decision, Exposure
from theodolite_calib.measured.sighting import Sighting


class SightingStep:
    """The step from state to state.

    Args:
        config: the node's parameters.
        filter_: the filter of that configuration.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        self._filter, self._gate = filter_, config.gate
        self._judge = SightingJudge(filter_, config.gate)

    def __call__(self, state: FilterState, sighting: Sighting, exposure: Exposure) -> tuple[FilterState, Decision]:
        """State and decision after a sighting.

        Args:
            state: after the sighting before.
            sighting: the lights that have all they need.
            exposure: that it comes from.
        """
        predicted = self._filter.predicted(state, sighting.time_ns, sighting.ship.slow_covariance_n)
        try:
            judgement = self._judge.judge(predicted, sighting, exposure)
        except np.linalg.LinAlgError as error:
            return state, Decision(exposure, Reason.BAD_COVARIANCE, text=str(error))
        if judgement.sighting is not None and judgement.comparison is not None:
            return self._filter.used(predicted, judgement.sighting, judgement.comparison), judgement.decision
        # Not even the prediction is kept: the state stays, to the last bit, as without this sighting.
        if judgement.decision.reason is Reason.LIGHT_CONFLICT:
            return state, judgement.decision
        return self._held(state, judgement.decision)

    def _held(self, state: FilterState, decision: Decision) -> tuple[FilterState, Decision]:
        """After a run of disagreements say so and, where configured, re-open the gate."""
        run = state.refusals + 1
        reason, text = decision.reason, decision.text
        if run >= self._gate.conflict_after:
            reason = Reason.ATTITUDE_CONFLICT
            text = f"{run} refusals in a row: the lights and the encoders with the ship's attitude disagree; {text}"
        state = replace(state, refusals=run)
        if self._gate.reopen_after and run % self._gate.reopen_after == 0:
            state = replace(state, parts=state.parts * self._gate.reopen_factor)
            text += f"; gate re-opened: covariance times {self._gate.reopen_factor:g}"
        return state, replace(decision, reason=reason, text=text)
