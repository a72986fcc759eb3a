"""The adapter of all nodes: messages, ticks with periodic outputs, services, parameters.

Messages are processed in :mod:`ship_node.adapters.input_processing`. A topic's entry in the adapter's table
(:class:`ship_node.adapters.adapter.Feed`) reads a message and passes its value to the core. The health statistics
record the result. Rejections, decisions, failures and estimates become messages. The adapter of each node adds the
table, the messages of an estimate and the node's diagnostics.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

from ship_bags.errors import BadInput
from ship_bags.message_factory import MessageFactory
from ship_estimation.integrity.published_levels import PublishedLevels
from ship_estimation.parameters.schema import with_changes
from ship_estimation.rejection_rules import Reason, Rejection, failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_node.adapters.adapter import Overload, ServiceResult
from ship_node.adapters.input_processing import InputProcessing, disabled_topics, off_statuses
from ship_node.health.time_base import step_text
from ship_node.messages import common_messages
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, DiagnosticStatus
from ship_node.messages.inputs_outputs import OutputMessage, OutputTopic
from ship_node.saved_files.saved_start import SavedStart

INPUT_HEALTH_TOPIC = "input_health"
OWN_OUTPUTS = (
    OutputTopic(INPUT_HEALTH_TOPIC, "ship_msgs/msg/InputHealth"),
    OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE),
)
"""Output topics with which every node reports its state."""

_SLOW_TOPICS = "slow topics"


class NodeAdapter(InputProcessing):
    """Adapter of a node; see :class:`ship_node.adapters.adapter.Adapter` for the methods.

    Args:
        config: the node's parameters.
        core: the estimator.
        factory: makes the messages.
        estimate_messages: returns the messages of an estimate.
        saved: saved document from which the core starts; None if the node has no saved document.

    Raises:
        ParameterError: ``sources_off`` names a source that is unknown or cannot be switched off.

    Attributes:
        clock_jumps: number of times the clock went back.
    """

    config_type: ClassVar[type]
    services: ClassVar[tuple[str, ...]]
    outputs: tuple[OutputTopic, ...]
    reset_text: ClassVar[str] = "the filter was reset"
    start_warnings: tuple[str, ...] = ()

    def __init__(
        self,
        config: Any,
        core: Any,
        factory: MessageFactory,
        estimate_messages: Callable[[Any], list[OutputMessage]] = lambda _estimate: [],
        saved: SavedStart[Any] | None = None,
    ) -> None:
        super().__init__(config, core, factory, estimate_messages, saved)
        if saved is not None and saved.unreadable_reason:
            self.start_warnings = (*self.start_warnings, f"{saved.unreadable_reason}; the filter starts as configured")
        self.clock_jumps = 0

    # -- what a node adds -----------------------------------------------------------------------------------

    @abstractmethod
    def own_slow_topics(self, now_ns: int) -> list[OutputMessage]:
        """Return the node's periodic messages other than health and diagnostics."""

    @abstractmethod
    def own_statuses(self, waiting_ns: int) -> Iterable[DiagnosticStatus]:
        """Return the node's diagnostic statuses, without the statuses of the inputs."""

    def no_output(self, now_ns: int, text: str) -> Any | None:
        """Return the INVALID output of a node that is behind; None if its outputs have no such status.

        Args:
            now_ns: the node's time.
            text: the reason.
        """
        return None

    @property
    def save_obstacle(self) -> str:
        """Reason why nothing is saved now; empty if there is none."""
        return ""

    # -- called by the node runtime and the replay ----------------------------------------------------------

    @property
    def idle_until_ns(self) -> int:
        """See :class:`InputProcessing`."""
        if self.next_slow_ns is None or (self.saved is not None and self.saved.is_pending):
            return 0
        if self.saved is None:
            return self.next_slow_ns
        return min(self.next_slow_ns, self.saved.next_autosave_ns(self.config.alignment_autosave_s))

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.adapter.Adapter`; the slow topics are published once a period."""
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        if waiting_ns >= self.idle_until_ns:
            # Periodic messages describe the last output.
            self.compute_pending()
        if self.saved is not None and self.saved.is_pending:
            self.saved.start(now_ns)
        published = self.report_outcome(self.core.tick(now_ns, waiting_ns), now_ns, waiting_ns)
        published += self._invalid_while_behind(now_ns, waiting_ns)
        self._autosave(waiting_ns)
        if self.next_slow_ns is None or waiting_ns >= self.next_slow_ns:
            self.next_slow_ns = waiting_ns + round(self.config.slow_topics_period_s * SECOND_NS)
            self.update_duplicate_publishers(self.duplicates.end_timed_out(waiting_ns))
            try:
                published += self._slow_topics(now_ns, waiting_ns)
            except Exception as error:
                # An INVALID output of this tick must be published nevertheless.
                published.append(self.report_failure(_SLOW_TOPICS, now_ns, failure_rejection(error)))
        return published

    def overload(self, change: Overload, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :meth:`ship_node.adapters.adapter.Adapter.overload`; dropped messages are counted as rejected."""
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        why = self.overload_report.change(change, waiting_ns)
        published = []
        for topic, count in change.cut.items():
            text = f"{count} messages dropped: {why}"
            self.health.record_dropped(topic, count, Reason.BEHIND, text, waiting_ns)
            published.append(self.rejection_message(self.feeds[topic].source, now_ns, Rejection(Reason.BEHIND, text)))
        self.published_levels = PublishedLevels()  # earlier levels do not apply to the next output
        return published + self._invalid_while_behind(now_ns, waiting_ns)

    def clock_jumped_back(self, now_ns: int) -> list[OutputMessage]:
        """Restart at the earlier time."""
        self.clock_jumps += 1
        self.restart(clock_jumped=True)
        return []

    def clock_stepped(self, step_ns: int, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Record a step of the computer's clock; the time base steps too if the inputs follow."""
        self.time_base.note_computer_step(step_ns, waiting_ns)
        self.notices.append(f"the computer's clock stepped by {step_text(step_ns)}")
        return []

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Reset the core, or save or load the document from which it starts."""
        try:
            if name == "reset":
                self.restart(clock_jumped=False)
                return ServiceResult(True, self.reset_text)
            if self.saved is not None and name == "save_alignment":
                obstacle = self.save_obstacle
                return ServiceResult(not obstacle, obstacle or self.saved.save())
            if self.saved is None or name != "load_alignment":
                return ServiceResult(False, f"{self.node_name} has no service '{name}'")
            done = self.saved.load(now_ns)
        except BadInput as error:
            return ServiceResult(False, str(error))
        self.health.restart()
        self.conflicts.clear()
        self.innovation_report.clear()
        return ServiceResult(True, done)

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """See :meth:`ship_node.adapters.adapter.Adapter.set_parameters`."""
        config = with_changes(self.config, changes)
        self.off_topics = disabled_topics(self.feeds.values(), config.sources_off, self.required_sources)
        self.config = config
        self.call_cores(lambda core: core.reconfigure(config))
        self.bind()
        self.update_duplicate_publishers(self.duplicate_topics)

    # -- the node itself ------------------------------------------------------------------------------------

    def restart(self, clock_jumped: bool) -> None:
        """Reset the core and all that was received and published.

        Args:
            clock_jumped: True if the node's clock went back.
        """
        self.core.reset(clock_jumped)
        self.restart_streams()
        self.health.restart()
        self.time_base.restart()
        if self.saved is not None:
            self.saved.note_core_reset()
        self.reset_outputs()

    def saved_document_remarks(self) -> list[str]:
        """Return remarks on the saved document: on the start from it, and on obstacles to saving."""
        if self.saved is None:
            return []
        obstacles = dict.fromkeys([self.saved.unreadable_reason, self.saved.autosave_problem])
        return [*self.saved.messages, *filter(None, obstacles)]

    def _invalid_while_behind(self, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Return, once a second while the node is behind, the reason and the INVALID output."""
        text = self.overload_report.text_due(waiting_ns)
        if not text:
            return []
        published = [self.rejection_message(self.node_name, now_ns, Rejection(Reason.BEHIND, text))]
        invalid = self.no_output(now_ns, text)
        if invalid is not None:
            self.latest, self.pending_budget = invalid, None
            published += self._estimate_messages(invalid)
        return published

    def _autosave(self, waiting_ns: int) -> None:
        """Save the core's content once a period, while the output is VALID and no source is in conflict or excluded."""
        if self.saved is None or self.save_obstacle:
            return
        if not self.saved.is_autosave_time(waiting_ns, self.config.alignment_autosave_s):
            return
        # A source in conflict or excluded may have biased the state before its rejection.
        may_be_biased = self.conflicts or (
            self.published_levels.report is not None and self.published_levels.report.excluded
        )
        if self.latest is not None and self.latest.status is Status.VALID and not may_be_biased:
            self.saved.autosave()

    def _slow_topics(self, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        published = self.own_slow_topics(now_ns)
        self.pending_budget = None  # each budget is published once
        messages, statuses = self.health.messages_and_statuses(self.factory, now_ns, waiting_ns)
        published += [(INPUT_HEALTH_TOPIC, message) for message in messages]
        statuses += [*self.own_statuses(waiting_ns), *off_statuses(self.feeds.values(), self.off_topics)]
        statuses += [*self.time_base.statuses(waiting_ns), self.overload_report.status()]
        array = common_messages.diagnostic_array(now_ns, self.node_name, statuses)
        return [*published, (DIAGNOSTICS_TOPIC, array)]
