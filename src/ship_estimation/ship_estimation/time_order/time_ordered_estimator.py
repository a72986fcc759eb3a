"""Time-ordered estimator, which applies measurements in the order of their stamps, and the order of its outputs.

An estimator is an :class:`EstimatorModel` (state transition by a measurement) in a :class:`TimeOrderedEstimator`, which
is independent of the kind of measurement. A measurement is processed as follows:

1. A measurement more than ``lag_s`` behind the newest data is rejected as LATE (:class:`LagWindow`). The core checks
   the lag first, and then the plausibility of the measurement. A measurement that the core rejects does not reach the
   time-ordered estimator.
2. If another measurement has the same source and stamp, it is rejected as DUPLICATE or, if the bytes differ, as
   CONFLICT. Of two conflicting measurements the one whose bytes sort first is kept. A measurement is rejected as
   OVERFLOW if too many later measurements of its source are known.
3. The measurement is inserted in the order of stamps
   (:class:`ship_estimation.time_order.time_ordered_log.TimeOrderedLog`). Later measurements are applied again. A
   decision is published again as revised if it changes between accepted and rejected. The number of repetitions is
   limited for each input and for each second; the other measurements stay pending.
4. The measurement is pending, with all measurements after it, while the model lacks data that may still arrive within
   ``lag_s``.
5. The model accepts or rejects the measurement. If the model raises an exception, the measurement is rejected as FAILED
   and the state is kept.
6. When the measurement is older than ``lag_s`` plus ``reach_ns``, no data can affect the decision any more. The
   measurement is committed, and the decision is final.

Any order of arrival within the window therefore gives the same state, to the last bit, as long as no source sends more
measurements out of order than :data:`ship_estimation.time_order.time_ordered_log.MOST_OVERTAKEN_PER_S`.

Two clocks are used for the outputs (:class:`OutputSequence`). Outputs are ordered by their stamps, the time of the
data. Timeouts are measured by the timeout clock, which is monotonic; the node runtime passes the time of this clock
(``waiting_ns``) with each input and tick. Old stamps, or a correction of the system clock, cause no timeout.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_estimation.rejection_rules import Reason, Rejection, StampConflicts, failure_rejection, resolve_same_stamp
from ship_estimation.time_order.outcome import DecisionT, Estimate, Measurement, Outcome
from ship_estimation.time_order.time_ordered_log import MOST_OVERTAKEN_PER_S, TimeOrderedLog
from ship_geometry.earth.time_scales import NEVER_NS, SECOND_NS
from ship_geometry.tracks.sample_track import OrderedSamples

State = TypeVar("State")
MeasurementT = TypeVar("MeasurementT", bound=Measurement)
Jump = TypeVar("Jump")

_MOST_AHEAD_NS = SECOND_NS // 10
"""Bound of the time by which an accepted stamp is ahead of its arrival, ns, with a factor of two as margin."""


class LagWindow:
    """Window of accepted stamps, which begins ``lag_s`` before the newest data.

    Args:
        lag_s: maximum lag of data, s.

    Attributes:
        newest_ns: latest stamp of all data.
        oldest_ns: oldest accepted stamp.
    """

    def __init__(self, lag_s: float) -> None:
        self._lag_s, self._lag_ns = lag_s, round(lag_s * SECOND_NS)
        self.newest_ns, self.oldest_ns = 0, -self._lag_ns

    def late_rejection(self, time_ns: int) -> Rejection | None:
        """Return the rejection of data with a stamp if the data are late; None otherwise."""
        if time_ns >= self.oldest_ns:
            return None
        late_s = (self.newest_ns - time_ns) / SECOND_NS
        return Rejection(Reason.LATE, f"{late_s:.3f} s behind the newest data: more than lag_s = {self._lag_s:g}")

    def advance_to(self, time_ns: int) -> None:
        """Advance the window to data with a stamp."""
        self.newest_ns = max(self.newest_ns, time_ns)
        self.oldest_ns = self.newest_ns - self._lag_ns


def is_within_lag(times_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64], lag_s: float) -> NDArray[np.bool_]:
    """True for each of N data that cannot be late, whatever other data arrive earlier, shape (N,).

    Args:
        times_ns: stamps, shape (N,).
        arrivals_ns: times of arrival by the clock that checks stamps, shape (N,).
        lag_s: maximum lag of data, s.

    Example:
        >>> is_within_lag(np.zeros(2), np.array([1_000_000_000, 1_950_000_000]), lag_s=2.0)
        array([ True, False])
    """
    in_time: NDArray[np.bool_] = times_ns >= arrivals_ns + _MOST_AHEAD_NS - round(lag_s * SECOND_NS)
    return in_time


@dataclass(frozen=True, kw_only=True)
class EstimatorModel(Generic[State, MeasurementT, DecisionT, Jump]):
    """The functions of an estimator, which do not change the state that they receive.

    Attributes:
        step: returns the state after a measurement and the decision about it. The last argument is True if the
            measurement may wait; the function then returns None if data for the measurement may still arrive.
        inflate: returns the state with the covariance inflated for a jump of a source.
        failure_decision: returns the decision about a measurement for which ``step`` raised an exception.
        until_ns: returns the stamp of the last sample that can change a decision.
        drop_before: drops the data that no measurement at or after a stamp needs; stamps increase until a reset.
        on_decision: called with each decision, repeated decisions included.
        on_commit: called with the states after committed measurements, in order.
    """

    step: Callable[[State, MeasurementT, bool], tuple[State, DecisionT] | None]
    inflate: Callable[[State, Jump], State]
    failure_decision: Callable[[MeasurementT, Rejection], DecisionT]
    until_ns: Callable[[DecisionT], int]
    drop_before: Callable[[int], None]
    on_decision: Callable[[DecisionT], None] | None = None
    on_commit: Callable[[Sequence[State]], None] | None = None


@dataclass(frozen=True)
class _CovarianceInflation(Generic[Jump]):
    """Inflation of the covariance for a jump of a source; ``failed`` is set if the inflation raised an exception."""

    time_ns: int
    jump: Jump
    failed: Rejection | None = None


class TimeOrderedEstimator(Generic[State, MeasurementT, DecisionT, Jump, Estimate]):
    """An estimator with its measurements in time order.

    Args:
        model: the functions of the estimator.
        state: state before any measurement.
        lag_s: maximum lag of a measurement, s; a measurement within this lag is applied at its own stamp.
        reach_ns: maximum time between the stamp of a measurement and the stamps of the data that may affect it, ns.

    Attributes:
        state: state after the last applied measurement.
        window: window of accepted stamps.
        stamp_conflicts: sources that sent conflicting data with the same stamp, or that have two publishers.
    """

    def __init__(
        self, model: EstimatorModel[State, MeasurementT, DecisionT, Jump], state: State, lag_s: float, reach_ns: int
    ) -> None:
        self._model = model
        self._lag_s, self._reach_ns = lag_s, reach_ns
        self.stamp_conflicts = StampConflicts()
        self.reset(state)

    def reset(self, state: State) -> None:
        """Drop all measurements and start from a state."""
        self.state = state
        self._has_inflation, self._dropped_until_ns = False, NEVER_NS
        self.window = LagWindow(self._lag_s)
        self.stamp_conflicts.reset()
        self._log: TimeOrderedLog[
            State, MeasurementT | _CovarianceInflation[Jump], DecisionT | _CovarianceInflation[Jump]
        ] = TimeOrderedLog(state)

    def add(self, measurement: MeasurementT, outcome: Outcome[DecisionT, Estimate]) -> bool:
        """Add a measurement that is not late; return False if the measurement is rejected."""
        key = measurement.time_ns, measurement.source
        known, taken = self._log.get(key), True
        if known is not None and not isinstance(known, _CovarianceInflation):
            taken, outcome.rejection = resolve_same_stamp(known, measurement)
            self.stamp_conflicts.record(measurement.source, measurement.time_ns, outcome.rejection)
        if taken and not self._log.may_overtake(key, self.window.newest_ns):
            bound = f"{MOST_OVERTAKEN_PER_S} such pairs a second are accepted"
            text = f"too many measurements arrive after later ones of their source: {bound}"
            taken, outcome.rejection = False, Rejection(Reason.OVERFLOW, text)
        if taken:
            self._log.insert(key, measurement)
            self._advance(measurement.time_ns, outcome)
        return taken

    def add_sample(
        self, source: str, track: OrderedSamples[Any], sample: Any, outcome: Outcome[DecisionT, Estimate]
    ) -> bool:
        """Add a sample that is not late to a track on which measurements depend; return False as :meth:`add` does.

        Measurements that depend on changed values of the track are applied again.
        """
        known, taken = track.get(sample.time_ns), True
        if known is not None:
            taken, outcome.rejection = resolve_same_stamp(known, sample)
            self.stamp_conflicts.record(source, sample.time_ns, outcome.rejection)
        if taken:
            changed_after_ns = track.insert(sample)
            if changed_after_ns is not None:
                self.rewind_after(changed_after_ns)
            self._advance(sample.time_ns, outcome)
        return taken

    @property
    def is_idle(self) -> bool:
        """True if no measurement is pending; then a new sample that is the newest of its track is only stored."""
        return not self._log.pending_count

    def advance_to(self, time_ns: int) -> None:
        """Advance the window to the stamp of the last sample that was appended to a track while :attr:`is_idle`."""
        self.window.advance_to(time_ns)
        self._close()

    def add_rejected(self, source: str, track: OrderedSamples[Any], sample: Any) -> None:
        """Record a conflict for a rejected sample that is not late if the track has another sample with its stamp."""
        known = track.get(sample.time_ns)
        if known is not None and self.window.late_rejection(sample.time_ns) is None:
            self.stamp_conflicts.record(source, sample.time_ns, resolve_same_stamp(known, sample)[1])

    def add_jump(self, time_ns: int, source: str, jump: Jump, changed_after_ns: int | None = None) -> None:
        """Insert an inflation of the covariance for a jump of a source, which :meth:`apply` performs.

        Args:
            time_ns: time of the jump; it may be earlier than applied measurements.
            source: source that jumped.
            jump: jump, as argument of :attr:`EstimatorModel.inflate`.
            changed_after_ns: stamp after which interpolated values of a track have changed; None without a change.
        """
        self._log.insert((time_ns, source), _CovarianceInflation(time_ns, jump))
        self._has_inflation = True
        if changed_after_ns is not None:
            self.rewind_after(changed_after_ns)

    def rewind_after(self, after_ns: int) -> None:
        """Make the first measurement that depends on samples after a stamp, and all later ones, pending again."""
        self.rewind_to_first(lambda decision: self._model.until_ns(decision) > after_ns)

    def rewind_to_first(self, affected: Callable[[DecisionT], bool]) -> None:
        """Make the first measurement whose decision is affected, and all later measurements, pending again."""
        self._log.rewind_to_first(lambda item: not isinstance(item, _CovarianceInflation) and affected(item))

    def tick(self, now_ns: int, outcome: Outcome[DecisionT, Estimate]) -> None:
        """Apply measurements that are pending because of the rate limits, without a new input."""
        if self.is_behind:
            self.apply(outcome, now_ns)

    @property
    def is_behind(self) -> bool:
        """True if measurements are to be applied again and are pending only because of the rate limits."""
        return self._log.is_behind

    def apply(self, outcome: Outcome[DecisionT, Estimate], now_ns: int | None = None) -> None:
        """Apply pending measurements as far as possible, and add new decisions to the outcome.

        A repeated decision is added as revised if it changes between accepted and rejected.

        Args:
            outcome: receives the decisions.
            now_ns: the time now, for the rate limits; None for the newest stamp.
        """
        if not self._log.pending_count:
            return
        closed_ns = self.window.oldest_ns - self._reach_ns
        now_ns = self.window.newest_ns if now_ns is None else now_ns
        decisions = self._log.apply(self._step, self._failure_decision, (closed_ns, now_ns))
        self.state = self._log.state
        for decision, previous in decisions:
            if isinstance(decision, _CovarianceInflation):
                known = isinstance(previous, _CovarianceInflation) and previous.failed is not None
                if decision.failed is not None and not known:
                    outcome.failures.append((decision.time_ns, decision.failed))
                continue
            if self._model.on_decision is not None:
                self._model.on_decision(decision)
            if previous is None:
                outcome.decisions.append(decision)
            elif not isinstance(previous, _CovarianceInflation) and previous.accepted != decision.accepted:
                outcome.decisions.append(replace(decision, revised=True))

    def _advance(self, time_ns: int, outcome: Outcome[DecisionT, Estimate]) -> None:
        """Advance the window, apply pending measurements as far as possible, and commit."""
        self.window.advance_to(time_ns)
        self.apply(outcome)
        self._close()

    def states_in_window(self) -> list[State]:
        """Return the states after the measurements that are not committed, in order."""
        return self._log.states()

    @property
    def oldest_state(self) -> State:
        """The committed state, the earliest state from which a measurement may still be applied."""
        return self._log.base

    def _close(self) -> None:
        """Commit the measurements that no data can affect any more, and drop the data that only they need."""
        closed_ns = self.window.oldest_ns - self._reach_ns
        if self._log.oldest_ns is not None and self._log.oldest_ns < closed_ns:
            closed = self._log.commit_before(closed_ns)
            if self._model.on_commit is not None:
                self._model.on_commit(closed)
        if closed_ns > self._dropped_until_ns:
            self._dropped_until_ns = closed_ns
            self._model.drop_before(closed_ns)

    def _step(
        self, state: State, item: MeasurementT | _CovarianceInflation[Jump]
    ) -> tuple[State, DecisionT | _CovarianceInflation[Jump]] | None:
        if isinstance(item, _CovarianceInflation):
            return self._model.inflate(state, item.jump), item
        return self._model.step(state, item, item.time_ns >= self.window.oldest_ns)

    def _failure_decision(
        self, item: MeasurementT | _CovarianceInflation[Jump], error: Exception
    ) -> DecisionT | _CovarianceInflation[Jump]:
        why = failure_rejection(error)
        return (
            replace(item, failed=why)
            if isinstance(item, _CovarianceInflation)
            else self._model.failure_decision(item, why)
        )

    @property
    def state_now(self) -> State:
        """State for outputs: :attr:`state`, with the covariance inflated also for jumps that are still pending."""
        if not (self._has_inflation and self._log.pending_count):
            return self.state
        pending = [item for item in self._log.pending_measurements() if isinstance(item, _CovarianceInflation)]
        return functools.reduce(lambda state, item: self._model.inflate(state, item.jump), pending, self.state)


class OutputSequence:
    """The sequence of an estimator's published outputs: their stamps increase, and INVALID follows after a timeout."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Restart the sequence after a clock jump: the next output may have an earlier stamp."""
        self._last_ns: int | None = None
        self._timeout_ns: int | None = None
        self._invalid_reported_ns: int | None = None

    def step_time_base(self, step_ns: int) -> None:
        """Shift the last stamp, because all clocks were stepped; outputs stay in order."""
        if self._last_ns is not None:
            self._last_ns += step_ns

    def continue_from(self, before: "OutputSequence") -> None:
        """Continue the sequence of another estimator; own outputs so far were not published."""
        self._last_ns, self._timeout_ns = before._last_ns, before._timeout_ns
        self._invalid_reported_ns = before._invalid_reported_ns

    def can_publish(self, time_ns: int) -> bool:
        """True if an output with a stamp may be published, because the stamp is later than all stamps before."""
        return self._last_ns is None or time_ns > self._last_ns

    def add(
        self,
        outcome: Outcome[Any, Estimate],
        time_ns: int,
        waiting_ns: int,
        estimate: Callable[[], Estimate | None],
        timeout_ns: int = SECOND_NS,
    ) -> None:
        """Add the estimate of a stamp to the outcome if the stamp is later than all output stamps before.

        If ``estimate`` raises an exception, a failure is reported; the next estimate is computed as usual.

        Args:
            outcome: receives the estimate.
            time_ns: the stamp.
            waiting_ns: time by the timeout clock.
            estimate: function that computes the estimate; it may return None.
            timeout_ns: time without a further output after which INVALID is reported; at least a second.
        """
        if not self.can_publish(time_ns):
            return
        try:
            found = estimate()
        except Exception as error:
            outcome.failures.append((time_ns, failure_rejection(error)))
            return
        if found is not None:
            outcome.estimates.append(found)
            self.record(time_ns, waiting_ns, timeout_ns)

    def record(self, time_ns: int, waiting_ns: int, timeout_ns: int = SECOND_NS) -> None:
        """Record the stamp and time of a published estimate; arguments as for :meth:`add`."""
        self._last_ns, self._invalid_reported_ns = time_ns, None
        self._timeout_ns = waiting_ns + max(timeout_ns, SECOND_NS)

    def report_invalid(
        self, outcome: Outcome[Any, Estimate], waiting_ns: int, make_invalid: Callable[[], Estimate]
    ) -> None:
        """Add an INVALID output, at most once a second, if no estimate was published within the timeout or at all.

        The INVALID output has the time of a tick. This output does not count for the order of outputs, so an older
        valid estimate may follow.
        """
        if self._timeout_ns is not None and waiting_ns <= self._timeout_ns:
            return
        if self._invalid_reported_ns is not None and waiting_ns - self._invalid_reported_ns < SECOND_NS:
            return
        self._invalid_reported_ns = waiting_ns
        outcome.estimates.append(make_invalid())
