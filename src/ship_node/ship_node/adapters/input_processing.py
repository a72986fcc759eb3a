"""The way of a message through an adapter: read, check the clocks, pass the value to the core, count, report.

A live node processes one message at a time (``process_message``). Longer batches of a replay go through
:class:`ship_node.adapters.batch_pass.BatchPass`, which processes messages by the same functions.

Messages of sources that the parameter ``sources_off`` switches off are counted and not used. If the clocks of all
inputs step together, the core is reset to its state from before the step.
"""

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable
from operator import methodcaller
from typing import Any, ClassVar

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import ns_from_stamp
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_node.adapters.adapter import DeferringPart, Feed
from ship_node.adapters.adapter_report import AdapterReport
from ship_node.adapters.batch_pass import BatchPass
from ship_node.health.duplicate_publishers import DuplicatePublishers
from ship_node.health.input_health import InputHealthMonitor
from ship_node.health.time_base import TimeBase, step_text
from ship_node.messages import common_messages
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.field_checks import MessageRejected, ReadMessage
from ship_node.messages.inputs_outputs import Arrival, Batch, BatchOutputs, InputTopic, OutputMessage, PlacedMessages
from ship_node.saved_files.saved_start import SavedStart

SOURCE_OFF = Rejection(Reason.OFF, "switched off by sources_off")
"""Rejection of a message whose source is switched off."""

_ATTITUDE_SHAPE = (3, 3)
"""Shape of the noise covariance of an attitude measurement."""

PRESENCE_REASONS = frozenset({
    *(Reason.NONE, Reason.GATE, Reason.STUCK, Reason.UNITS, Reason.EXCLUDED, Reason.ATTITUDE_CONFLICT),
    *(Reason.LIGHT_CONFLICT, Reason.MISIDENTIFIED, Reason.UNIDENTIFIED, Reason.JUMP),
})  # fmt: skip
"""Reasons of decisions that follow a comparison: the compared message was usable, so its source counts as present."""


def disabled_topics(
    feeds: Iterable[Feed], sources_off: tuple[str, ...], required_sources: Collection[str]
) -> frozenset[str]:
    """Return the topics of sources that are switched off.

    Args:
        feeds: inputs of the node.
        sources_off: the parameter.
        required_sources: sources without which there is no output.

    Raises:
        ParameterError: a source is unknown or cannot be switched off.
    """
    topics = {feed.source: feed.input.topic for feed in feeds}
    for source in sources_off:
        if source in required_sources:
            reason = (
                f"'{source}' cannot be switched off: without it there is no output. To test that, stop the "
                f"publisher of {topics[source]}; to use another device, remap {topics[source]} at the start"
            )
        elif source not in topics:
            names = ", ".join(name for name in topics if name not in required_sources)
            reason = f"there is no source {source!r}: expected some of {names}"
        else:
            continue
        raise ParameterError(f"parameter 'sources_off': {reason}", "sources_off", value=sources_off)
    return frozenset(topics[source] for source in sources_off)


def off_statuses(feeds: Iterable[Feed], off_topics: Collection[str]) -> list[DiagnosticStatus]:
    """Return a status with the sources that are switched off; an empty list if all are on."""
    names = [feed.source for feed in feeds if feed.input.topic in off_topics]
    text = f"switched off by sources_off: {', '.join(names)}"
    return [DiagnosticStatus("sources off", Level.WARN, text)] if names else []


class InputProcessing(AdapterReport):
    """Part of an adapter that processes messages; see :class:`ship_node.adapters.node_adapter.NodeAdapter`.

    Attributes:
        feeds: topic → its entry in the table.
        off_topics: topics of the sources that ``sources_off`` switches off.
        time_base: clocks of the inputs, and the steps of all clocks together.
        last_usable_ns: source, named as in exclusions → timeout-clock time of its last usable message.
        batch_pass: the batch in progress; None between batches, and while a single message is processed.
    """

    required_sources: ClassVar[tuple[str, ...]] = ()
    """Sources without which there is no output: they cannot be switched off."""
    has_idle_ticks: ClassVar[bool] = True
    """True if a tick among the messages of a block does not change the core."""

    def __init__(
        self,
        config: Any,
        core: Any,
        factory: MessageFactory,
        estimate_messages: Callable[[Any], list[OutputMessage]],
        saved: SavedStart[Any] | None,
    ) -> None:
        super().__init__(config, core, factory, estimate_messages)
        self.saved = saved
        self.bind()
        self.off_topics = disabled_topics(self.feeds.values(), config.sources_off, self.required_sources)
        self.duplicates = DuplicatePublishers({
            topic: feed.stream_quantity for topic, feed in self.feeds.items() if feed.stream_quantity is not None
        })
        self.inputs: tuple[InputTopic, ...] = tuple(feed.input for feed in self.feeds.values())
        self.health = InputHealthMonitor(self.inputs, config.max_age_s)
        self.notices: list[str] = [] if saved is None else saved.notices
        self.time_base = TimeBase()
        self.last_usable_ns: dict[str, int] = {}
        self.batch_pass: BatchPass | None = None

    @abstractmethod
    def table(self, config: Any, core: Any) -> Iterable[Feed]:
        """Return the inputs and the methods of a core that process them."""

    def bind(self) -> None:
        """Build the table with the current parameters."""
        self.feeds = {feed.input.topic: feed for feed in self.table(self.config, self.core)}
        self._feeds_by_source = {feed.measurement_source or feed.source: feed for feed in self.feeds.values()}

    @property
    def block_topics(self) -> frozenset[str]:
        """See :class:`ship_node.adapters.adapter.Adapter`."""
        return frozenset(t for t, feed in self.feeds.items() if feed.block is not None or feed.read_rows is not None)

    @property
    def deferring_part(self) -> DeferringPart | None:
        """Part of the core that can compute several outputs of a batch together; None if there is none."""
        return None

    @property
    @abstractmethod
    def idle_until_ns(self) -> int:
        """Timeout-clock time before which a tick only calls the core; 0 if every tick may do more."""

    @abstractmethod
    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """See :class:`ship_node.adapters.adapter.Adapter`."""

    def process(self, batch: Batch) -> BatchOutputs:
        """See :class:`ship_node.adapters.adapter.Adapter`; a message that comes alone waits for no other."""
        if len(batch.arrivals) == 1 and batch.arrivals[0].message is not None:
            published = self.process_message(batch.arrivals[0])
            return BatchOutputs([PlacedMessages(0, 0, published)] if published else [])
        self.batch_pass = BatchPass(self, batch)
        try:
            return self.batch_pass.run()
        finally:
            self.batch_pass = None

    def compute_pending(self) -> None:
        """Compute the pending outputs of the batch in progress; the next output or report must follow them."""
        if self.batch_pass is not None:
            self.batch_pass.compute_pending()

    def process_message(self, arrival: Arrival, reading: ReadMessage[Any] | None = None) -> list[OutputMessage]:
        """Process one message, read in advance or not; return the messages to publish."""
        topic, message, receive_ns, waiting_ns = arrival.topic, arrival.message, arrival.receive_ns, arrival.waiting_ns
        feed, is_off = self.feeds[topic], topic in self.off_topics
        # Messages of a source that is switched off do not start the core.
        if self.saved is not None and self.saved.is_pending and not is_off:
            self.saved.start(receive_ns)
        try:
            if reading is None:
                reading = feed.read(message, receive_ns=receive_ns)
            value = reading.value
            if is_off:
                self.health.record_input(topic, waiting_ns, receive_ns, reading, SOURCE_OFF, is_used=False)
                return [self.rejection_message(feed.source, value.time_ns, SOURCE_OFF)]
            rejection = self._check_clock(feed, value.time_ns, receive_ns, waiting_ns)
            if rejection is not None:
                raise MessageRejected(rejection.reason, rejection.text)
            # The streams of a topic whose core decides on each message are compared by the decisions.
            is_compared = feed.stream_quantity is not None and not (feed.has_decision or reading.is_empty)
            if is_compared and self.duplicates.add_value(topic, value.time_ns, value):
                self.update_duplicate_publishers([topic])
            outcome = None if reading.is_empty else feed.process(value, waiting_ns)
        except MessageRejected as problem:
            reason = problem.rejection.reason
            if reading is not None:
                time_ns = reading.value.time_ns
            else:
                time_ns = receive_ns if reason is Reason.BAD_STAMP else ns_from_stamp(message.header.stamp)
                if reason is Reason.FUTURE and not is_off:
                    # A stamp ahead of the node's clock may reveal a step of all clocks.
                    self._check_clock(feed, time_ns, receive_ns, waiting_ns)
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
        is_usable = outcome is not None and (rejection is None or rejection.reason in PRESENCE_REASONS)
        if feed.shows_present and is_usable and not reading.is_degraded:
            self.last_usable_ns[feed.shows_present] = waiting_ns
        self.health.record_input(feed.input.topic, waiting_ns, receive_ns, reading, rejection, used)
        published = [self.rejected_part_message(feed.source, time_ns, *part) for part in reading.rejected_parts]
        if rejection is not None:
            published.append(self.rejection_message(feed.source, time_ns, rejection))
        return published if outcome is None else published + self.report_outcome(outcome, receive_ns, waiting_ns)

    def report_outcome(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Record an outcome of the core and return its messages: decisions, failures, estimates.

        The estimates of a node that is behind are not published.
        """
        if outcome.estimates:
            self.compute_pending()
        published: list[OutputMessage] = []
        for decision in outcome.decisions:
            published += self.report_decision(decision, now_ns, waiting_ns)
        for time_ns, rejection in outcome.failures:
            published.append(self.report_failure(self.main_topic, time_ns, rejection))
        for estimate in outcome.estimates if self.overload_report.behind is None else ():
            self.latest = estimate
            self.pending_budget = None if estimate.status is Status.INVALID else estimate
            if self.integrity_topic and estimate.status is not Status.INVALID:
                published += self.protection_level_messages(estimate)
            published += self._estimate_messages(estimate)
        return published

    def report_decision(self, decision: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Record the decision on a measurement and return the messages about it.

        The innovation of an attitude is added to the check for two publishers.
        """
        feed, time_ns = self._feeds_by_source[decision.measurement.source], decision.measurement.time_ns
        topic, source = feed.input.topic, feed.source
        self.health.record_decision(topic, decision, now_ns)
        is_attitude = decision.noise.shape == _ATTITUDE_SHAPE and not decision.revised
        if is_attitude and self.duplicates.add_value(topic, time_ns, decision):
            self.update_duplicate_publishers([topic])
        if decision.reason is Reason.ATTITUDE_CONFLICT:
            self.conflicts[source] = decision.text
        elif decision.accepted:
            self.conflicts.pop(source, None)
        self.innovation_report.pending.append((source, decision))
        published = [self.rejected_part_message(source, time_ns, *part) for part in decision.rejected_parts]
        return [*published, (self.innovation_topic, common_messages.decision_message(self.factory, source, decision))]

    def protection_level_messages(self, estimate: Any) -> list[OutputMessage]:
        """Return the protection levels of an output if the published levels do not cover it."""
        published, directions = self.published_levels, self.directions(estimate)
        redundancy_key = self.redundancy_key(estimate)
        # Runs for every output: the fast check comes first.
        if published.state is estimate.state and published.redundancy_key == redundancy_key:
            output = np.array([estimate.time_ns]), estimate.covariance_n[None], directions[None]
            if published.covered_count(*output):
                return []
        report, period_ns = self.core.integrity(estimate), round(self.config.slow_topics_period_s * SECOND_NS)
        published.state, published.redundancy_key, published.directions = estimate.state, redundancy_key, directions
        if not published.needs_update(estimate, report, period_ns):
            return []
        config = self.config.integrity
        message = common_messages.integrity_message(self.factory, report, self.quantities, self.integrity_frame, config)
        return [(self.integrity_topic, message)]

    def set_duplicate_publishers(self, topic: str, text: str) -> None:
        """See :class:`ship_node.adapters.adapter.Adapter`."""
        self.duplicates.set_publisher_text(topic, text)
        self.update_duplicate_publishers([topic])

    @property
    def duplicate_topics(self) -> list[str]:
        """Topics on which two publishers send."""
        return list(filter(self.duplicates.text, self.feeds))

    def update_duplicate_publishers(self, topics: Iterable[str]) -> None:
        """Pass the duplicate publishers of some inputs to health and core; if the source is off, to health only."""
        for topic in topics:
            feed, text = self.feeds[topic], self.duplicates.text(topic)
            self.health.set_duplicate_publishers(topic, text)
            core_text = "" if topic in self.off_topics else text
            source = feed.measurement_source or feed.source
            self.call_cores(methodcaller("set_duplicate_publishers", source, core_text))

    def restart_streams(self) -> None:
        """Restart the check for two publishers, because new stamps do not continue the earlier stamps."""
        topics = self.duplicate_topics
        self.duplicates.restart()
        self.update_duplicate_publishers(topics)

    def step_time_base(self, step_ns: int, waiting_ns: int) -> None:
        """Reset after a step of the time base; mountings, clock offsets and calibration are kept."""
        self.compute_pending()
        self.core.step_time_base(step_ns, self.time_base.record_step(self.core, waiting_ns))
        self.restart_streams()
        self.health.reset_stamps()
        self.reset_outputs()
        self.notices.append(f"time base stepped by {step_text(step_ns)}: reset, mountings and calibration kept")

    def _check_clock(self, feed: Feed, time_ns: int, receive_ns: int, waiting_ns: int) -> Rejection | None:
        """Process a time step that a stamp reveals; return the rejection of the message, or None."""
        step_ns, rejection = self.time_base.check_message(
            feed.input.topic, feed.source, time_ns, receive_ns, waiting_ns, self.core
        )
        if step_ns is not None:
            self.step_time_base(step_ns, waiting_ns)
        return rejection
