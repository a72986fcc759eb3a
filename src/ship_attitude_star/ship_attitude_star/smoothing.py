"""Smoothing of ship attitudes: each attitude is computed again later, with later measurements.

The real-time attitudes of :class:`SmoothingCore` are bit-identical to those of :class:`ShipAttitudeCore`.
:class:`InsErrorPredictor` predicts the INS errors at times after a filter state, with their cross-covariance to the
next state.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np

from ship_attitude_star.ins_errors.process import Propagation, own_error_matrix
from ship_attitude_star.ship_attitude.config import GRAVITY, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.model import INS
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.fault_detection.exclusion import with_changes
from ship_estimation.kalman.kalman_filter import propagate_correlated_error
from ship_estimation.kalman.rts_smoother import Anchor, GaussianEstimate, RtsSmoother, StateUpdate
from ship_estimation.plausibility.checked_ins import InsChange
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import InterpolatedAttitude, PropagatedBlock
from ship_stars.attitude_samples import AttitudeEstimate
from ship_stars.sky.sky_model import SkyModel

_ATTITUDE, _TIME_OFFSET = slice(0, 3), 3
"""Indices of the attitude error (north, up, east) and of the INS time offset among the output quantities."""

_BATCH_SIZE = 1000
"""Number of attitudes that are smoothed together at the end."""

_NO_PARTS = np.empty((0, 3, 3))

ShipAnchor = Anchor[LocalVertical | None]
"""Estimate with the vertical at its time; the vertical is None if the filter does not need it."""


class _RealTimeEstimate(NamedTuple):
    """A real-time attitude.

    Attributes:
        estimate: the attitude without filter state and covariance by error source, to save memory.
        separation_covariance_n: covariance added for solution separations, rad², shape (3, 3); None if none is added.
        has_fault: True for an unresolved fault or an excluded INS; such an attitude is not smoothed.
    """

    estimate: AttitudeEstimate
    separation_covariance_n: FloatArray | None
    has_fault: bool


class SmoothingCore(ShipAttitudeCore):
    """Estimator of the ship attitude, in real time and smoothed.

    Args:
        config: parameters of the node.
        sky_model: sky model; None if no sensor needs it.
        lag_s: delay of a smoothed attitude after its stamp, s; None to smooth only at the end
            (:meth:`smooth_remaining`). The delay is longer if measurements up to the stamp are not yet final.
    """

    records_updates: ClassVar[bool] = True

    def __init__(self, config: ShipAttitudeConfig, sky_model: SkyModel | None, lag_s: float | None) -> None:
        self._lag_ns = None if lag_s is None else round(lag_s * SECOND_NS)
        self._committed: list[FilterState] = []
        self._committed_ns = 0
        self._pending: deque[_RealTimeEstimate] = deque()
        self._is_smoothing = True
        super().__init__(config, sky_model, self._record_committed, self._record_estimate)

    def _new_estimator(self, sky_model: SkyModel | None) -> ShipAttitudeCore:
        """See :meth:`ShipAttitudeCore._new_estimator`; the new core smooths only after :meth:`take_over_outputs`."""
        another = type(self)(self.config, sky_model, None if self._lag_ns is None else self._lag_ns / SECOND_NS)
        another._is_smoothing = False
        return another

    def take_over_outputs(self, live: ShipAttitudeCore) -> None:
        """See :meth:`ShipAttitudeCore.take_over_outputs`; smoothing starts a new segment."""
        super().take_over_outputs(live)
        self._is_smoothing = True
        self.restart_smoothing()

    def _start_without_samples(self) -> None:
        """See :meth:`ShipAttitudeCore._start_without_samples`; attitudes not yet smoothed are discarded."""
        super()._start_without_samples()
        self.restart_smoothing()

    def restart_smoothing(self) -> None:
        """Restart smoothing at the oldest state of the estimator; attitudes not yet smoothed are discarded."""
        self._committed.clear()
        self._pending.clear()
        self._smoother: RtsSmoother[LocalVertical | None] = RtsSmoother(
            self._new_predictor(), self._estimator.oldest_state
        )

    def reconfigure(self, config: ShipAttitudeConfig) -> None:
        """See :meth:`ShipAttitudeCore.reconfigure`."""
        super().reconfigure(config)
        self._smoother.predictor = self._new_predictor()

    def _record_committed(self, states: Sequence[FilterState]) -> None:
        """Store states that can no longer change, for the smoother."""
        if self._is_smoothing:
            self._committed.extend(states)

    def _record_estimate(self, estimate: AttitudeEstimate) -> None:
        """Store a real-time attitude, to be smoothed later."""
        if not self._is_smoothing:
            return
        has_fault = estimate.state.unresolved_fault is not None or INS in estimate.state.excluded
        separation_n = estimate.state.separation_covariance_n
        self._pending.append(_RealTimeEstimate(_copy_without_state(estimate), separation_n, has_fault))
        self._smoother.request_time(estimate.time_ns)

    def take_smoothed(self) -> list[AttitudeEstimate]:
        """Return the smoothed attitudes that are ready, in the order of their stamps; none if the lag is None."""
        self._add_states(self._committed)
        self._committed.clear()
        if self._lag_ns is None:
            return []
        return self._smoothed_until(min(self._estimator.window.newest_ns - self._lag_ns, self._committed_ns))

    def smooth_remaining(self) -> Iterator[AttitudeEstimate]:
        """Yield all remaining attitudes smoothed with all measurements; no input may follow."""
        self._add_states([*self._committed, *self._estimator.states_in_window()])
        self._committed.clear()
        while self._pending:
            last = self._pending[min(len(self._pending), _BATCH_SIZE) - 1]
            yield from self._smoothed_until(last.estimate.time_ns)

    def _apply_ins_change(self, state: FilterState, change: InsChange) -> FilterState:
        """See :meth:`ShipAttitudeCore._apply_ins_change`; the inflation is recorded as an update."""
        after = super()._apply_ins_change(state, change)
        both = GaussianEstimate(after.mean, after.covariance)
        leads_back = after.excluded.keys() <= state.excluded.keys()
        return with_changes(after, last_update=StateUpdate(both, both, leads_back, change.time_ns))

    # -- stored data ----------------------------------------------------------------------------------------

    def _drop_before(self, time_ns: int, needed_since_ns: int | None = None) -> None:
        self._committed_ns = time_ns
        oldest_pending_ns = self._pending[0].estimate.time_ns if self._pending else time_ns
        link_ns = self._smoother.newest_ns
        super()._drop_before(time_ns, min(time_ns, oldest_pending_ns, time_ns if link_ns is None else link_ns))

    def _new_predictor(self) -> "InsErrorPredictor":
        return InsErrorPredictor(self.filter, self.config.horizon == GRAVITY)

    def _add_states(self, states: Sequence[FilterState]) -> None:
        for state in states:
            self._smoother.add_state(state)

    # -- smoothed attitudes ---------------------------------------------------------------------------------

    def _smoothed_until(self, time_ns: int) -> list[AttitudeEstimate]:
        """Return the attitudes up to a time; an attitude that cannot be smoothed is as published in real time."""
        found = self._smoother.take_smoothed(time_ns)
        known = {
            moment_ns: GaussianEstimate(mean, covariance)
            for moments_ns, (means, covariances) in found
            for moment_ns, mean, covariance in zip(moments_ns, means, covariances, strict=True)
        }
        due = []
        while self._pending and self._pending[0].estimate.time_ns <= time_ns:
            due.append(self._pending.popleft())
        corrections: list[tuple[_RealTimeEstimate, GaussianEstimate, InterpolatedAttitude]] = []
        places, estimates = [], [self._as_published(pending.estimate) for pending in due]
        for place, pending in enumerate(due):
            corrects = known.get(pending.estimate.time_ns)
            ins = None if corrects is None or pending.has_fault else self._ins_at(pending.estimate.time_ns, corrects)
            if corrects is not None and ins is not None:
                places.append(place)
                corrections.append((pending, corrects, ins))
        for place, estimate in zip(places, self._correct_ins(corrections), strict=True):
            estimates[place] = estimate
        return estimates

    def _as_published(self, estimate: AttitudeEstimate) -> AttitudeEstimate:
        """Return a real-time attitude with all of its covariance assigned to the error source INS drift."""
        parts = np.zeros((len(self.filter.model.sources), 3, 3))
        parts[self.output.corrected.drift_index] = estimate.covariance_n
        return replace(estimate, covariance_by_source_n=parts)

    def _ins_at(self, time_ns: int, corrects: GaussianEstimate) -> InterpolatedAttitude | None:
        """Return the interpolated INS attitude for a time; None without samples on both sides."""
        moved_s = -(self.config.ins.time_offset_s + corrects.mean.item(_TIME_OFFSET))
        return self.ins.track.at(time_ns + round(moved_s * SECOND_NS))

    def _correct_ins(
        self, corrections: Sequence[tuple[_RealTimeEstimate, GaussianEstimate, InterpolatedAttitude]]
    ) -> list[AttitudeEstimate]:
        """Return INS attitudes that are corrected by the smoothed INS errors."""
        corrected, estimates = self.output.corrected, []
        if not corrections:
            return []
        errors = np.array([corrects.mean[_ATTITUDE] for _, corrects, _ in corrections])
        parts = np.zeros((len(corrections), len(self.filter.model.sources), _TIME_OFFSET + 1, _TIME_OFFSET + 1))
        # Smoothing gives no covariance by error source; the smoothed covariance is assigned to the INS drift.
        parts[:, corrected.drift_index] = [corrects.covariance for _, corrects, _ in corrections]
        columns = ([getattr(ins, name) for _, _, ins in corrections] for name in PropagatedBlock._fields)
        propagated = PropagatedBlock(*map(np.array, columns))
        rotations_nd, parts_n = corrected.attitudes_with_errors(propagated, errors, parts)
        for (real_time, _, ins), rotation_nd, of_source in zip(corrections, rotations_nd, parts_n, strict=True):
            covariance_without_separation_n = of_source.sum(axis=0)
            if real_time.separation_covariance_n is not None:
                of_source[corrected.drift_index] += real_time.separation_covariance_n
            estimates.append(
                replace(
                    real_time.estimate,
                    rotation_nd=rotation_nd,
                    covariance_by_source_n=of_source,
                    covariance_n=of_source.sum(axis=0),
                    covariance_without_separation_n=covariance_without_separation_n,
                    rate_d=ins.rate_d,
                )
            )
        return estimates


def _copy_without_state(estimate: AttitudeEstimate) -> AttitudeEstimate:
    """Return a copy without filter state and covariance by error source, which shares no arrays with other attitudes.

    In the copy, ``covariance_without_separation_n`` is equal to ``covariance_n``.
    """
    covariance_n = estimate.covariance_n.copy()
    return replace(
        estimate,
        rotation_nd=estimate.rotation_nd.copy(),
        covariance_by_source_n=_NO_PARTS,
        covariance_n=covariance_n,
        covariance_without_separation_n=covariance_n,
        rate_d=estimate.rate_d.copy(),
        state=None,
    )


class InsErrorPredictor:
    """Prediction of the quantities that correct the INS: attitude error (north, up, east) and time offset.

    Args:
        filter_: filter and model.
        to_gravity: True if the attitude is published relative to the gravity horizon.
    """

    def __init__(self, filter_: ShipFilter, to_gravity: bool) -> None:
        self._model, self._vertical, self._to_gravity = filter_.model, filter_.vertical, to_gravity
        attitude, rest = np.split(self._model.process_indices, [3])
        self._rows = np.concatenate([attitude, self._model.state_indices("ins.time_offset"), rest])

    @property
    def predicts_before_first(self) -> bool:
        """True if the errors can be predicted before the first measurement, as Gauss-Markov processes can."""
        return self._model.ins_process is None

    def cross_to(self, anchor: ShipAnchor, later: ShipAnchor) -> FloatArray:
        """See :meth:`ship_estimation.kalman.rts_smoother.StatePredictor.cross_to`."""
        assert later.time_ns is not None
        transition, _, _ = self._transition_to(anchor, [later.time_ns])
        cross: FloatArray = anchor.estimate.covariance @ transition[0].T
        return cross

    def estimates_at(
        self, anchor: ShipAnchor, times_ns: Sequence[int], later: ShipAnchor | None
    ) -> tuple[GaussianEstimate, FloatArray | None]:
        """Return the four quantities that correct the INS.

        See :class:`ship_estimation.kalman.rts_smoother.StatePredictor`.

        For a jump, the covariance is inflated earlier than the jump by the bound of the clock offsets. Times between
        inflation and jump are treated as the time of the inflation.
        """
        if later is not None:
            assert later.time_ns is not None
            times_ns = [min(time_ns, later.time_ns) for time_ns in times_ns]
        mean, covariance = anchor.estimate
        if anchor.time_ns is None:
            # Before the first measurement Gauss-Markov errors are stationary.
            means, covariances = np.tile(mean, (len(times_ns), 1)), np.tile(covariance, (len(times_ns), 1, 1))
        else:
            transition, means, noise = self._transition_to(anchor, times_ns)
            covariances = transition @ covariance @ np.swapaxes(transition, -1, -2) + noise
        to_output = self._output_matrix(times_ns)
        output_covariance = to_output @ covariances
        output_means = (to_output @ means[..., None])[..., 0]
        known = GaussianEstimate(output_means, output_covariance @ np.swapaxes(to_output, -1, -2))
        if later is None:
            return known, None
        assert later.time_ns is not None
        onward = self._transition_from(anchor, times_ns, later.time_ns)
        return known, output_covariance @ np.swapaxes(onward, -1, -2)

    def _transition_to(self, anchor: ShipAnchor, times_ns: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the propagation of the n states from an anchor to N times.

        Returns:
            Transition matrices (N, n, n), propagated means (N, n), and added covariance (N, n, n).
        """
        assert anchor.time_ns is not None
        model, mean = self._model, anchor.estimate.mean
        dt_s = 1e-9 * (np.array(times_ns) - anchor.time_ns).astype(float)
        decay, variance = model.transition(dt_s)
        transition, noise, means = _diagonal(decay), _diagonal(variance), decay * mean
        propagation = self._process_propagation(anchor, times_ns)
        if propagation is None:
            ins_attitude = model.slices["ins.attitude"]
            means[:, ins_attitude] = propagate_correlated_error(
                mean[ins_attitude], decay[:, ins_attitude], model.ins_attitude_block.sigma
            )
            return transition, means, noise
        assert model.ins_process is not None
        assert anchor.prediction_input is not None
        block = np.s_[:, model.process_indices[:, None], model.process_indices]
        transition[block] = propagation.transition
        noise[block] += propagation.ins_noise + propagation.deflection_noise
        of_process = model.ins_process.propagated_means(
            mean[None, model.process_indices], anchor.prediction_input, propagation
        )
        means[:, model.process_indices] = of_process[:, 0]
        return transition, means, noise

    def _transition_from(self, anchor: ShipAnchor, times_ns: Sequence[int], later_ns: int) -> FloatArray:
        """Return the transition matrices from N times after an anchor to a later time, shape (N, n, n)."""
        model = self._model
        left_s = 1e-9 * (later_ns - np.array(times_ns)).astype(float)
        onward = _diagonal(model.transition(left_s)[0])
        propagation = self._process_propagation(anchor, [*times_ns, later_ns])
        if propagation is not None:
            # The transition to the later time is the transition to each time, followed by the returned transition.
            to_each, to_later = propagation.transition[:-1], propagation.transition[-1]
            left = np.linalg.solve(np.swapaxes(to_each, -1, -2), np.broadcast_to(to_later.T, to_each.shape))
            onward[:, model.process_indices[:, None], model.process_indices] = np.swapaxes(left, -1, -2)
        return onward

    def _process_propagation(self, anchor: ShipAnchor, times_ns: Sequence[int]) -> Propagation | None:
        """Return the propagation of the INS error process; None if the model has no such process."""
        process = self._model.ins_process
        if process is None:
            return None
        assert anchor.time_ns is not None
        assert anchor.prediction_input is not None
        assert self._vertical is not None
        return process.propagation(anchor.time_ns, anchor.prediction_input, times_ns, self._vertical)

    def _output_matrix(self, times_ns: Sequence[int]) -> FloatArray:
        """Return the matrices from the states to the output quantities, shape (N, 4, n)."""
        matrix = np.zeros((len(times_ns), _TIME_OFFSET + 1, self._model.size))
        matrix[:, np.arange(_TIME_OFFSET + 1), self._rows[: _TIME_OFFSET + 1]] = 1.0
        if self._to_gravity:
            assert self._vertical is not None
            own = [own_error_matrix(self._vertical.at(time_ns)) for time_ns in times_ns]
            matrix[:, :_TIME_OFFSET, self._model.process_indices[:5]] = own
        return matrix


def _diagonal(values: FloatArray) -> FloatArray:
    """Return diagonal matrices, shape (N, n, n), with given diagonals, shape (N, n)."""
    matrices: FloatArray = values[..., None] * np.eye(values.shape[-1])
    return matrices
