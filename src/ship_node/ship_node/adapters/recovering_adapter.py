"""Adapter with recovery: a second estimator may replace an estimator that is in trouble.

Trouble is an excluded source, or a status that is worse than the inputs allow
(:mod:`ship_estimation.recovery.recovery`). In trouble, a second estimator gets the same inputs and ticks as the first.
Once a second the adapter passes status and sources to :mod:`ship_estimation.recovery.recovery`, which decides on
starting and adopting the second estimator. While the second estimator runs, messages are processed one by one. The
filter's state is not saved while there is trouble. The diagnostics report the trouble and its cause.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any

from ship_estimation.integrity.protection_levels import alert_limit_text
from ship_estimation.recovery.recovery import EstimatorRecovery, SecondEstimator
from ship_estimation.rejection_rules import failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC
from ship_node.adapters.input_processing import PRESENCE_REASONS
from ship_node.adapters.node_adapter import NodeAdapter
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import OutputMessage

_ADOPTION_SHOWN_NS = 60 * SECOND_NS
"""Time for which an adoption is reported as new, by the timeout clock, ns."""

_Remedy = Callable[[Mapping[str, float]], str]
"""Returns the advice for the operator about sources that have moved, from source → shift, rad."""

_DECISION_PERIOD_NS = SECOND_NS
"""Period of the decisions by the timeout clock, ns."""

_RECOVERY = "recovery"
"""Name of the failed part if a second estimator cannot be started, evaluated or given an input."""

_NOT_SAVED_TEXT = "not saved: a second estimator runs, because {}; the state learned since then may be wrong"


def recovery_counts(recovery: EstimatorRecovery) -> dict[str, str]:
    """Return the number of troubles in which a second estimator was started, and the number of adoptions."""
    return {"second estimators started": str(recovery.started), "second estimators adopted": str(recovery.adopted)}


def recovery_status(
    recovery: EstimatorRecovery, excluded: Set[str], remedy: _Remedy, waiting_ns: int
) -> DiagnosticStatus:
    """Return the diagnostic status of the recovery.

    Args:
        recovery: the recovery.
        excluded: sources that the current estimator excludes.
        remedy: returns the advice for the operator.
        waiting_ns: time by the timeout clock.
    """
    values = recovery_counts(recovery)
    if recovery.adopted_ns is not None and waiting_ns - recovery.adopted_ns <= _ADOPTION_SHOWN_NS:
        values["recovered after [s]"] = f"{recovery.recovery_time_s:.0f}"
    for name, moved_rad in sorted(recovery.displaced.items()):
        values[f"{name} moved [arcsec]"] = f"{moved_rad / ARCSEC:.1f}"
    if recovery.is_in_trouble:
        text = f"a second estimator runs: {trouble_text(recovery.displaced, excluded, remedy)}"
        return DiagnosticStatus("recovery", Level.WARN, text, values)
    text = "no second estimator runs"
    if recovery.adopted:
        text += f"; the last one was adopted after {recovery.recovery_time_s:.0f} s"
    return DiagnosticStatus("recovery", Level.OK, text, values)


def trouble_text(displaced: Mapping[str, float], excluded: Set[str], remedy: _Remedy) -> str:
    """Return the cause of the trouble, with the advice for the operator; see :func:`recovery_status`."""
    if displaced:
        moved = ", ".join(f"{name} by {moved_rad / ARCSEC:.0f}″" for name, moved_rad in sorted(displaced.items()))
        return f"shifted: {moved}; {remedy(displaced)}"
    if excluded:
        return f"excluded: {', '.join(sorted(excluded))}"
    return "the output is not VALID although the inputs are good"


class RecoveringAdapter(NodeAdapter):
    """Adapter that runs a second estimator while there is trouble; see :class:`NodeAdapter`.

    Attributes:
        recovery: logic for starting and adopting the second estimator.
    """

    def __init__(self, config: Any, *rest: Any) -> None:
        self.recovery = EstimatorRecovery(config.recovery)
        self._last_decision_ns: int | None = None
        super().__init__(config, *rest)

    # -- what a node adds -----------------------------------------------------------------------------------

    @property
    @abstractmethod
    def source_timeouts_s(self) -> Mapping[str, float]:
        """Maximum age of the last usable message of a present source, s, by prefix of the source's name."""

    def sources_of_decision(self, decision: Any) -> Iterable[str]:
        """Return the sources, named as in exclusions, that a compared measurement shows to be present."""
        return (decision.measurement.source,)

    @abstractmethod
    def can_be_valid(self, present_sources: Set[str]) -> bool:
        """Return True if the output of a new estimator would be VALID with these sources."""

    @abstractmethod
    def remedy(self, displaced: Mapping[str, float]) -> str:
        """Return the advice for the operator about sources that have moved and not moved back.

        Args:
            displaced: source → shift, rad.
        """

    def before_adoption(self) -> list[OutputMessage]:
        """Return the pending outputs of the estimator that is replaced."""
        return []

    def start_from(self, saved: Any, now_ns: int) -> list[str]:
        """Reset the current estimator to a saved document; return remarks for the operator."""
        remarks: list[str] = self.core.start_from(saved, now_ns)
        self._reset_recovery()
        return remarks

    # -- inputs ---------------------------------------------------------------------------------------------

    def bind(self) -> None:
        """See :class:`NodeAdapter`; while a second estimator runs, each message goes to both estimators, one by one."""
        super().bind()
        candidate = self.recovery.candidate
        if candidate is None:
            return
        for feed in self.table(self.config, candidate.core):
            topic = feed.input.topic
            process = _process_in_both(self.feeds[topic].process, feed.process, candidate)
            self.feeds[topic] = replace(self.feeds[topic], process=process, block=None)

    def report_decision(self, decision: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """See :class:`NodeAdapter`; a compared measurement shows that its source is present."""
        if decision.reason in PRESENCE_REASONS:
            self.last_usable_ns |= dict.fromkeys(self.sources_of_decision(decision), waiting_ns)
        failed = []
        try:
            self.recovery.record_decision(self.core, decision)
        except Exception as error:
            failed = [self.report_failure(_RECOVERY, now_ns, failure_rejection(error))]
        return failed + super().report_decision(decision, now_ns, waiting_ns)

    @property
    def idle_until_ns(self) -> int:
        """See :class:`NodeAdapter`."""
        decision_ns = 0 if self._last_decision_ns is None else self._last_decision_ns + _DECISION_PERIOD_NS
        return min(super().idle_until_ns, decision_ns)

    def call_cores(self, call: Callable[[Any], None]) -> None:
        """See :class:`NodeAdapter`; also calls the second estimator, whose exceptions are stored."""
        try:
            super().call_cores(call)
        finally:
            if self.recovery.candidate is not None:
                self.recovery.candidate.call(call)

    # -- once a second --------------------------------------------------------------------------------------

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`NodeAdapter`; the second estimator is started, adopted or ended at intervals of 1 s."""
        timeout_ns = now_ns if waiting_ns is None else waiting_ns
        candidate = self.recovery.candidate
        try:
            published = super().tick(now_ns, waiting_ns)
        finally:
            if candidate is not None:
                candidate.give_input(lambda: candidate.core.tick(now_ns, timeout_ns))
        if self._last_decision_ns is None or timeout_ns - self._last_decision_ns >= _DECISION_PERIOD_NS:
            self._last_decision_ns = timeout_ns
            try:
                published += self._decide(now_ns, timeout_ns)
            except Exception as error:
                # The outputs of the current estimator are published nevertheless.
                published.append(self.report_failure(_RECOVERY, now_ns, failure_rejection(error)))
        return published

    def _decide(self, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Update the recovery; return the messages of an adoption or of a failure of the second estimator."""
        before = self.recovery.candidate
        present_sources = frozenset(
            source
            for source, arrived_ns in self.last_usable_ns.items()
            for kind, most_s in self.source_timeouts_s.items()
            if source.startswith(kind) and waiting_ns - arrived_ns <= most_s * 1e9
        )
        is_behind = self.overload_report.behind is not None
        is_good = _is_valid_or_above_limit(self.latest, self.core, self.config, self.quantities)
        is_as_expected = is_good or is_behind or not self.can_be_valid(present_sources)
        published: list[OutputMessage] = []
        if before is not None and before.failure is not None:
            published.append(self.report_failure(_RECOVERY, now_ns, before.failure))
        try:
            if self.recovery.update(waiting_ns, self.core, is_as_expected, present_sources):
                published += self._adopt(now_ns, waiting_ns)
        finally:
            if self.recovery.candidate is not before:
                self.bind()
                self.update_duplicate_publishers(self.duplicate_topics)
        return published

    def _adopt(self, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Replace the estimator by the second estimator; the outputs continue in order."""
        candidate = self.recovery.candidate
        assert candidate is not None
        self.compute_pending()
        try:
            published = self.before_adoption()
        except Exception as error:
            # The estimator that fails here is the one that is replaced.
            published = [self.report_failure(_RECOVERY, now_ns, failure_rejection(error))]
        candidate.core.take_over_outputs(self.core)
        self.core = candidate.core
        self.recovery.record_adoption(waiting_ns)
        # The published levels, conflicts and diagnoses belong to the replaced estimator.
        self.reset_reports()
        self.notices.append(f"recovered after {self.recovery.recovery_time_s:.0f} s: a second estimator was adopted")
        return published

    # -- saving, resets -------------------------------------------------------------------------------------

    @property
    def save_obstacle(self) -> str:
        """See :class:`NodeAdapter`; in trouble nothing is saved."""
        if not self.recovery.is_in_trouble:
            return ""
        return _NOT_SAVED_TEXT.format(trouble_text(self.recovery.displaced, self.core.excluded_sources, self.remedy))

    def restart(self, clock_jumped: bool) -> None:
        """See :class:`NodeAdapter`."""
        self._reset_recovery()
        super().restart(clock_jumped)

    def _reset_recovery(self) -> None:
        self.recovery.reset()
        self.last_usable_ns.clear()
        self._last_decision_ns = None
        self.bind()

    def step_time_base(self, step_ns: int, waiting_ns: int) -> None:
        """See :class:`NodeAdapter`."""
        super().step_time_base(step_ns, waiting_ns)
        self.recovery.step_time_base(step_ns)
        self.bind()


def _is_valid_or_above_limit(latest: Any, core: Any, config: Any, quantities: Sequence[str]) -> bool:
    """Return True if the last output is VALID, or DEGRADED with a level above its alert limit or without a level.

    A second estimator would not lower a protection level below its alert limit.
    """
    if latest is None or latest.status is not Status.DEGRADED or not config.integrity.alert_limit_arcsec:
        return latest is not None and latest.status is Status.VALID
    return bool(alert_limit_text(core.integrity(latest), quantities))


def _process_in_both(
    first: Callable[..., Any], second: Callable[..., Any], candidate: SecondEstimator
) -> Callable[[Any, int], Any]:
    """Return a function that passes a value to both estimators and returns the outcome of the first.

    The second estimator gets the value also if the first raises an exception.
    """

    def process(value: Any, waiting_ns: int) -> Any:
        try:
            return first(value, waiting_ns)
        finally:
            candidate.give_input(lambda: second(value, waiting_ns))

    return process
