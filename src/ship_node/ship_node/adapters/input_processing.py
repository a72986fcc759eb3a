"""Processing of single messages by an adapter: read, check the clocks, pass the value to the core, count and report.

Messages of sources that the parameter ``sources_off`` switches off are counted and not used. If the clocks of all
inputs step together, the core is reset to its state from before the step.
"""

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable
from operator import methodcaller
from typing import Any, ClassVar

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import duration_text, ns_from_stamp
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_node.adapters.adapter import Feed
from ship_node.adapters.result_report import ResultReport
from ship_node.health.duplicate_publishers import DuplicatePublishers
from ship_node.health.input_health import InputHealthMonitor
from ship_node.health.time_base import TimeBase
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.field_checks import MessageRejected, ReadMessage
from ship_node.messages.inputs_outputs import Arrival, InputTopic, OutputMessage
from ship_node.saved_files.saved_start import SavedStart

SOURCE_OFF = Rejection(Reason.OFF, "switched off by sources_off")
"""Rejection of a message whose source is switched off."""

_STARS = "star."
_LEAP_SECOND = "a leap second is inserted: two seconds have the same UTC, so this stamp is ambiguous"
_MAX_PENDING_STEP_NS = 60 * SECOND_NS
"""Maximum age of the state from before a possible time step, ns; the core is not reset to an older state."""
_STEP_SHOWN_NS = 60 * SECOND_NS
"""Time for which a step of the time base is a warning, ns."""

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


class TimeSteps:
    """Steps of the time base, found from the stamps of all inputs.

    Attributes:
        time_base: the clocks of the inputs.
    """

    def __init__(self) -> None:
        self.time_base = TimeBase()
        # State of the core, and timeout-clock time, when the first input with a moved clock was found.
        self._state_before: tuple[Any, int] | None = None
        self._stepped_at_ns = 0

    def restart(self) -> None:
        """Discard the clocks of the inputs."""
        self.time_base.restart()
        self._state_before = None

    def add_arrival(self, topic: str, time_ns: int, receive_ns: int, waiting_ns: int, core: Any) -> int | None:
        """Add the stamp of a message; return a time step that the stamp reveals, ns, or None."""
        step_ns = self.time_base.add_arrival(topic, time_ns, receive_ns, waiting_ns)
        if step_ns is None and not self.time_base.is_step_pending:
            self._state_before = None
        elif step_ns is None and self._state_before is None:
            self._state_before = getattr(core, "state", None), waiting_ns
        return step_ns

    def rejection(self, topic: str, source: str, time_ns: int, waiting_ns: int) -> Rejection | None:
        """Return the rejection of a message whose stamp is ahead of other inputs or ambiguous; None if it is usable."""
        ahead_ns = self.time_base.ahead_ns(topic) if self.time_base.is_step_pending else 0
        if ahead_ns:
            text = f"stamp is {duration_text(ahead_ns)} ahead of the other inputs: check the clock of {source}"
            return Rejection(Reason.FUTURE, text)
        if source.startswith(_STARS) and self.time_base.is_misdated(time_ns, waiting_ns):
            return Rejection(Reason.CLOCK, _LEAP_SECOND)
        return None

    def accept_step(self, core: Any, waiting_ns: int) -> Any:
        """Record a step; return the core's state from before the step, to which the core is reset."""
        state, before = getattr(core, "state", None), self._state_before
        self._state_before, self._stepped_at_ns = None, waiting_ns
        # Messages from after the step may have been used as late messages from before the step.
        return before[0] if before is not None and waiting_ns - before[1] <= _MAX_PENDING_STEP_NS else state

    def statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return one status with the last step of the time base; an empty list if there was no step."""
        if not self.time_base.steps:
            return []
        level = Level.WARN if waiting_ns - self._stepped_at_ns <= _STEP_SHOWN_NS else Level.OK
        text = f"stepped by {step_text(self.time_base.last_step_ns)}: reset, mountings and calibration kept"
        return [DiagnosticStatus("time base", level, text, {"steps": str(self.time_base.steps)})]


def step_text(step_ns: int) -> str:
    """Return the text of a time step."""
    return f"{step_ns / SECOND_NS:+.3f} s"


class InputProcessing(ResultReport):
    """Part of an adapter that processes single messages; see :class:`ship_node.adapters.node_adapter.NodeAdapter`.

    Attributes:
        feeds: topic → its entry in the table.
        time_steps: steps of the clocks of the inputs.
    """

    required_sources: ClassVar[tuple[str, ...]] = ()
    """Sources without which there is no output: they cannot be switched off."""

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
        self.time_steps = TimeSteps()

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

    def is_off(self, topic: str) -> bool:
        """Return True if the source of a topic is switched off by ``sources_off``."""
        return topic in self.off_topics

    def process_message(self, arrival: Arrival, reading: ReadMessage[Any] | None = None) -> list[OutputMessage]:
        """Process one message, read in advance or not; return the messages to publish."""
        topic, message, receive_ns, waiting_ns = arrival.topic, arrival.message, arrival.receive_ns, arrival.waiting_ns
        feed, is_off = self.feeds[topic], self.is_off(topic)
        # Messages of a source that is switched off do not start the core.
        if self.saved is not None and self.saved.is_pending and not is_off:
            self.saved.start(receive_ns)
        try:
            if reading is None:
                reading = feed.read(message, receive_ns=receive_ns)
            if is_off:
                self.health.record_input(topic, waiting_ns, receive_ns, reading, SOURCE_OFF, is_used=False)
                return [self.rejection_message(feed.source, reading.value.time_ns, SOURCE_OFF)]
            rejection = self._check_clock(feed, reading.value.time_ns, receive_ns, waiting_ns)
            if rejection is not None:
                raise MessageRejected(rejection.reason, rejection.text)
            self._check_single_publisher(feed, reading)
            outcome = None if reading.is_empty else feed.process(reading.value, waiting_ns)
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
        if outcome is not None and (rejection is None or rejection.reason in PRESENCE_REASONS):
            self.record_usable(feed, reading.value, waiting_ns)
        self.health.record_input(feed.input.topic, waiting_ns, receive_ns, reading, rejection, used)
        published = self.rejected_part_messages(feed.source, time_ns, reading.rejected_parts)
        if rejection is not None:
            published.append(self.rejection_message(feed.source, time_ns, rejection))
        return published if outcome is None else published + self.report_outcome(outcome, receive_ns, waiting_ns)

    def record_usable(self, feed: Feed, value: Any, waiting_ns: int) -> None:
        """Record that a message was usable.

        Args:
            feed: entry of the message's topic.
            value: the value read; None for messages of a block.
            waiting_ns: receive time by the timeout clock.
        """

    def record_decision(self, decision: Any, now_ns: int) -> Feed:
        """See :class:`ResultReport`; the innovation of an attitude is added to the check for two publishers."""
        feed = self._feeds_by_source[decision.measurement.source]
        topic = feed.input.topic
        self.health.record_decision(topic, decision, now_ns)
        is_attitude = decision.noise.shape == _ATTITUDE_SHAPE and not decision.revised
        if is_attitude and self.duplicates.add_value(topic, decision.measurement.time_ns, decision):
            self.update_duplicate_publishers([topic])
        return feed

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
            core_text = "" if self.is_off(topic) else text
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
        self.core.step_time_base(step_ns, self.time_steps.accept_step(self.core, waiting_ns))
        self.restart_streams()
        self.health.reset_stamps()
        self.reset_outputs()
        self.notices.append(f"time base stepped by {step_text(step_ns)}: reset, mountings and calibration kept")

    def _check_clock(self, feed: Feed, time_ns: int, receive_ns: int, waiting_ns: int) -> Rejection | None:
        """Process a time step that a stamp reveals; return the rejection of the message, or None."""
        step_ns = self.time_steps.add_arrival(feed.input.topic, time_ns, receive_ns, waiting_ns, self.core)
        if step_ns is not None:
            self.step_time_base(step_ns, waiting_ns)
        return self.time_steps.rejection(feed.input.topic, feed.source, time_ns, waiting_ns)

    def _check_single_publisher(self, feed: Feed, reading: ReadMessage[Any]) -> None:
        """Add a value to the check for two publishers, unless the topic is checked by its decisions."""
        if feed.stream_quantity is None or feed.has_decision or reading.is_empty:
            return
        topic = feed.input.topic
        if self.duplicates.add_value(topic, reading.value.time_ns, reading.value):
            self.update_duplicate_publishers([topic])
