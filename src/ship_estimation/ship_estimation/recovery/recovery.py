"""A second estimator in trouble: when it starts, from what, and when it replaces the first one.

In trouble (:mod:`ship_estimation.recovery.trouble`) a second estimator of the same class receives the same inputs. It
starts from the remembered state, or from the prior, and again whenever a contradiction among the inputs begins or ends.
It is adopted where three things hold:

1. For ``confirm_s`` it has been VALID with every source that is there, but for those that it excludes itself while two
   others agree.
2. It agrees with the remembered state within :data:`MEMORY_SIGMAS`. A fault that turned all sources alike would not.
3. Where the INS may have drifted so far that the memory does not show by how much all sources together had moved, they
   have moved back (:mod:`ship_estimation.recovery.displacement`). What a source did by itself, the memory shows.

An estimator that was not undisputed for half a minute has no memory: then 1 alone decides, as after a restart of the
node.

Everything here follows from the inputs and their order, once a second of the time of waiting.
"""

from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any, Protocol

from ship_estimation.outcome import Decision, Outcome, Status
from ship_estimation.recovery.config import RecoveryConfig
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.displacements import Displacements
from ship_estimation.recovery.memory import BEFORE_STEP_NS, Memory
from ship_estimation.recovery.trouble import TroubleDetector
from ship_estimation.refusals import Refusal, failure
from ship_estimation.time_shift import with_shifted_stamps
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

MEMORY_SIGMAS = 3.0
"""The second estimator may differ from the remembered state by so many standard deviations of both, each component."""

_LEAST_IN_AGREEMENT = 2
"""Sources, the INS among them, that must agree where the second estimator excludes another one."""


class Jump(Protocol):
    """A jump that a source showed by itself."""

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of what has changed by it, as :class:`MemoryResidual` has turns, rad², shape (k, k)."""
        ...


class RecoverableCore(Protocol):
    """An estimator that a second one can replace; its states are immutable."""

    @property
    def state(self) -> Any:
        """The state now."""
        ...

    @property
    def excluded(self) -> Set[str]:
        """The sources that are excluded."""
        ...

    @property
    def is_undisputed(self) -> bool:
        """True if its state rests on measurements, no source is excluded and none contradicts another."""
        ...

    @property
    def is_contradicted(self) -> bool:
        """True if its sources contradict one another and no source is found to be faulty."""
        ...

    def make_second(self, memory: Any | None) -> Any:
        """Return another estimator of the same configuration that starts from a state; from the prior without one."""
        ...

    def take_jumps(self) -> Sequence[Jump]:
        """Return the jumps that sources showed by themselves since the last call."""
        ...

    def propagate_memory(self, memory: Any, jumps: Sequence[Any]) -> Any:
        """Return a remembered state propagated to the oldest time that measurements may still have."""
        ...

    def memory_residuals(self, decision: Any, memory: Any) -> Mapping[str, MemoryResidual]:
        """Return by source how far what was just judged is from a remembered state; nothing where nothing shows it."""
        ...

    def departure_sigmas(self, state: Any, memory: Any, is_later: bool = False) -> float:
        """Return the largest difference between a state and a remembered one, in standard deviations of both.

        A later state of the same estimator knows all that the remembered one did: then in those of the latter.
        """
        ...

    def unused_sources(self, sources: Set[str]) -> Set[str]:
        """Return those of the sources of which no measurement was used recently."""
        ...

    def take_over_outputs(self, live: Any) -> None:
        """Go on with the outputs where another estimator ends."""
        ...


class SecondEstimator:
    """A second estimator.

    Args:
        core: it.
        is_from_memory: False if it started from the prior.

    Attributes:
        valid_since_ns: time of waiting since which it has been VALID each second; None where it is not. One measurement
            that is rejected may make it DEGRADED for a moment.
        failure: why the software failed in it; None where it did not. Another one starts then.
    """

    def __init__(self, core: Any, is_from_memory: bool) -> None:
        self.core, self.is_from_memory = core, is_from_memory
        self.valid_since_ns: int | None = None
        self.failure: Refusal | None = None
        self._status = Status.INVALID

    def take(self, give: Callable[[], Outcome[Any, Any]]) -> None:
        """Give it an input, and take note of what it would have published; the outputs must not suffer by it."""
        try:
            outcome = give()
        except Exception as error:
            self.failure = failure(error)
            return
        for estimate in outcome.estimates:
            self._status = estimate.status

    def look(self, waiting_ns: int) -> None:
        """Take note of its status, once a second."""
        if self._status is not Status.VALID:
            self.valid_since_ns = None
        elif self.valid_since_ns is None:
            self.valid_since_ns = waiting_ns


class EstimatorRecovery:
    """Decides once a second whether a second estimator runs, and whether it is adopted.

    Args:
        config: parameters.

    Attributes:
        candidate: the second estimator; None where none runs.
        started: how often trouble began.
        adopted: how often a second estimator was adopted.
        took_s: time from the beginning of the last trouble that was ended so to its end, s.
    """

    def __init__(self, config: RecoveryConfig) -> None:
        self._config = config
        self.candidate: SecondEstimator | None = None
        self._reference: Any = None
        self._before_step: Any = None
        self.started = self.adopted = 0
        self.took_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget trouble and memory: the estimator starts again, or is another one."""
        self._trouble = TroubleDetector(self._config.after_s)
        self._memory: Memory[Any] = Memory()
        self._forget_fault()

    @property
    def is_in_trouble(self) -> bool:
        """True while a second estimator is wanted."""
        return self._trouble.began_ns is not None

    @property
    def displaced(self) -> dict[str, float]:
        """Sources that have moved and not moved back; see :attr:`Displacements.displaced`."""
        return self._displacements.displaced

    def note_decision(self, live: RecoverableCore, decision: Decision[Any]) -> None:
        """Measure, after a sign of trouble, how far a measurement is from what was known before it."""
        if self._before_step is None or decision.revised:
            return
        for source, residual in live.memory_residuals(decision, self._before_step).items():
            self._displacements.add(source, residual)

    def look(self, waiting_ns: int, live: RecoverableCore, is_as_expected: bool, there: Set[str]) -> bool:
        """Take stock, once a second.

        Args:
            waiting_ns: the time of waiting.
            live: the estimator whose outputs are published.
            is_as_expected: True if its status is no worse than its inputs allow.
            there: the sources whose messages can be used and arrived recently.

        Returns:
            True if :attr:`candidate` is to replace it now.
        """
        jumps = live.take_jumps()
        was_suspected = self._trouble.first_sign_ns is not None
        was_in_trouble = self.is_in_trouble
        is_sign = not is_as_expected or not live.excluded.isdisjoint(there)
        self._trouble.update(waiting_ns, is_sign)
        if self._trouble.first_sign_ns is None:
            if was_suspected:
                self._forget_fault()
            self._memory.replace_all(lambda state: live.propagate_memory(state, jumps) if jumps else state)
            if live.is_undisputed:
                self._memory.keep(waiting_ns, live.state)
            return False
        if not was_suspected:
            self._recall(waiting_ns, live)
        if self._reference is not None:
            self._reference = live.propagate_memory(self._reference, jumps)
            self._before_step = live.propagate_memory(self._before_step, jumps)
        for jump in jumps:
            self._displacements.inflate(jump.covariance_n)
        self._displacements.end_second()
        if not self.is_in_trouble:
            return False
        if not was_in_trouble:
            self.started += 1
        if self.candidate is not None:
            self.candidate.look(waiting_ns)
        self._choose_candidate(live)
        return is_sign and self._is_to_be_adopted(waiting_ns, live, there)

    def note_adoption(self, waiting_ns: int) -> None:
        """Take note that the candidate has replaced the first estimator."""
        assert self._trouble.began_ns is not None
        self.adopted += 1
        self.took_s = (waiting_ns - self._trouble.began_ns) / SECOND_NS
        self._trouble = TroubleDetector(self._config.after_s)
        self._forget_fault()

    def step_time_base(self, step_ns: int) -> None:
        """Carry what is remembered over a step of all clocks; the second estimator starts again."""
        self._memory.replace_all(lambda state: with_shifted_stamps(state, step_ns))
        self._reference = with_shifted_stamps(self._reference, step_ns)
        self._before_step = with_shifted_stamps(self._before_step, step_ns)
        self.candidate = None

    def _recall(self, waiting_ns: int, live: RecoverableCore) -> None:
        """Recall what was known before the first sign of trouble."""
        self._reference, newest = self._memory.recall(waiting_ns), self._memory.recall(waiting_ns, BEFORE_STEP_NS)
        self._memory.forget_newer(self._reference)
        if self._reference is None:
            return
        # A fault that crept in undisputed has moved the newer state. Written so that NaN has.
        later = live.propagate_memory(newest, ())
        has_crept = not live.departure_sigmas(later, self._reference, is_later=True) <= MEMORY_SIGMAS
        self._before_step = self._reference if has_crept else newest

    def _forget_fault(self) -> None:
        self._displacements = Displacements()
        self._displaced_before: Set[str] = frozenset()
        self._reference = self._before_step = None
        self.candidate = None

    def _choose_candidate(self, live: RecoverableCore) -> None:
        """Start the second estimator where none runs, or where what it rests on has changed."""
        displaced = frozenset(self.displaced)
        candidate = self.candidate
        if candidate is None or displaced != self._displaced_before:
            self._start(live, from_memory=True)
        elif candidate.failure is not None or candidate.core.is_contradicted or candidate.core.excluded - displaced:
            self._start(live, from_memory=not candidate.is_from_memory)
        self._displaced_before = displaced

    def _start(self, live: RecoverableCore, from_memory: bool) -> None:
        memory = self._reference if from_memory else None
        self.candidate = SecondEstimator(live.make_second(memory), is_from_memory=memory is not None)

    def _is_to_be_adopted(self, waiting_ns: int, live: RecoverableCore, there: Set[str]) -> bool:
        """True if the second estimator has proved itself; see the module."""
        candidate = self.candidate
        if candidate is None or candidate.valid_since_ns is None:
            return False
        if waiting_ns - candidate.valid_since_ns < self._config.confirm_s * SECOND_NS:
            return False
        excluded = candidate.core.excluded
        if len(there - excluded) < _LEAST_IN_AGREEMENT or candidate.core.unused_sources(there - excluded):
            return False
        if self._displacements.is_undecided_by_memory:
            return False
        # Written so that NaN does not agree.
        core = candidate.core
        if self._reference is None or core.departure_sigmas(core.state, self._reference) <= MEMORY_SIGMAS:
            return True
        self._start(live, from_memory=not candidate.is_from_memory)
        return False
