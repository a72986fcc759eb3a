"""Core of ``optical_axis`` that publishes each pointing again at the end, improved by later sightings.

The states of its filter record their last update for the smoother (Rauch, Tung and Striebel). The real-time output
equals the output of :class:`OpticalAxisCore` to the last bit. No ROS and no files are used.

:class:`AxisStatePredictor` gives the axis states at times between two sightings, and their covariance with the states
at the next sighting. The states are predicted as in :class:`CalibrationFilter`. The messages state a covariance of the
ship's error at each time. If this covariance differs much from the covariance stated at the previous sighting, part of
the old error is removed and a new error is added (:func:`ship_error_steps`). A new error may thus arise at the
requested time, and another one at the next sighting. The cross-covariance of these two errors is the largest covariance
contained in the covariances of both, reduced by the decay between the two times.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_estimation.kalman.rts_smoother import Anchor, GaussianEstimate, RtsSmoother, StateUpdate
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.mount.axes import SHIP
from ship_geometry.rotations import FloatArray
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.sky.sky_model import SkyModel
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison, Jump
from theodolite_calib.filter.model import SOURCE_AXES, ShipErrorStep, axis_state_indices, ship_error_steps
from theodolite_calib.filter.subfilters import AXIS_SOURCES
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.optical_axis.output import CorrectedAxis, PendingPointing
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.samples import EncoderSample, PointingEstimate
from theodolite_calib.samples.sighting import Sighting
from theodolite_calib.samples.tracks import ShipAt

_MAX_BATCH = 1000
"""Maximum number of pointings that are smoothed together."""

_NO_PARTS = np.empty((0, 3, 3))

AxisAnchor = Anchor[FloatArray | None]
"""Estimate after an update, with the stated covariance of the ship's error from then on, rad², shape (3, 3)."""


@dataclass(frozen=True)
class TracedCalibration(CalibrationState):
    """State with its last update.

    Attributes:
        last_update: update by the last accepted sighting or the last jump; None if there was none yet.
        is_predicted_only: False if a subfilter became the main filter since the last propagation, so that the state is
            not a prediction from the state before.
    """

    last_update: StateUpdate | None = None
    is_predicted_only: bool = True

    @property
    def prediction_input(self) -> FloatArray | None:
        """Stated covariance of the ship's error from this state on, an input of the prediction."""
        return self.ship_covariance_n


class TracedFilter(CalibrationFilter):
    """:class:`CalibrationFilter` whose states record their updates; the results are bit-identical."""

    def initial_state_from(self, mean: FloatArray, covariance_by_source: FloatArray) -> TracedCalibration:
        """See :meth:`CalibrationFilter.initial_state_from`."""
        return TracedCalibration(**vars(super().initial_state_from(mean, covariance_by_source)))

    def propagate(
        self, state: CalibrationState, time_ns: int, new_ship_covariance_n: FloatArray | None
    ) -> CalibrationState:
        """See :meth:`CalibrationFilter.propagate`."""
        return replace(
            super().propagate(state, time_ns, new_ship_covariance_n), **_trace_fields(is_predicted_only=True)
        )

    def exclude_source(self, state: CalibrationState, source: str) -> CalibrationState:
        """See :meth:`CalibrationFilter.exclude_source`."""
        return replace(super().exclude_source(state, source), **_trace_fields(is_predicted_only=False))

    def inflate_covariance(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        """See :meth:`CalibrationFilter.inflate_covariance`; the inflation is recorded as an update by a jump."""
        after = super().inflate_covariance(state, jump)
        both = GaussianEstimate(after.mean, after.covariance)
        jumped_ns = jump.time_ns if isinstance(jump, EncoderJump) else None
        return replace(after, **_trace_fields(last_update=StateUpdate(both, both, True, jumped_ns)))

    def update_by_beacons(
        self, state: CalibrationState, sighting: Sighting, comparison: Comparison
    ) -> tuple[CalibrationState, Comparison]:
        """See :meth:`CalibrationFilter.update_by_beacons`."""
        after, compared = super().update_by_beacons(state, sighting, comparison)
        return _with_update_trace(state, after), compared

    def update_by_stars(
        self, state: CalibrationState, exposure: StarExposure, measurement: LinearMeasurement, gain: FloatArray
    ) -> CalibrationState:
        """See :meth:`CalibrationFilter.update_by_stars`."""
        return _with_update_trace(state, super().update_by_stars(state, exposure, measurement, gain))


def _with_update_trace(predicted: CalibrationState, after: CalibrationState) -> CalibrationState:
    """Record the update by a sighting.

    The smoother takes no backward step over the update if an axis source is excluded or a subfilter became the main
    filter.
    """
    assert isinstance(predicted, TracedCalibration)
    is_update = predicted.is_predicted_only and not predicted.fault_state.excluded.keys() & AXIS_SOURCES
    before = GaussianEstimate(predicted.mean, predicted.covariance)
    return replace(
        after,
        **_trace_fields(last_update=StateUpdate(before, GaussianEstimate(after.mean, after.covariance), is_update)),
    )


def _trace_fields(**values: Any) -> Mapping[str, Any]:
    """Return fields of a :class:`TracedCalibration`; the base class's methods are typed for states without them."""
    return values


class _RealTimePointing(NamedTuple):
    """Pointing as published in real time.

    Attributes:
        estimate: pointing without the filter state and the covariance by source, because many pointings are stored.
        inputs: encoder reading, and ship's attitude at its time; None if the pointing is not smoothed, because it was
            unconfirmed, had an unresolved fault, was from stars alone, or is already smoothed.
    """

    estimate: PointingEstimate
    inputs: tuple[EncoderSample, ShipAt] | None


class SmoothingAxisCore(OpticalAxisCore):
    """Estimator of the main optical axis in real time, which yields all pointings again, smoothed, at the end.

    Args:
        config: parameters of the node.
        sky: sky model; None if no camera observes stars.
    """

    filter_class: ClassVar[type[CalibrationFilter]] = TracedFilter

    def __init__(self, config: OpticalAxisConfig, sky: SkyModel | None = None) -> None:
        super().__init__(config, sky, self._add_states, self._store)

    def _start_without_samples(self) -> None:
        """See :meth:`OpticalAxisCore._start_without_samples`; earlier pointings are not published again."""
        super()._start_without_samples()
        self._pending: deque[_RealTimePointing] = deque()
        self._stated_n: dict[int, FloatArray] = {}
        oldest = self._estimator.oldest_state
        assert isinstance(oldest, TracedCalibration)
        self._smoother: RtsSmoother[FloatArray | None] = RtsSmoother(self._new_predictor(), oldest)

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """See :meth:`OpticalAxisCore.reconfigure`."""
        super().reconfigure(config)
        self._smoother.predictor = self._new_predictor()

    def take_over_outputs(self, live: OpticalAxisCore) -> None:
        """See :meth:`OpticalAxisCore.take_over_outputs`; outputs of ``live`` are smoothed by its own sightings."""
        super().take_over_outputs(live)
        assert isinstance(live, SmoothingAxisCore)
        remaining = live.smooth_remaining()
        self._pending = deque(_RealTimePointing(_copy_without_state(estimate), None) for estimate in remaining)

    def smooth_remaining(self) -> Iterator[PointingEstimate]:
        """Yield all pointings again, smoothed by all sightings, in the order of their stamps.

        Pointings that are not smoothed are as in real time. No input may follow.
        """
        self._add_states(self._estimator.states_in_window())
        output = _SmoothedOutput(self.filter, self._new_predictor().state_indices)
        while self._pending:
            batch = [self._pending.popleft() for _ in range(min(len(self._pending), _MAX_BATCH))]
            known = {
                time_ns: GaussianEstimate(mean, covariance)
                for times_ns, (means, covariances) in self._smoother.take_smoothed(batch[-1].estimate.time_ns)
                for time_ns, mean, covariance in zip(times_ns, means, covariances, strict=True)
            }
            for estimate, inputs in batch:
                found = known.get(estimate.time_ns)
                yield estimate if found is None or inputs is None else output.smooth(estimate, *inputs, found)

    def _store(self, estimate: PointingEstimate, pending: PendingPointing | None) -> None:
        inputs = None
        if pending is not None and not (pending.unconfirmed_reason or _has_unresolved_fault(pending.state)):
            inputs = pending.sample, pending.ship
            if pending.ship.correlated_covariance_n is not None:
                self._stated_n[estimate.time_ns] = pending.ship.correlated_covariance_n
            self._smoother.request_time(estimate.time_ns)
        self._pending.append(_RealTimePointing(_copy_without_state(estimate), inputs))

    def _new_predictor(self) -> "AxisStatePredictor":
        return AxisStatePredictor(self.filter, self._stated_covariances_at)

    def _stated_covariances_at(self, times_ns: Sequence[int]) -> FloatArray | None:
        """Return the covariance of the ship's error that messages stated at given times; None if they stated none."""
        if times_ns[0] not in self._stated_n:
            return None
        return np.array([self._stated_n[time_ns] for time_ns in times_ns])

    def _add_states(self, states: Sequence[CalibrationState]) -> None:
        for state in states:
            assert isinstance(state, TracedCalibration)
            self._smoother.add_state(state)


class _SmoothedOutput:
    """Computes pointings from smoothed states, as :class:`PointingOutput` does from real-time states.

    Args:
        filter_: the filter.
        state_indices: indices of the smoothed states.
    """

    def __init__(self, filter_: CalibrationFilter, state_indices: NDArray[np.intp]) -> None:
        self._filter, self._state_indices = filter_, state_indices
        self._blank = filter_.initial_state_from(
            np.zeros(filter_.model.size), np.zeros_like(filter_.model.initial_covariance_by_source())
        )
        # The smoother gives no covariance by source, so the whole covariance is assigned to one source.
        self._source = filter_.model.sources.index(SOURCE_AXES)

    def smooth(
        self, real_time: PointingEstimate, sample: EncoderSample, ship: ShipAt, estimate: GaussianEstimate
    ) -> PointingEstimate:
        """Return a pointing computed from the smoothed states at its stamp."""
        separation_covariance_n = real_time.covariance_n - real_time.covariance_without_separation_n
        mean, parts = self._blank.mean.copy(), np.zeros_like(self._blank.covariance_by_source)
        mean[self._state_indices], parts[self._source, self._state_indices[:, None], self._state_indices] = estimate
        # The smoothed ship's error already has the covariance stated at that time, so no step is applied.
        state = replace(
            self._blank,
            time_ns=real_time.time_ns,
            mean=mean,
            covariance_by_source=parts,
            ship_covariance_n=ship.correlated_covariance_n,
        )
        corrected = CorrectedAxis(self._filter, state)
        axes = corrected.axes([PendingPointing(sample, ship, "", 0.0, state)])
        (rotation_nm,), (parts_n,) = axes.rotation_nm, axes.covariance_by_source_n
        covariance_without_separation_n = parts_n.sum(axis=0)
        return replace(
            real_time,
            rotation_nm=rotation_nm,
            covariance_n=covariance_without_separation_n + separation_covariance_n,
            covariance_without_separation_n=covariance_without_separation_n,
            # Without beacons the telescope's attitude is not published.
            rotation_nt=np.where(np.isfinite(real_time.rotation_nt), rotation_nm @ corrected.rotation_mt, np.nan),
            by_error_n=axes.by_error_n[0],
            rotation_dm=real_time.rotation_dm if ship.chord_nd is None else ship.chord_nd.T @ rotation_nm,
        )


def _has_unresolved_fault(state: CalibrationState) -> bool:
    """True if the last sighting was contradictory, a fault is unresolved, or a source of the axis is excluded."""
    return (
        bool(state.consecutive_rejections)
        or state.fault_state.unresolved_fault is not None
        or bool(state.fault_state.excluded.keys() & AXIS_SOURCES)
    )


def _copy_without_state(estimate: PointingEstimate) -> PointingEstimate:
    """Return a copy without state and covariance by source that shares no arrays with other pointings."""
    arrays = {name: value.copy() for name, value in vars(estimate).items() if isinstance(value, np.ndarray)}
    return replace(estimate, **(arrays | {"covariance_by_source_n": _NO_PARTS, "state": None}))


class AxisStatePredictor:
    """Predictor of the states that turn the main axis, and of the parallelism of the calibration telescope.

    Args:
        filter_: filter with its model.
        stated_n: returns the stated covariance of the ship's error at N times, rad², shape (N, 3, 3), or None if the
            messages state no covariance.

    Attributes:
        state_indices: indices of the r predicted states, shape (r,).
    """

    predicts_before_first = True
    """True: before the first sighting all errors have their prior at any time."""

    def __init__(self, filter_: CalibrationFilter, stated_n: Callable[[Sequence[int]], FloatArray | None]) -> None:
        self._model, self._ship, self._stated_n = filter_.model, filter_.ship_error, stated_n
        self.state_indices = np.concatenate([axis_state_indices(self._model), self._model.state_indices("parallelism")])
        # The ship's error comes first, both among all states and among the predicted states.
        assert self._ship.columns == SHIP

    def cross_to(self, anchor: AxisAnchor, later: AxisAnchor) -> FloatArray:
        """See :meth:`ship_estimation.kalman.rts_smoother.StatePredictor.cross_to`."""
        assert anchor.time_ns is not None
        assert later.time_ns is not None
        decay, _ = self._model.transition(max(later.time_ns - anchor.time_ns, 0) * 1e-9)
        cross: FloatArray = anchor.estimate.covariance * (decay * self._retained_until(anchor, later))
        return cross

    def estimates_at(
        self, anchor: AxisAnchor, times_ns: Sequence[int], later: AxisAnchor | None
    ) -> tuple[GaussianEstimate, FloatArray | None]:
        """Return the states in :attr:`state_indices`; see ``ship_estimation.kalman.rts_smoother.StatePredictor``."""
        moments_ns, stated_n = np.array(times_ns), self._stated_n(times_ns)
        step = None if stated_n is None else ship_error_steps(anchor.prediction_input, stated_n)
        wide = self._cross_covariance(anchor, moments_ns)
        known = _apply_step(GaussianEstimate(self._means(anchor, moments_ns), wide[:, :, self.state_indices]), step)
        if later is None:
            return known, None
        assert later.time_ns is not None
        # A time before a jump may be later than the estimate whose covariance the jump inflates.
        together_ns = np.minimum(moments_ns, later.time_ns)
        if np.any(together_ns < moments_ns):
            wide = (
                self._cross_covariance(anchor, together_ns)
                * self._decay(moments_ns - together_ns)[:, self.state_indices, None]
            )
        onward = self._decay(later.time_ns - together_ns)
        cross = wide * (onward * self._retained_until(anchor, later))[:, None, :]
        if step is not None:
            cross[:, SHIP] *= step.retained[:, :, None]
            then = self._step_to(anchor, later)
            if then is not None:
                shared_n = np.array([_common_covariance(new_n, then.added_n[0]) for new_n in step.added_n])
                cross[:, SHIP, SHIP] += shared_n * onward[:, None, SHIP]
        return known, cross

    def _means(self, anchor: AxisAnchor, times_ns: StampArray) -> FloatArray:
        """Return the expected states at N times, before any step of the ship's error, shape (N, r)."""
        mean, decay = anchor.estimate.mean, self._decay(_since_ns(anchor, times_ns))
        means: FloatArray = (decay * mean)[:, self.state_indices]
        means[:, SHIP] = self._ship.propagate(mean[SHIP], decay[:, SHIP])
        return means

    def _cross_covariance(self, anchor: AxisAnchor, times_ns: StampArray) -> FloatArray:
        """Return the covariance of the predicted states with all states at N times, before any step, (N, r, n)."""
        since_s = _since_ns(anchor, times_ns).astype(float) * 1e-9
        decay, noise = self._model.transition(since_s)
        wide: FloatArray = (
            decay[:, self.state_indices, None] * anchor.estimate.covariance[self.state_indices] * decay[:, None, :]
        )
        wide[:, np.arange(len(self.state_indices)), self.state_indices] += noise[:, self.state_indices]
        if anchor.prediction_input is not None:
            wide[:, SHIP, SHIP] += (1.0 - decay[:, 0] ** 2)[:, None, None] * anchor.prediction_input
        return wide

    def _decay(self, some_ns: StampArray) -> FloatArray:
        """Return the decay factors of all states over N times, ns, shape (N, n)."""
        return self._model.transition(some_ns.astype(float) * 1e-9)[0]

    def _step_to(self, anchor: AxisAnchor, later: AxisAnchor) -> ShipErrorStep | None:
        """Return the step of the ship's error at the next sighting, with arrays for one time (N = 1)."""
        if later.prediction_input is None:
            return None
        return ship_error_steps(anchor.prediction_input, later.prediction_input[None])

    def _retained_until(self, anchor: AxisAnchor, later: AxisAnchor) -> FloatArray:
        """Return the ratio of each state that the step at the next sighting retains, shape (n,)."""
        kept, step = np.ones(self._model.size), self._step_to(anchor, later)
        if step is not None:
            kept[SHIP] = step.retained[0]
        return kept


def _since_ns(anchor: AxisAnchor, times_ns: StampArray) -> StampArray:
    """Return the time since the anchor, ns; zero before the first sighting, when the errors have their prior."""
    if anchor.time_ns is None:
        return np.zeros_like(times_ns)
    since_ns: StampArray = np.maximum(times_ns - anchor.time_ns, 0)
    return since_ns


def _apply_step(known: GaussianEstimate, step: ShipErrorStep | None) -> GaussianEstimate:
    """Apply the steps of the ship's error at N times; the argument is changed."""
    if step is not None:
        known.mean[:, SHIP] *= step.retained
        known.covariance[:, SHIP] *= step.retained[:, :, None]
        known.covariance[:, :, SHIP] *= step.retained[:, None, :]
        known.covariance[:, SHIP, SHIP] += step.added_n
    return known


def _common_covariance(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the largest covariance within two covariances, along axes that diagonalise both, shape (3, 3).

    Example:
        >>> print(_common_covariance(np.diag([4.0, 1.0, 0.0]), np.diag([1.0, 9.0, 5.0])).round(12))
        [[1. 0. 0.]
         [0. 1. 0.]
         [0. 0. 0.]]
    """
    values, vectors = np.linalg.eigh(one + other)
    positive = values > 3.0 * np.finfo(float).eps * values[-1]
    root = vectors[:, positive] * np.sqrt(values[positive])
    to_unit = vectors[:, positive] / np.sqrt(values[positive])
    # In units of the sum, the two covariances have common axes, and their variances along each axis add up to one.
    shares, axes = np.linalg.eigh(to_unit.T @ one @ to_unit)
    along = root @ axes
    smaller: FloatArray = (along * np.clip(np.minimum(shares, 1.0 - shares), 0.0, None)) @ along.T
    return smaller
