"""Start and adoption of a second estimator in trouble.

Trouble begins when the status of an estimator is worse than its inputs allow or a source is excluded
(:class:`TroubleDetector`). Then a second estimator of the same class receives the same inputs. The second estimator
starts from the stored state (:class:`StateMemory`), or from the prior, and restarts whenever the displaced sources
change. While the first estimator shows a sign of trouble, the second is adopted on three conditions:

1. For ``confirm_s`` it has been VALID. It uses every available source that it does not exclude, at least two sources.
2. It is consistent with the stored state within :data:`MEMORY_SIGMAS`, which excludes a common rotation of all sources.
3. If the INS may have drifted so far that the stored state cannot show a common displacement of all sources, the
   sources must have moved back (:mod:`ship_estimation.recovery.displacement`).

An estimator that was not consistent for half a minute has no stored state. Then only condition 1 applies, as after a
restart of the node.

All decisions are made once a second by the timeout clock, from the inputs and their order alone.
"""

from collections import deque
from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from ship_estimation.parameters.fields import parameter
from ship_estimation.recovery.displacement import Displacements
from ship_estimation.recovery.recoverable_core import RecoverableCore, with_shifted_stamps
from ship_estimation.rejection_rules import Rejection, failure_rejection
from ship_estimation.time_order.outcome import MeasurementDecision, Outcome, Status
from ship_geometry.earth.time_scales import SECOND_NS

ENDS_AFTER_NS = 30 * SECOND_NS
"""Time without a sign of trouble after which trouble ends, ns."""

LEAST_AGE_NS = 10 * SECOND_NS
"""Minimum age, at the first sign of trouble, of a stored state, ns; a fault may act before its detection."""

BEFORE_STEP_NS = 2 * SECOND_NS
"""Minimum age, at the first sign of trouble, of the state against which displacements are measured, ns.

This age is shorter than :data:`LEAST_AGE_NS`, because a step is detected at once and the INS drifts little in two
seconds."""

MIN_CONSISTENT_NS = ENDS_AFTER_NS
"""Minimum time of consistency before a state is used, ns; an earlier state may contain a fault."""

MEMORY_SIGMAS = 3.0
"""Maximum difference of the second estimator from the stored state, standard deviations of both, each component."""

_LEAST_IN_AGREEMENT = 2
"""Minimum number of available sources, the INS included, that the second estimator does not exclude."""


@dataclass(frozen=True, kw_only=True)
class RecoveryConfig:
    """Parameters of the start and the adoption of a second estimator."""

    after_s: float = parameter(
        5.0,
        doc="time with a status worse than the inputs allow, or with an excluded source, after which a second "
        "estimator starts",
        unit="s",
        minimum=1.0,
        maximum=1e6,
    )
    confirm_s: float = parameter(
        60.0,
        doc="time for which the second estimator must be VALID with all sources before it is adopted",
        unit="s",
        minimum=10.0,
        maximum=1e6,
    )


class TroubleDetector:
    """Start and end of trouble, from signs that are checked once a second.

    Args:
        after_s: duration of uninterrupted signs after which trouble begins, s.

    Attributes:
        first_sign_ns: time of the first sign; None without a sign in the last 30 s.
        began_ns: time at which trouble began; None without trouble.

    Example:
        >>> detector = TroubleDetector(after_s=2.0)
        >>> for second, is_sign in enumerate((False, True, False, True, True, True)):
        ...     detector.update(second * SECOND_NS, is_sign)
        >>> detector.first_sign_ns // SECOND_NS, detector.began_ns // SECOND_NS
        (1, 5)
    """

    def __init__(self, after_s: float) -> None:
        self.after_ns = round(after_s * SECOND_NS)
        self.first_sign_ns: int | None = None
        self.began_ns: int | None = None
        self._lasts_since_ns: int | None = None
        self._last_sign_ns = 0

    def update(self, time_ns: int, is_sign: bool) -> None:
        """Update with a sign of trouble, or its absence, at a time."""
        if is_sign:
            if self.first_sign_ns is None:
                self.first_sign_ns = time_ns
            if self._lasts_since_ns is None:
                self._lasts_since_ns = time_ns
            self._last_sign_ns = time_ns
            if self.began_ns is None and time_ns - self._lasts_since_ns >= self.after_ns:
                self.began_ns = time_ns
            return
        self._lasts_since_ns = None
        if self.first_sign_ns is not None and time_ns - self._last_sign_ns >= ENDS_AFTER_NS:
            self.first_sign_ns = self.began_ns = None


State = TypeVar("State")


class StateMemory(Generic[State]):
    """The newest consistent state that is old enough.

    Example:
        >>> memory: StateMemory[int] = StateMemory()
        >>> for second in range(40):
        ...     memory.keep(second * SECOND_NS, second)
        >>> memory.recall(40 * SECOND_NS)
        30
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[int, State]] = deque()
        self._consistent_since_ns = 0

    def keep(self, time_ns: int, state: State) -> None:
        """Store a consistent state.

        Args:
            time_ns: present time, later than all times before.
            state: immutable state.
        """
        if not self._kept:
            self._consistent_since_ns = time_ns
        self._kept.append((time_ns, state))
        while len(self._kept) > 1 and self._kept[1][0] <= time_ns - LEAST_AGE_NS:
            self._kept.popleft()

    def recall(self, first_sign_ns: int, least_age_ns: int = LEAST_AGE_NS) -> State | None:
        """Return the newest state that is old enough at the first sign of trouble, or None.

        The result is None if no state is old enough, or if states have been stored for less than
        :data:`MIN_CONSISTENT_NS`.
        """
        if first_sign_ns - self._consistent_since_ns < MIN_CONSISTENT_NS:
            return None
        old = [state for time_ns, state in self._kept if time_ns <= first_sign_ns - least_age_ns]
        return old[-1] if old else None

    def replace_all(self, by: Callable[[State], State]) -> None:
        """Replace every stored state, after a step of the time base or a jump of the INS."""
        self._kept = deque((time_ns, by(state)) for time_ns, state in self._kept)

    def forget_newer(self, state: State | None) -> None:
        """Drop all states but a recalled state, because later states may already contain the fault."""
        self._kept = deque(kept for kept in self._kept if kept[1] is state)


class SecondEstimator:
    """A second estimator.

    Args:
        core: the estimator itself.
        is_from_memory: False if it started from the prior.

    Attributes:
        valid_since_ns: time by the timeout clock since which the estimator has been VALID each second; None if it is
            not VALID. The status is read once a second, so a DEGRADED status between two readings does not count.
        failure: rejection for an exception of the software, after which another estimator starts; None without
            exception.
    """

    def __init__(self, core: Any, is_from_memory: bool) -> None:
        self.core, self.is_from_memory = core, is_from_memory
        self.valid_since_ns: int | None = None
        self.failure: Rejection | None = None
        self._status = Status.INVALID

    def give_input(self, give: Callable[[], Outcome[Any, Any]]) -> None:
        """Give an input to the estimator and record the status of its estimates; exceptions are stored."""
        try:
            for estimate in give().estimates:
                self._status = estimate.status
        except Exception as error:
            self.failure = failure_rejection(error)

    def call(self, call: Callable[[Any], None]) -> None:
        """Call a function with the estimator; exceptions are stored."""
        try:
            call(self.core)
        except Exception as error:
            self.failure = failure_rejection(error)

    def update_status(self, waiting_ns: int) -> None:
        """Record the time since which the status is VALID; called once a second."""
        if self._status is not Status.VALID:
            self.valid_since_ns = None
        elif self.valid_since_ns is None:
            self.valid_since_ns = waiting_ns


class EstimatorRecovery:
    """Decision, once a second, whether a second estimator runs and whether it is adopted.

    Args:
        config: parameters.

    Attributes:
        candidate: the second estimator; None if no second estimator runs.
        started: number of troubles.
        adopted: number of adoptions of a second estimator.
        adopted_ns: time of the last adoption by the timeout clock, ns; None before the first.
        recovery_time_s: time from the start of trouble to the last adoption, s.
    """

    def __init__(self, config: RecoveryConfig) -> None:
        self._config = config
        self.candidate: SecondEstimator | None = None
        self._reference: Any = None
        self._before_step: Any = None
        self.started = self.adopted = 0
        self.adopted_ns: int | None = None
        self.recovery_time_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Reset trouble and memory, because the estimator restarts or is replaced."""
        self._trouble = TroubleDetector(self._config.after_s)
        self._memory: StateMemory[Any] = StateMemory()
        self._forget_fault()

    @property
    def is_in_trouble(self) -> bool:
        """True while a second estimator is needed."""
        return self._trouble.began_ns is not None

    @property
    def displaced(self) -> dict[str, float]:
        """Sources that have moved and not moved back; see :attr:`Displacements.displaced`."""
        return self._displacements.displaced

    def record_decision(self, live: RecoverableCore[Any, Any], decision: MeasurementDecision[Any]) -> None:
        """Add the residual of a measurement against the state that was stored before the first sign of trouble."""
        if self._before_step is None or decision.revised:
            return
        for source, residual in live.consistency.memory_residuals(decision, self._before_step).items():
            self._displacements.add(source, residual)

    def update(
        self, waiting_ns: int, live: RecoverableCore[Any, Any], is_as_expected: bool, available_sources: Set[str]
    ) -> bool:
        """Update trouble, memory and candidate, once a second.

        Args:
            waiting_ns: time by the timeout clock, ns.
            live: the estimator whose outputs are published.
            is_as_expected: True if the status of ``live`` is no worse than the inputs of ``live`` allow.
            available_sources: sources with usable messages that arrived recently.

        Returns:
            True if :attr:`candidate` is to replace ``live`` now.
        """
        jumps = live.consistency.take_jumps()
        had_sign = self._trouble.first_sign_ns is not None
        was_in_trouble = self.is_in_trouble
        is_sign = not is_as_expected or not live.excluded_sources.isdisjoint(available_sources)
        self._trouble.update(waiting_ns, is_sign)
        if self._trouble.first_sign_ns is None:
            if had_sign:
                self._forget_fault()
            self._memory.replace_all(lambda state: live.consistency.propagate_memory(state, jumps) if jumps else state)
            if live.consistency.is_consistent:
                self._memory.keep(waiting_ns, live.state)
            return False
        if not had_sign:
            self._recall(waiting_ns, live)
        if self._reference is not None:
            self._reference = live.consistency.propagate_memory(self._reference, jumps)
            self._before_step = live.consistency.propagate_memory(self._before_step, jumps)
        for jump in jumps:
            self._displacements.inflate(jump.covariance_n)
        self._displacements.end_second()
        if not self.is_in_trouble:
            return False
        if not was_in_trouble:
            self.started += 1
        if self.candidate is not None:
            self.candidate.update_status(waiting_ns)
        self._choose_candidate(live)
        return is_sign and self._is_to_be_adopted(waiting_ns, live, available_sources)

    def record_adoption(self, waiting_ns: int) -> None:
        """Record that the candidate has replaced the first estimator, which ends the trouble."""
        assert self._trouble.began_ns is not None
        self.adopted += 1
        self.adopted_ns = waiting_ns
        self.recovery_time_s = (waiting_ns - self._trouble.began_ns) / SECOND_NS
        self._trouble = TroubleDetector(self._config.after_s)
        self._forget_fault()

    def step_time_base(self, step_ns: int) -> None:
        """Shift the stored states by a step of all clocks; the second estimator restarts."""
        self._memory.replace_all(lambda state: with_shifted_stamps(state, step_ns))
        self._reference = with_shifted_stamps(self._reference, step_ns)
        self._before_step = with_shifted_stamps(self._before_step, step_ns)
        self.candidate = None

    def _recall(self, waiting_ns: int, live: RecoverableCore[Any, Any]) -> None:
        """Recall the states from before the first sign of trouble."""
        self._reference, newest = self._memory.recall(waiting_ns), self._memory.recall(waiting_ns, BEFORE_STEP_NS)
        self._memory.forget_newer(self._reference)
        if self._reference is None:
            return
        # A slow fault may have affected the newer state. NaN counts as affected.
        later = live.consistency.propagate_memory(newest, ())
        difference_sigmas = live.consistency.largest_difference_sigmas(later, self._reference, is_later=True)
        has_drifted = not difference_sigmas <= MEMORY_SIGMAS
        self._before_step = self._reference if has_drifted else newest

    def _forget_fault(self) -> None:
        self._displacements = Displacements()
        self._displaced_before: Set[str] = frozenset()
        self._reference = self._before_step = None
        self.candidate = None

    def _choose_candidate(self, live: RecoverableCore[Any, Any]) -> None:
        """Start the second estimator if none runs, or restart it.

        The second estimator restarts if the displaced sources change. The restart is from the other start (memory or
        prior) if the second estimator fails, has an unresolved fault, or excludes a source that is not displaced.
        """
        displaced = frozenset(self.displaced)
        candidate = self.candidate
        if candidate is None or displaced != self._displaced_before:
            self._start(live, from_memory=True)
        elif (
            candidate.failure is not None
            or candidate.core.consistency.has_unresolved_fault
            or candidate.core.excluded_sources - displaced
        ):
            self._start(live, from_memory=not candidate.is_from_memory)
        self._displaced_before = displaced

    def _start(self, live: RecoverableCore[Any, Any], from_memory: bool) -> None:
        memory = self._reference if from_memory else None
        self.candidate = SecondEstimator(live.make_second(memory), is_from_memory=memory is not None)

    def _is_to_be_adopted(self, waiting_ns: int, live: RecoverableCore[Any, Any], available_sources: Set[str]) -> bool:
        """True if the second estimator meets all conditions of the module's docstring.

        If only condition 2 fails, another second estimator starts: from the prior instead of the stored state, or the
        reverse.
        """
        candidate = self.candidate
        if candidate is None or candidate.valid_since_ns is None:
            return False
        if waiting_ns - candidate.valid_since_ns < self._config.confirm_s * SECOND_NS:
            return False
        excluded = candidate.core.excluded_sources
        if len(available_sources - excluded) < _LEAST_IN_AGREEMENT or candidate.core.consistency.unused_sources(
            available_sources - excluded
        ):
            return False
        if self._displacements.is_undecided_by_memory:
            return False
        # NaN is inconsistent.
        core, reference = candidate.core, self._reference
        if reference is None or core.consistency.largest_difference_sigmas(core.state, reference) <= MEMORY_SIGMAS:
            return True
        self._start(live, from_memory=not candidate.is_from_memory)
        return False
