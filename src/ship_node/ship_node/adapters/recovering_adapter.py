"""Adapter with recovery: a second estimator may replace an estimator that is in trouble.

Trouble is an excluded source, or a status that is worse than the inputs allow
(:mod:`ship_estimation.recovery.trouble`). In trouble, a second estimator gets the same inputs and ticks as the first.
Once a second the adapter passes status and sources to :mod:`ship_estimation.recovery.recovery`, which decides on
starting and adopting the second estimator. While the second estimator runs, messages are processed one by one. The
filter's state is not saved while there is trouble.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import replace
from typing import Any

from ship_estimation.integrity.protection_levels import alert_limit_text
from ship_estimation.integrity.published_levels import PublishedLevels
from ship_estimation.recovery.recovery import EstimatorRecovery, SecondEstimator
from ship_estimation.rejections import Reason, failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_node.adapters.adapter import ServiceResult
from ship_node.adapters.batch_adapter import BatchAdapter
from ship_node.adapters.reporting_adapter import Feed
from ship_node.messages.batches import BatchOutput, PendingBatch
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.topics import OutputMessage

_DECISION_PERIOD_NS = 1_000_000_000
"""Period of the decisions by the timeout clock, ns."""

_ADOPTION_SHOWN_NS = 60_000_000_000
"""Time for which an adoption is reported as new, by the timeout clock, ns."""

PRESENCE_REASONS = frozenset({
    *(Reason.NONE, Reason.GATE, Reason.STUCK, Reason.UNITS, Reason.EXCLUDED, Reason.ATTITUDE_CONFLICT),
    *(Reason.LIGHT_CONFLICT, Reason.MISIDENTIFIED, Reason.UNIDENTIFIED, Reason.JUMP),
})  # fmt: skip
"""Reasons of decisions that follow a comparison: the compared message was usable, so its source counts as present."""

_RECOVERY = "recovery"
"""Name of the failed part if a second estimator cannot be started, evaluated or given an input."""

_NOT_SAVED_TEXT = "not saved: a second estimator runs, because {}; the state learned since then may be wrong"


class RecoveringAdapter(BatchAdapter):
    """Adapter that runs a second estimator while there is trouble; see :class:`BatchAdapter`.

    Attributes:
        recovery: logic for starting and adopting the second estimator.
    """

    def __init__(self, config: Any, *rest: Any) -> None:
        self.recovery = EstimatorRecovery(config.recovery)
        self._last_usable_ns: dict[str, int] = {}
        self._last_decision_ns: int | None = None
        self._adopted_ns: int | None = None
        super().__init__(config, *rest)

    # -- what a node adds -----------------------------------------------------------------------------------

    @property
    @abstractmethod
    def source_timeouts_s(self) -> Mapping[str, float]:
        """Maximum age of the last usable message of a present source, s, by prefix of the source's name."""

    def sources_of_message(self, feed: Feed, value: Any) -> Iterable[str]:
        """Return the sources, named as in exclusions, that a usable message shows to be present."""
        return () if feed.has_decision else (feed.source,)

    def sources_of_decision(self, decision: Any) -> Iterable[str]:
        """Return the sources that a compared measurement shows to be present."""
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
        return remarks

    # -- inputs ---------------------------------------------------------------------------------------------

    def _bind(self) -> None:
        """See :class:`ReportingAdapter`; while a second estimator runs, each input goes to both estimators."""
        super()._bind()
        candidate = self.recovery.candidate
        if candidate is None:
            return
        for feed in self.table(self.config, candidate.core):
            topic = feed.input.topic
            self.feeds[topic] = replace(
                self.feeds[topic], process=_process_in_both(self.feeds[topic].process, feed.process, candidate)
            )

    def report_input(
        self, feed: Feed, reading: ReadMessage[Any], outcome: Any, receive_ns: int, waiting_ns: int
    ) -> list[OutputMessage]:
        """See :class:`ReportingAdapter`; a usable message shows that its source is present."""
        rejection = None if outcome is None else outcome.rejection
        if outcome is not None and (rejection is None or rejection.reason in PRESENCE_REASONS):
            self._last_usable_ns |= dict.fromkeys(self.sources_of_message(feed, reading.value), waiting_ns)
        return super().report_input(feed, reading, outcome, receive_ns, waiting_ns)

    def finish_batch(self, pending: PendingBatch) -> list[BatchOutput]:
        """See :class:`BatchAdapter`."""
        self._last_usable_ns[self.feeds[pending.topic].source] = int(pending.receive_ns[-1])
        return super().finish_batch(pending)

    def report_outcome(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """See :class:`ReportingAdapter`; a compared measurement shows that its source is present."""
        for decision in outcome.decisions:
            if decision.reason in PRESENCE_REASONS:
                self._last_usable_ns |= dict.fromkeys(self.sources_of_decision(decision), waiting_ns)
        failed = self._note_decisions(outcome.decisions, now_ns)
        return failed + super().report_outcome(outcome, now_ns, waiting_ns)

    def _note_decisions(self, decisions: Iterable[Any], now_ns: int) -> list[OutputMessage]:
        """Pass decisions to the recovery; return a failure message if the recovery raises an exception."""
        try:
            for decision in decisions:
                self.recovery.record_decision(self.core, decision)
        except Exception as error:
            return [self.report_failure(_RECOVERY, now_ns, failure_rejection(error))]
        return []

    def accepts_batches(self, topic: str) -> bool:
        """See :class:`BatchAdapter`."""
        return super().accepts_batches(topic) and self.recovery.candidate is None

    @property
    def idle_until_ns(self) -> int:
        """See :class:`BatchAdapter`."""
        return min(
            super().idle_until_ns, 0 if self._last_decision_ns is None else self._last_decision_ns + _DECISION_PERIOD_NS
        )

    def _update_duplicate_publishers(self, topic: str) -> None:
        super()._update_duplicate_publishers(topic)
        candidate, feed = self.recovery.candidate, self.feeds[topic]
        if candidate is not None and not self.is_off(topic):
            candidate.core.set_duplicate_publishers(
                feed.measurement_source or feed.source, self._duplicates.text(topic)
            )

    # -- once a second --------------------------------------------------------------------------------------

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`ReportingAdapter`; the second estimator is started, adopted or ended at intervals of 1 s."""
        published = super().tick(now_ns, waiting_ns)
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        candidate = self.recovery.candidate
        if candidate is not None:
            candidate.give_input(lambda: candidate.core.tick(now_ns, waiting_ns))
        if self._last_decision_ns is None or waiting_ns - self._last_decision_ns >= _DECISION_PERIOD_NS:
            self._last_decision_ns = waiting_ns
            try:
                published += self._decide(now_ns, waiting_ns)
            except Exception as error:
                # The outputs of the current estimator are published nevertheless.
                published.append(self.report_failure(_RECOVERY, now_ns, failure_rejection(error)))
        return published

    def _decide(self, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Update the recovery; return the messages of an adoption or of a failure of the second estimator."""
        present_sources, before = self._present_sources(waiting_ns), self.recovery.candidate
        is_as_expected = (
            self._is_valid_or_above_limit() or self.behind is not None or not self.can_be_valid(present_sources)
        )
        published: list[OutputMessage] = []
        if before is not None and before.failure is not None:
            published.append(self.report_failure(_RECOVERY, now_ns, before.failure))
        if self.recovery.update(waiting_ns, self.core, is_as_expected, present_sources):
            published += self._adopt(waiting_ns)
        if self.recovery.candidate is not before:
            self._bind()
            for topic in filter(self._duplicates.text, self.feeds):
                self._update_duplicate_publishers(topic)
        return published

    def _is_valid_or_above_limit(self) -> bool:
        """Return True if the last output is VALID, or DEGRADED with a level above its alert limit or without a level.

        A second estimator would not lower a protection level below its alert limit.
        """
        latest = self.latest
        if latest is None or latest.status is not Status.DEGRADED or not self.config.integrity.alert_limit_arcsec:
            return latest is not None and latest.status is Status.VALID
        return bool(alert_limit_text(self.core.integrity(latest), self.quantities))

    def _present_sources(self, waiting_ns: int) -> frozenset[str]:
        """Return the sources with a recent usable message."""
        return frozenset(
            source
            for source, arrived_ns in self._last_usable_ns.items()
            for kind, most_s in self.source_timeouts_s.items()
            if source.startswith(kind) and waiting_ns - arrived_ns <= most_s * 1e9
        )

    def _adopt(self, waiting_ns: int) -> list[OutputMessage]:
        """Replace the estimator by the second estimator; the outputs continue in order."""
        candidate = self.recovery.candidate
        assert candidate is not None
        published = self.before_adoption()
        candidate.core.take_over_outputs(self.core)
        self.core = candidate.core
        self.recovery.record_adoption(waiting_ns)
        self._adopted_ns = waiting_ns
        # The published levels, conflicts and diagnoses belong to the replaced estimator.
        self.published_levels = PublishedLevels()
        self.conflicts.clear()
        self.innovation_report.clear()
        self.notices.append(f"recovered after {self.recovery.recovery_time_s:.0f} s: a second estimator was adopted")
        return published

    # -- services, parameters, resets -----------------------------------------------------------------------

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """See :class:`ReportingAdapter`; in trouble nothing is saved."""
        if name == "save_alignment" and self.saved is not None and self.recovery.is_in_trouble:
            return ServiceResult(False, _NOT_SAVED_TEXT.format(self._recovery_reason()))
        result = super().service(name, now_ns)
        if name == "load_alignment" and result.success:
            self._reset_recovery()
        return result

    def _autosave(self, waiting_ns: int) -> None:
        if not self.recovery.is_in_trouble:
            super()._autosave(waiting_ns)

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """See :class:`ReportingAdapter`."""
        super().set_parameters(changes)
        if self.recovery.candidate is not None:
            self.recovery.candidate.core.reconfigure(self.config)

    def _restart(self, clock_jumped: bool) -> None:
        self._reset_recovery()
        super()._restart(clock_jumped)

    def _reset_recovery(self) -> None:
        self.recovery.reset()
        self._last_usable_ns.clear()
        self._last_decision_ns = None
        self._bind()

    def _step_time_base(self, step_ns: int, waiting_ns: int) -> None:
        super()._step_time_base(step_ns, waiting_ns)
        self.recovery.step_time_base(step_ns)
        self._bind()

    # -- diagnostics ----------------------------------------------------------------------------------------

    @property
    def recovery_counts(self) -> dict[str, str]:
        """Number of troubles in which a second estimator was started, and number of adoptions, for diagnostics."""
        recovery = self.recovery
        return {"second estimators started": str(recovery.started), "second estimators adopted": str(recovery.adopted)}

    def recovery_status(self, waiting_ns: int) -> DiagnosticStatus:
        """Return the diagnostic status of the recovery."""
        recovery, values = self.recovery, self.recovery_counts
        if self._adopted_ns is not None and waiting_ns - self._adopted_ns <= _ADOPTION_SHOWN_NS:
            values["recovered after [s]"] = f"{recovery.recovery_time_s:.0f}"
        for name, moved_rad in sorted(recovery.displaced.items()):
            values[f"{name} moved [arcsec]"] = f"{moved_rad / ARCSEC:.1f}"
        if recovery.is_in_trouble:
            text = f"a second estimator runs: {self._recovery_reason()}"
            return DiagnosticStatus("recovery", Level.WARN, text, values)
        text = "no second estimator runs"
        if recovery.adopted:
            text += f"; the last one was adopted after {recovery.recovery_time_s:.0f} s"
        return DiagnosticStatus("recovery", Level.OK, text, values)

    def _recovery_reason(self) -> str:
        """Return the cause of the trouble, with the advice for the operator."""
        displaced, excluded = self.recovery.displaced, sorted(self.core.excluded_sources)
        if displaced:
            moved = ", ".join(f"{name} by {moved_rad / ARCSEC:.0f}″" for name, moved_rad in sorted(displaced.items()))
            return f"shifted: {moved}; {self.remedy(displaced)}"
        if excluded:
            return f"excluded: {', '.join(excluded)}"
        return "the output is not VALID although the inputs are good"


def _process_in_both(
    first: Callable[..., Any], second: Callable[..., Any], candidate: SecondEstimator
) -> Callable[[Any, int], Any]:
    """Return a function that passes a value to both estimators and returns the outcome of the first."""

    def process(value: Any, waiting_ns: int) -> Any:
        outcome = first(value, waiting_ns)
        candidate.give_input(lambda: second(value, waiting_ns))
        return outcome

    return process
