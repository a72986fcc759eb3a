"""Health of a node's inputs: evaluation of their statistics for ``input_health`` and ``/diagnostics``."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import duration_text
from ship_estimation.rejection_rules import Reason
from ship_node.health.input_record import DELAY_BIN_EDGES_S, MAX_AGE_S, InputRecord, InputRecords
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import InputTopic

FIRST_MESSAGE_TIMEOUT_NS = 5_000_000_000
"""Maximum time from the start to the first message of a topic, and between its first three messages, ns."""

REJECTION_SHOWN_NS = 2_000_000_000
"""Time for which a single rejection is shown, ns."""

TIMEOUT_PERIODS = 3.0
TIMEOUT_ERROR_NS = 1_000_000_000
"""Time without data after which the timeout of a required topic is an ERROR, ns; before, it is a WARN."""

MIN_TIMEOUT_NS = 100_000_000
"""Minimum timeout, ns: the evaluation runs once per tick."""

REJECTIONS_WARN = 5
REJECTIONS_ERROR = 20
FUTURE_STAMPS_ERROR = 10

_EXPECTED_REASONS = (Reason.GATE, Reason.REVISED)
"""Reasons for which good data are rejected occasionally; only several such rejections in a row give a warning."""

_EDGES = (*(f"up to {edge:g} s" for edge in DELAY_BIN_EDGES_S), f"above {DELAY_BIN_EDGES_S[-1]:g} s")

_Issue = tuple[Level, str]


class _InputState(NamedTuple):
    """State of one input topic at one time.

    Attributes:
        record: statistics of the topic.
        level, text: level and text of the worst issue.
        rate_hz, latency_s, age_s: values from the statistics at that time.
    """

    record: InputRecord
    level: Level
    text: str
    rate_hz: float
    latency_s: float
    age_s: float


class InputHealthMonitor(InputRecords):
    """Health of all inputs of a node, from their statistics and from information of the middleware.

    The node runtime adds the information of the middleware, which is unknown offline.

    Args:
        inputs: the input topics.
        max_age_s: maximum age of a stamp, s; see :data:`ship_node.health.input_record.MAX_AGE_S`.

    Attributes:
        first_duplicate_publishers: topic → first text about its two publishers; topics that never had two are left out.
    """

    def __init__(self, inputs: Iterable[InputTopic], max_age_s: float = MAX_AGE_S) -> None:
        super().__init__(inputs, max_age_s)
        self._is_clock_unused = False
        self._publishers: dict[str, int] = {}
        self._incompatible: dict[str, str] = {}
        self._duplicate_publishers: dict[str, str] = {}
        self.first_duplicate_publishers: dict[str, str] = {}
        self._publisher_names: dict[str, str] = {}
        self._lost: dict[str, int] = {}

    def set_publisher_count(self, topic: str, count: int, names: Sequence[str] = ()) -> None:
        """Set the number of publishers of a topic, and their names if there are several.

        If there is no publisher, the record of an incompatible QoS is removed.
        """
        self._publishers[topic] = count
        self._publisher_names[topic] = ", ".join(names)
        if count == 0:
            self._incompatible.pop(topic, None)

    def set_duplicate_publishers(self, topic: str, text: str) -> None:
        """Set the text about two publishers of a topic; an empty text ends this state."""
        self._duplicate_publishers[topic] = text
        if text:
            self.first_duplicate_publishers.setdefault(topic, text)

    def record_incompatible_qos(self, topic: str, text: str) -> None:
        """Record that a publisher's QoS is incompatible, so that its messages cannot arrive."""
        self._incompatible[topic] = text

    def set_clock_unused(self, is_unused: bool) -> None:
        """Set whether /clock is published although this node does not use it."""
        self._is_clock_unused = is_unused

    def stale_stamps_text(self) -> str:
        """Return the log text about the first input with too old stamps; empty if there is none."""
        old = [record for record in self.records.values() if record.is_too_old]
        return f"{old[0].input.topic}: {self._age_text(old[0].latency_s)}" if old else ""

    def record_lost(self, topic: str, count: int) -> None:
        """Record that the middleware lost ``count`` further messages."""
        self._lost[topic] = self._lost.get(topic, 0) + count

    def messages(self, factory: MessageFactory, now_ns: int) -> list[Any]:
        """Return one ship_msgs/InputHealth per topic, for a time at which both clocks are equal."""
        return self.messages_and_statuses(factory, now_ns, now_ns)[0]

    def messages_and_statuses(
        self, factory: MessageFactory, now_ns: int, waiting_ns: int
    ) -> tuple[list[Any], list[DiagnosticStatus]]:
        """Return one ship_msgs/InputHealth and one diagnostic status per topic."""
        waiting_ns = self._now(waiting_ns)
        states = [self._state(record, now_ns, waiting_ns) for record in self.records.values()]
        return [_message(factory, state, now_ns) for state in states], [self._status(state) for state in states]

    def _state(self, record: InputRecord, now_ns: int, waiting_ns: int) -> _InputState:
        latency_s, rate_hz = record.latency_s, record.rate_hz(waiting_ns)
        level, text = self._worst_issue(record, latency_s, rate_hz, waiting_ns)
        return _InputState(record, level, text, rate_hz, latency_s, record.age_s(now_ns))

    def _status(self, state: _InputState) -> DiagnosticStatus:
        record = state.record
        values = {
            "received": str(record.received),
            "accepted": str(record.accepted),
            "rejected": str(record.rejected),
            "rate [Hz]": f"{state.rate_hz:.2f}",
            "latency [s]": f"{state.latency_s:.3f}",
            "age [s]": f"{state.age_s:.3f}",
        }
        values |= {f"reason {reason.word}": str(count) for reason, count in record.reasons.items()}
        values |= {f"late {edge}": str(n) for edge, n in zip(_EDGES, record.late_delays, strict=True) if n}
        topic = record.input.topic
        if topic in self._publishers:
            names = self._publisher_names.get(topic, "")
            values["publishers"] = f"{self._publishers[topic]}{f': {names}' if names else ''}"
        if topic in self._lost:
            values["lost by the middleware"] = str(self._lost[topic])
        return DiagnosticStatus(f"input {topic}", state.level, state.text, values)

    def _worst_issue(self, record: InputRecord, latency_s: float, rate_hz: float, waiting_ns: int) -> _Issue:
        """Return the issue of the highest level; the first one if several have this level."""
        issues = [
            *self._connection_issues(record, waiting_ns),
            *([(Level.ERROR, self._age_text(latency_s))] if record.is_too_old else []),
            *_rejection_issues(record, waiting_ns),
            *_timeout_issues(record, waiting_ns),
        ]
        if record.received == 0:
            issues.append((Level.OK, "no message yet"))
        issues.append((Level.OK, f"{_rate_text(record, rate_hz)}, latency {_latency_text(latency_s)}"))
        return max(issues, key=lambda issue: issue[0])

    def _age_text(self, latency_s: float) -> str:
        advice = "/clock is published: start the node with use_sim_time:=true" if self._is_clock_unused else \
            "set the clocks, or play a bag with /clock"
        return f"stamps {_latency_text(latency_s)} before the node's clock: {advice}"

    def _connection_issues(self, record: InputRecord, waiting_ns: int) -> list[_Issue]:
        """Return the issues of the connection: incompatible QoS, two publishers, or no first message."""
        topic, issues = record.input.topic, []
        if topic in self._incompatible:
            issues.append((Level.ERROR, f"incompatible QoS: {self._incompatible[topic]}"))
        if self._duplicate_publishers.get(topic):
            issues.append((Level.ERROR, self._duplicate_publishers[topic]))
        waited = self.start_ns is not None and waiting_ns - self.start_ns >= FIRST_MESSAGE_TIMEOUT_NS
        if waited and record.last_arrival_ns is None:
            publishers = self._publishers.get(topic)
            waited_s = (waiting_ns - (self.start_ns or 0)) * 1e-9
            if publishers:
                hint = f"no message for {waited_s:.0f} s from {publishers} publisher(s): QoS mismatch, or none is sent"
            else:
                hint = f"no message for {waited_s:.0f} s since the start"
                hint += ": no publisher, start the driver or check the topic name" if publishers == 0 else ""
            if record.input.required:
                issues.append((Level.ERROR, f"required input: {hint}"))
            elif (publishers and not record.input.is_occasional) or record.input.is_configured:
                issues.append((Level.WARN, hint))
        return issues


def _message(factory: MessageFactory, state: _InputState, now_ns: int) -> Any:
    record = state.record
    return factory.encode(
        "ship_msgs/msg/InputHealth",
        header={"stamp": now_ns, "frame_id": ""},
        topic=record.input.topic,
        received=record.received,
        accepted=record.accepted,
        rejected=record.rejected,
        rate_hz=state.rate_hz,
        latency_s=state.latency_s,
        age_s=state.age_s,
        level=int(state.level),
        reasons=[reason.word for reason in record.reasons],
        reason_counts=list(record.reasons.values()),
    )


def _rejection_issues(record: InputRecord, waiting_ns: int) -> list[_Issue]:
    last = record.last_rejection
    if last is None or record.last_rejection_ns is None:
        return []
    if record.consecutive_future_stamps >= FUTURE_STAMPS_ERROR:
        text = f"clock offset: {record.consecutive_future_stamps} stamps in a row in the future; {last.text}"
        return [(Level.ERROR, text)]
    if record.consecutive_rejections >= REJECTIONS_WARN:
        level = Level.ERROR if record.consecutive_rejections >= REJECTIONS_ERROR else Level.WARN
        return [(level, f"{record.consecutive_rejections} rejected in a row, last {last.reason.word}: {last.text}")]
    if waiting_ns - record.last_rejection_ns <= REJECTION_SHOWN_NS and last.reason not in _EXPECTED_REASONS:
        return [(Level.WARN, f"rejected, {last.reason.word}: {last.text}")]
    return []


def _rate_text(record: InputRecord, rate_hz: float) -> str:
    return f"messages: {record.received}" if math.isnan(rate_hz) else f"{rate_hz:.1f} Hz"


def _latency_text(latency_s: float) -> str:
    return "unknown" if math.isnan(latency_s) else duration_text(round(latency_s * 1e9))


def _timeout_issues(record: InputRecord, waiting_ns: int) -> list[_Issue]:
    if record.last_arrival_ns is None or record.input.is_occasional:
        return []
    elapsed_ns = waiting_ns - record.last_arrival_ns
    expected_ns = max(MIN_TIMEOUT_NS, TIMEOUT_PERIODS * record.mean_period_ns)
    if elapsed_ns <= (FIRST_MESSAGE_TIMEOUT_NS if math.isnan(record.mean_period_ns) else expected_ns):
        return []
    level = Level.ERROR if record.input.required and elapsed_ns > TIMEOUT_ERROR_NS else Level.WARN
    return [(level, f"no data for {elapsed_ns * 1e-9:.1f} s")]
