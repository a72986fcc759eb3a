"""Common adapter of all nodes: read inputs, pass them to the core, count and report the results, run periodic tasks.

A topic's entry in the adapter's table (:class:`Feed`) reads a message and passes its value to the core. The health
statistics record the result. Rejections, decisions, failures and estimates become messages. The adapter of each node
adds the table, the messages of an estimate and the node's diagnostics.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_bags.errors import BadInput
from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import duration_text, ns_from_stamp
from ship_estimation.integrity.published_levels import PublishedLevels
from ship_estimation.parameters.schema import ParameterError, with_changes
from ship_estimation.rejections import Reason, Rejection, failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_node.adapters.adapter import ServiceResult
from ship_node.health.duplicate_publishers import DuplicatePublishers, StreamQuantity
from ship_node.health.innovation_report import InnovationReport
from ship_node.health.input_health import InputHealthMonitor
from ship_node.health.overload import Overload
from ship_node.health.time_base import TimeBase
from ship_node.messages import common_messages
from ship_node.messages.batches import BatchFeed, StampArray
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, DiagnosticStatus
from ship_node.messages.field_checks import MessageRejected, ReadMessage
from ship_node.messages.topics import InputTopic, OutputMessage, OutputTopic
from ship_node.saved_files.saved_start import SavedStart

INPUT_HEALTH_TOPIC = "input_health"
OWN_OUTPUTS = (
    OutputTopic(INPUT_HEALTH_TOPIC, "ship_msgs/msg/InputHealth"),
    OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE),
)
"""Output topics with which every node reports its state."""

_SOURCE_OFF = Rejection(Reason.OFF, "switched off by sources_off")
_SLOW_TOPICS = "slow topics"
_ATTITUDE_SHAPE = (3, 3)
"""Shape of the noise covariance of an attitude measurement."""
_STARS = "star."
_LEAP_SECOND = "a leap second is inserted: two seconds have the same UTC, so this stamp is ambiguous"
_MAX_PENDING_STEP_NS = 60_000_000_000
"""Maximum age of the state from before a possible time step, ns; the core is not reset to an older state."""
_STEP_SHOWN_NS = 60_000_000_000
"""Time for which a step of the time base is a warning, ns."""
_SECOND_NS = 1_000_000_000


def _step_text(step_ns: int) -> str:
    """Return the text of a time step."""
    return f"{step_ns / _SECOND_NS:+.3f} s"


@dataclass(frozen=True)
class Feed:
    """Entry of an adapter's table: how the messages of one topic reach the core.

    Attributes:
        input: the topic.
        source: name of the device in innovation messages.
        read: reader, called with a message and ``receive_ns=``, the receive time by the node's clock, ns; it raises
            :class:`ship_node.messages.field_checks.MessageRejected` if the message cannot be used.
        process: method of the core, called with the value read and the timeout-clock time, ns; it returns the outcome.
        has_decision: True if the core decides on each message of the topic, perhaps later; False if a message counts as
            used unless the core rejects it at once.
        measurement_source: name of the device in measurements; empty if it equals ``source``.
        batch: processing of many messages at once (:mod:`ship_node.adapters.batch_adapter`); None if messages are only
            processed one by one.
        read_rows: reader, called with many messages and their receive times; it returns None for each message that
            ``read`` must read.
        stream_quantity: quantity whose values show two publishers, live and in a recording; None if the topic is not
            checked.
            The quantity is computed from the decision if ``has_decision``, otherwise from the value read.
    """

    input: InputTopic
    source: str
    read: Callable[..., ReadMessage[Any]]
    process: Callable[[Any, int], Any]
    has_decision: bool = False
    measurement_source: str = ""
    batch: BatchFeed | None = None
    read_rows: Callable[[CdrRows, StampArray], Sequence[ReadMessage[Any] | None]] | None = None
    stream_quantity: StreamQuantity | None = None


def ignore_time(process: Callable[[Any], Any]) -> Callable[[Any, int], Any]:
    """Return a core's method without a time argument in the form of :attr:`Feed.process`."""
    return lambda value, _waiting_ns: process(value)


class ReportingAdapter(ABC):
    """Common part of all adapters; see :class:`ship_node.adapters.adapter.Adapter` for the methods.

    Args:
        config: the node's parameters.
        core: the estimator.
        factory: makes the messages.
        estimate_messages: returns the messages of an estimate.
        saved: saved document from which the core starts; None if the node has no saved document.

    Raises:
        ParameterError: ``sources_off`` names a source that is unknown or cannot be switched off.

    Attributes:
        config: the current parameters.
        core: the estimator.
        latest: the last published estimate; None before the first, also after a reset or a step of the time base.
        pending_budget: the last estimate until its error budget is published; None after an INVALID output.
        conflicts: source → text, for sources in persistent conflict.
        innovation_report: innovation diagnoses of the sources.
        clock_jumps: number of times the clock went back.
        behind: overload state; None if the node keeps up.
        time_base: the clocks of the inputs.
    """

    node_name: ClassVar[str]
    config_type: ClassVar[type]
    services: ClassVar[tuple[str, ...]]
    outputs: tuple[OutputTopic, ...]

    main_topic: ClassVar[str]
    """Topic of the estimates. If an estimate cannot be computed, the failure is reported under this name."""
    innovation_topic: ClassVar[str]
    integrity_topic: ClassVar[str] = ""
    """Topic of the protection levels; empty if the node has none."""
    quantities: ClassVar[tuple[str, ...]] = ()
    """Quantities that the protection levels bound."""
    redundancy_key: ClassVar["attrgetter[tuple[Any, ...]]"]
    """Attributes of an output that determine, together with its state, the redundancy of its sources."""
    directions: ClassVar["attrgetter[np.ndarray]"]
    """Attribute of an output: the ``directions`` of a ``PublishedLevels``."""
    integrity_frame: str = ""
    required_sources: ClassVar[tuple[str, ...]] = ()
    """Sources without which there is no output: they cannot be switched off."""
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
        self.config, self.core, self.factory = config, core, factory
        self._estimate_messages, self.saved = estimate_messages, saved
        self._bind()
        self._off_topics = self._disabled_topics(config)
        continuous = {
            topic: feed.stream_quantity for topic, feed in self.feeds.items() if feed.stream_quantity is not None
        }
        self._duplicates = DuplicatePublishers(continuous)
        self.inputs: tuple[InputTopic, ...] = tuple(feed.input for feed in self.feeds.values())
        self.health = InputHealthMonitor(self.inputs, config.max_age_s)
        self.notices: list[str] = [] if saved is None else saved.notices
        if saved is not None and saved.unreadable_reason:
            self.start_warnings = (*self.start_warnings, f"{saved.unreadable_reason}; the filter starts as configured")
        self.clock_jumps = 0
        self.time_base = TimeBase()
        # State of the core, and timeout-clock time, when the first input with a moved clock was found.
        self._state_before_step: tuple[Any, int] | None = None
        self._stepped_at_ns = 0
        self.latest: Any = None
        self.pending_budget: Any = None
        self.conflicts: dict[str, str] = {}
        self.innovation_report = InnovationReport()
        self.next_slow_ns: int | None = None
        self.published_levels = PublishedLevels()
        self.behind: Overload | None = None
        self._next_invalid_ns = 0

    # -- what a node adds -----------------------------------------------------------------------------------

    @abstractmethod
    def table(self, config: Any, core: Any) -> Iterable[Feed]:
        """Return the inputs and the methods of a core that process them."""

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

    def rejected_part_message(self, source: str, time_ns: int, name: str, rejection: Rejection) -> Any:
        """Return the ship_msgs/Innovation of a rejected part (a star, a light) of a measurement."""
        text = Rejection(rejection.reason, f"{name}: {rejection.text}")
        return common_messages.rejection_message(self.factory, source, time_ns, text)

    # -- called by the node runtime and the replay ----------------------------------------------------------

    def handle(self, topic: str, message: Any, receive_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.adapter.Adapter`."""
        waiting_ns = receive_ns if waiting_ns is None else waiting_ns
        feed = self.feeds[topic]
        is_off = self.is_off(topic)
        # Messages of a source that is switched off do not start the core.
        if self.saved is not None and self.saved.is_pending and not is_off:
            self.saved.start(receive_ns)
        reading: ReadMessage[Any] | None = None
        try:
            reading = feed.read(message, receive_ns=receive_ns)
            if is_off:
                return self.report_off_source(feed, reading, receive_ns, waiting_ns)
            rejection = self.check_clock(feed, reading.value.time_ns, receive_ns, waiting_ns)
            if rejection is not None:
                raise MessageRejected(rejection.reason, rejection.text)
            self.check_single_publisher(feed, reading)
            outcome = None if reading.is_empty else feed.process(reading.value, waiting_ns)
        except MessageRejected as problem:
            reason = problem.rejection.reason
            time_ns = receive_ns if reason is Reason.BAD_STAMP else ns_from_stamp(message.header.stamp)
            if reading is None and reason is Reason.FUTURE and not is_off:
                # A stamp ahead of the node's clock may reveal a step of all clocks.
                self.check_clock(feed, time_ns, receive_ns, waiting_ns)
            self.health.record_unreadable(topic, waiting_ns, receive_ns, time_ns, problem.rejection)
            return [self.rejection_message(feed.source, time_ns, problem.rejection)]
        except Exception:
            # The message has arrived nevertheless; the node runtime reports the exception.
            self.health.record_arrival(topic, waiting_ns)
            raise
        return self.report_input(feed, reading, outcome, receive_ns, waiting_ns)

    def report_input(
        self, feed: Feed, reading: ReadMessage[Any], outcome: Any, receive_ns: int, waiting_ns: int
    ) -> list[OutputMessage]:
        """Record a message that was read and return the messages about it.

        Args:
            feed: entry of the message's topic.
            reading: the message as read.
            outcome: result of the core; None if the core was not called.
            receive_ns: receive time by the node's clock.
            waiting_ns: receive time by the timeout clock.
        """
        time_ns = reading.value.time_ns
        rejection = None if outcome is None else outcome.rejection
        used = not feed.has_decision or outcome is None
        self.health.record_input(feed.input.topic, waiting_ns, receive_ns, reading, rejection, used)
        published: list[OutputMessage] = []
        for name, left_out in reading.rejected_parts:
            published.append(self._rejected_part(feed.source, time_ns, name, left_out))
        if rejection is not None:
            published.append(self.rejection_message(feed.source, time_ns, rejection))
        return published if outcome is None else published + self.report_outcome(outcome, receive_ns, waiting_ns)

    def check_single_publisher(self, feed: Feed, reading: ReadMessage[Any]) -> None:
        """Add a value to the check for two publishers, unless the topic is checked by its decisions."""
        if feed.stream_quantity is None or feed.has_decision or reading.is_empty:
            return
        topic = feed.input.topic
        if self._duplicates.add_value(topic, reading.value.time_ns, reading.value):
            self._update_duplicate_publishers(topic)

    def set_duplicate_publishers(self, topic: str, text: str) -> None:
        """See :class:`ship_node.adapters.adapter.Adapter`."""
        self._duplicates.set_publisher_text(topic, text)
        self._update_duplicate_publishers(topic)

    def _update_duplicate_publishers(self, topic: str) -> None:
        """Pass the duplicate publishers of an input to health and core; if the source is off, to health only."""
        feed, text = self.feeds[topic], self._duplicates.text(topic)
        self.health.set_duplicate_publishers(topic, text)
        self.core.set_duplicate_publishers(feed.measurement_source or feed.source, "" if self.is_off(topic) else text)

    def check_clock(self, feed: Feed, time_ns: int, receive_ns: int, waiting_ns: int) -> Rejection | None:
        """Process a time step that a stamp reveals; return the rejection of the message, or None."""
        topic, clocks = feed.input.topic, self.time_base
        step_ns = clocks.add_arrival(topic, time_ns, receive_ns, waiting_ns)
        if step_ns is not None:
            self._step_time_base(step_ns, waiting_ns)
        elif not clocks.is_step_pending:
            self._state_before_step = None
        else:
            if self._state_before_step is None:
                self._state_before_step = getattr(self.core, "state", None), waiting_ns
            ahead_ns = clocks.ahead_ns(topic)
            if ahead_ns:
                text = f"stamp is {duration_text(ahead_ns)} ahead of the other inputs: check the clock of {feed.source}"
                return Rejection(Reason.FUTURE, text)
        if feed.source.startswith(_STARS) and clocks.is_misdated(time_ns, waiting_ns):
            return Rejection(Reason.CLOCK, _LEAP_SECOND)
        return None

    def is_off(self, topic: str) -> bool:
        """Return True if the source of a topic is switched off by ``sources_off``."""
        return topic in self._off_topics

    def report_off_source(
        self, feed: Feed, reading: ReadMessage[Any], receive_ns: int, waiting_ns: int
    ) -> list[OutputMessage]:
        """Record a message of a source that is switched off and return the messages about it."""
        self.health.record_input(feed.input.topic, waiting_ns, receive_ns, reading, _SOURCE_OFF, is_used=False)
        return [self.rejection_message(feed.source, reading.value.time_ns, _SOURCE_OFF)]

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.adapter.Adapter`; the slow topics are published once a period."""
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        if self.saved is not None and self.saved.is_pending:
            self.saved.start(now_ns)
        published = self.report_outcome(self.core.tick(now_ns, waiting_ns), now_ns, waiting_ns)
        published += self._invalid_while_behind(now_ns, waiting_ns)
        self._autosave(waiting_ns)
        if self.next_slow_ns is None or waiting_ns >= self.next_slow_ns:
            self.next_slow_ns = waiting_ns + round(self.config.slow_topics_period_s * _SECOND_NS)
            for topic in self._duplicates.end_timed_out(waiting_ns):
                self._update_duplicate_publishers(topic)
            try:
                published += self._slow_topics(now_ns, waiting_ns)
            except Exception as error:
                # An INVALID output of this tick must be published nevertheless.
                published.append(self.report_failure(_SLOW_TOPICS, now_ns, failure_rejection(error)))
        return published

    def overload(self, change: Overload, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :meth:`ship_node.adapters.adapter.Adapter.overload`; dropped messages are counted as rejected."""
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        why = (change if change.behind_s else self.behind or change).text(self.node_name)
        published = []
        for topic, count in change.cut.items():
            text = f"{count} messages dropped: {why}"
            self.health.record_overload_cut(topic, count, text, waiting_ns)
            published.append(self.rejection_message(self.feeds[topic].source, now_ns, Rejection(Reason.BEHIND, text)))
        self.behind = change if change.behind_s else None
        self.published_levels = PublishedLevels()  # earlier levels do not apply to the next output
        self._next_invalid_ns = waiting_ns
        return published + self._invalid_while_behind(now_ns, waiting_ns)

    def clock_jumped_back(self, now_ns: int) -> list[OutputMessage]:
        """Restart at the earlier time."""
        self.clock_jumps += 1
        self._restart(clock_jumped=True)
        return []

    def clock_stepped(self, step_ns: int, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Record a step of the computer's clock; the time base steps too if the inputs follow."""
        self.time_base.note_computer_step(step_ns, waiting_ns)
        self.notices.append(f"the computer's clock stepped by {_step_text(step_ns)}")
        return []

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Reset the core, or save or load the document from which it starts."""
        try:
            if name == "reset":
                self._restart(clock_jumped=False)
                return ServiceResult(True, self.reset_text)
            if self.saved is not None and name == "save_alignment":
                return ServiceResult(True, self.saved.save())
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
        """Apply live parameters, dotted name → value.

        Raises:
            ParameterError: a change is invalid; then no parameter is changed.
        """
        config = with_changes(self.config, changes)
        self._off_topics = self._disabled_topics(config)
        self.config = config
        self.core.reconfigure(self.config)
        self._bind()
        for topic in filter(self._duplicates.text, self.feeds):
            self._update_duplicate_publishers(topic)

    # -- results of the core --------------------------------------------------------------------------------

    def report_outcome(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Record an outcome of the core and return its messages: decisions, failures, estimates.

        The estimates of a node that is behind are not published.
        """
        decisions = []
        for decision in outcome.decisions:
            feed = self._feeds_by_source[decision.measurement.source]
            self.health.record_decision(feed.input.topic, decision, now_ns)
            if decision.reason is Reason.ATTITUDE_CONFLICT:
                self.conflicts[feed.source] = decision.text
            elif decision.accepted:
                self.conflicts.pop(feed.source, None)
            topic, is_attitude = feed.input.topic, decision.noise.shape == _ATTITUDE_SHAPE and not decision.revised
            if is_attitude and self._duplicates.add_value(topic, decision.measurement.time_ns, decision):
                self._update_duplicate_publishers(topic)
            decisions.append((feed.source, decision))
        self.innovation_report.pending += decisions
        published: list[OutputMessage] = []
        for source, decision in decisions:
            time_ns = decision.measurement.time_ns
            for name, rejected in decision.rejected_parts:
                published.append(self._rejected_part(source, time_ns, name, rejected))
            message = common_messages.decision_message(self.factory, source, decision)
            published.append((self.innovation_topic, message))
        for time_ns, rejection in outcome.failures:
            published.append(self.report_failure(self.main_topic, time_ns, rejection))
        for estimate in outcome.estimates if self.behind is None else ():
            self.latest = estimate
            self.pending_budget = None if estimate.status is Status.INVALID else estimate
            if self.integrity_topic and estimate.status is not Status.INVALID:
                published += self.protection_level_messages(estimate)
            published += self._estimate_messages(estimate)
        return published

    def rejection_message(self, source: str, time_ns: int, rejection: Rejection) -> OutputMessage:
        """Return the message about a rejected input."""
        return self.innovation_topic, common_messages.rejection_message(self.factory, source, time_ns, rejection)

    def report_failure(self, what: str, time_ns: int, rejection: Rejection) -> OutputMessage:
        """Record that an output could not be computed and return the message about it."""
        self.health.record_failure(f"{what}: {rejection.text}")
        return self.rejection_message(what, time_ns, rejection)

    def _rejected_part(self, source: str, time_ns: int, name: str, rejection: Rejection) -> OutputMessage:
        return self.innovation_topic, self.rejected_part_message(source, time_ns, name, rejection)

    # -- the node itself ------------------------------------------------------------------------------------

    def _bind(self) -> None:
        """Build the table with the current parameters."""
        self.feeds = {feed.input.topic: feed for feed in self.table(self.config, self.core)}
        self._feeds_by_source = {feed.measurement_source or feed.source: feed for feed in self.feeds.values()}

    def _disabled_topics(self, config: Any) -> frozenset[str]:
        """Return the topics whose sources a configuration switches off.

        Raises:
            ParameterError: a source is unknown or cannot be switched off.
        """
        topics = {feed.source: topic for topic, feed in self.feeds.items()}
        for source in config.sources_off:
            if source in self.required_sources:
                reason = (
                    f"'{source}' cannot be switched off: without it there is no output. To test that, stop the "
                    f"publisher of {topics[source]}; to use another device, remap {topics[source]} at the start"
                )
            elif source not in topics:
                names = ", ".join(name for name in topics if name not in self.required_sources)
                reason = f"there is no source {source!r}: expected some of {names}"
            else:
                continue
            raise ParameterError(f"parameter 'sources_off': {reason}", "sources_off", value=config.sources_off)
        return frozenset(topics[source] for source in config.sources_off)

    def _off_statuses(self) -> list[DiagnosticStatus]:
        """Return a status with the sources that are switched off; an empty list if all are on."""
        names = [feed.source for topic, feed in self.feeds.items() if topic in self._off_topics]
        text = f"switched off by sources_off: {', '.join(names)}"
        return [DiagnosticStatus("sources off", common_messages.Level.WARN, text)] if names else []

    def _invalid_while_behind(self, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Return, once a second while the node is behind, the reason and the INVALID output."""
        if self.behind is None or waiting_ns < self._next_invalid_ns:
            return []
        self._next_invalid_ns = waiting_ns + _SECOND_NS
        text = self.behind.text(self.node_name)
        published = [self.rejection_message(self.node_name, now_ns, Rejection(Reason.BEHIND, text))]
        invalid = self.no_output(now_ns, text)
        if invalid is not None:
            self.latest, self.pending_budget = invalid, None
            published += self._estimate_messages(invalid)
        return published

    def _overload_status(self) -> DiagnosticStatus:
        """Return the diagnostic status of the overload."""
        if self.behind is None:
            return DiagnosticStatus("overload", common_messages.Level.OK, "keeps up with its inputs")
        values = {
            "behind [s]": f"{self.behind.behind_s:.1f}",
            "cores": str(self.behind.cores),
            "load": f"{self.behind.load:.1f}",
        }
        return DiagnosticStatus("overload", common_messages.Level.ERROR, self.behind.text(self.node_name), values)

    def _autosave(self, waiting_ns: int) -> None:
        """Save the core's content once a period, while the output is VALID and no source is in conflict or excluded."""
        if self.saved is None or not self.saved.is_autosave_time(waiting_ns, self.config.alignment_autosave_s):
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
        statuses += [*self.own_statuses(waiting_ns), *self._off_statuses()]
        statuses += [*self._time_base_statuses(waiting_ns), self._overload_status()]
        array = common_messages.diagnostic_array(now_ns, self.node_name, statuses)
        return [*published, (DIAGNOSTICS_TOPIC, array)]

    def protection_level_messages(self, estimate: Any) -> list[OutputMessage]:
        """Return the protection levels of an output if the published levels do not cover it."""
        published, redundancy_key, directions = (
            self.published_levels,
            self.redundancy_key(estimate),
            self.directions(estimate),
        )
        # Runs for every output: the fast check comes first.
        if published.state is estimate.state and published.redundancy_key == redundancy_key:
            output = np.array([estimate.time_ns]), estimate.covariance_n[None], directions[None]
            if published.covered_count(*output):
                return []
        report, period_ns = self.core.integrity(estimate), round(self.config.slow_topics_period_s * _SECOND_NS)
        published.state, published.redundancy_key, published.directions = estimate.state, redundancy_key, directions
        if not published.needs_update(estimate, report, period_ns):
            return []
        config = self.config.integrity
        message = common_messages.integrity_message(self.factory, report, self.quantities, self.integrity_frame, config)
        return [(self.integrity_topic, message)]

    def saved_document_remarks(self) -> list[str]:
        """Return remarks on the saved document: on the start from it, and on obstacles to saving."""
        if self.saved is None:
            return []
        return [
            *self.saved.messages,
            *filter(None, dict.fromkeys([self.saved.unreadable_reason, self.saved.autosave_problem])),
        ]

    def integrity_statuses(self) -> list[DiagnosticStatus]:
        """Return one status with the published protection levels and the excluded sources."""
        known = self.latest is not None and self.latest.status is not Status.INVALID
        return [common_messages.integrity_status(self.published_levels.report if known else None, self.quantities)]

    def conflict_statuses(self) -> list[DiagnosticStatus]:
        """Return one status per source in persistent conflict."""
        return [
            DiagnosticStatus(f"conflict {source}", common_messages.Level.ERROR, text)
            for source, text in sorted(self.conflicts.items())
        ]

    def _restart(self, clock_jumped: bool) -> None:
        self.core.reset(clock_jumped)
        self._restart_streams()
        self.health.restart()
        self.time_base.restart()
        self._state_before_step = None
        if self.saved is not None:
            self.saved.note_core_reset()
        self._reset_outputs()

    def _restart_streams(self) -> None:
        """Restart the check for two publishers, because new stamps do not continue the earlier stamps."""
        doubled = list(filter(self._duplicates.text, self.feeds))
        self._duplicates.restart()
        for topic in doubled:
            self._update_duplicate_publishers(topic)

    def _step_time_base(self, step_ns: int, waiting_ns: int) -> None:
        """Reset after a step of the time base; mountings, clock offsets and calibration are kept."""
        state = getattr(self.core, "state", None)
        if self._state_before_step is not None and waiting_ns - self._state_before_step[1] <= _MAX_PENDING_STEP_NS:
            # Messages from after the step may have been used as late messages from before the step.
            state = self._state_before_step[0]
        self._state_before_step = None
        self.core.step_time_base(step_ns, state)
        self._restart_streams()
        self.health.reset_stamps()
        self._reset_outputs()
        self._stepped_at_ns = waiting_ns
        self.notices.append(f"time base stepped by {_step_text(step_ns)}: reset, mountings and calibration kept")

    def _time_base_statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return one status with the last step of the time base; an empty list if there was no step."""
        if not self.time_base.steps:
            return []
        is_recent = waiting_ns - self._stepped_at_ns <= _STEP_SHOWN_NS
        level = common_messages.Level.WARN if is_recent else common_messages.Level.OK
        text = f"stepped by {_step_text(self.time_base.last_step_ns)}: reset, mountings and calibration kept"
        return [DiagnosticStatus("time base", level, text, {"steps": str(self.time_base.steps)})]

    def _reset_outputs(self) -> None:
        self.latest, self.pending_budget, self.next_slow_ns = None, None, None
        self.published_levels = PublishedLevels()
        self.conflicts.clear()
        self.innovation_report.clear()
