"""How the inputs of a node do: a record per topic, judged, for ``input_health`` and ``/diagnostics``."""

import math
from collections import Counter, deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import duration_text, make_header
from ship_node.edge.diagnostics import Level, Status
from ship_node.edge.input_record import LATE_EDGES_S, InputRecord
from ship_node.edge.topics import InputTopic

WATCHDOG_NS = 5_000_000_000
"""A required topic must have come this long after the start, and any topic with publishers, ns."""

REFUSAL_SHOWN_NS = 2_000_000_000
"""A single refusal is shown for this long, ns."""

SILENT_PERIODS = 3.0
SILENCE_ERROR_NS = 1_000_000_000
"""A required topic may not be silent for longer, ns."""

LEAST_SILENCE_NS = 100_000_000
"""Nothing shorter counts as silence: it is judged once per tick, ns."""

MAX_AGE_S = 10.0
"""Age of a stamp beyond which it is of another time, s."""

REFUSALS_WARN = 5
REFUSALS_ERROR = 20
FUTURE_ERROR = 10

_EXPECTED_REASONS = ("gate", "revised")
"""Refusals that good data also meet now and then: only a run of them is worth a warning."""

_FAILED = "failed"
_MOST_FAILURES = 20

_Judgement = tuple[Level, str]


class InputHealthBook:
    """The records of all inputs of a node.

    The adapter calls :meth:`arrived` and then :meth:`accepted` or :meth:`rejected` for each message. What only
    the middleware knows is told by the shell; offline it stays unknown. Rates and silence are judged in the time of
    waiting (:class:`ship_node.edge.adapter.Adapter`), ages and latencies by the node's clock, as stamps are.

    Args:
        inputs: the topics; others are unknown (KeyError).
        max_age_s: stamps further than this before the node's clock are of another time, s.
    """

    def __init__(self, inputs: Iterable[InputTopic], max_age_s: float = MAX_AGE_S) -> None:
        self._max_age_ns = round(max_age_s * 1e9)
        self._is_clock_unused = False
        self._records = {input_topic.topic: InputRecord(input_topic) for input_topic in inputs}
        self._publishers: dict[str, int] = {}
        self._incompatible: dict[str, str] = {}
        self._lost: dict[str, int] = {}
        self._start_ns: int | None = None
        self._waiting_ns: int | None = None
        self._failures: deque[str] = deque(maxlen=_MOST_FAILURES)

    def arrived(self, topic: str, waiting_ns: int) -> None:
        """A message came, in the time of waiting."""
        self._now(waiting_ns)
        self._records[topic].add_arrival(waiting_ns)

    def accepted(self, topic: str, stamp_ns: int, receive_ns: int) -> None:
        """A message was used."""
        self._records[topic].add_accepted(stamp_ns, receive_ns, self._max_age_ns)

    def rejected(self, topic: str, reason: str, text: str, receive_ns: int, stamp_ns: int | None = None) -> None:
        """A message was not used.

        Args:
            topic: the topic that it came on.
            reason: a constant of ship_msgs/Innovation in lower case.
            text: the same for people.
            receive_ns: when it was refused, by the node's clock.
            stamp_ns: its stamp, where there is one to believe.
        """
        if reason == _FAILED:
            self.failed(f"{topic}: {text}")
        waiting_ns = receive_ns if self._waiting_ns is None else self._waiting_ns
        self._records[topic].add_rejected(reason, text, waiting_ns, receive_ns, stamp_ns)

    def overflowed(self, topic: str, count: int, why: str, waiting_ns: int) -> None:
        """So many messages came and were not looked at: they were beyond a bound.

        Args:
            topic: the topic that they came on.
            count: how many.
            why: which bound, for people.
            waiting_ns: when that is told.
        """
        self._records[topic].add_overflow(count, why, self._now(waiting_ns))

    def failed(self, text: str) -> None:
        """Our own code raised, and that was caught: for the log of a live node."""
        self._failures.append(text)

    def take_failures(self) -> list[str]:
        """What failed since the last call, the latest few."""
        failures = list(self._failures)
        self._failures.clear()
        return failures

    def noted(self, topic: str, reason: str) -> None:
        """Something about a message is worth a count, although it may be used, as ``covariance_unknown``."""
        self._records[topic].reasons[reason] += 1
        self._records[topic].noted[reason] += 1

    def restart(self) -> None:
        """The clock went back or the node was reset: counts stay, everything timed starts anew."""
        self._start_ns = None
        for record in self._records.values():
            record.forget_times()

    def publisher_count(self, topic: str, count: int) -> None:
        """How many publishers a topic has now; without any, none is incompatible."""
        self._publishers[topic] = count
        if count == 0:
            self._incompatible.pop(topic, None)

    def incompatible_qos(self, topic: str, text: str) -> None:
        """A publisher's quality of service does not fit: nothing of it will ever arrive."""
        self._incompatible[topic] = text

    def clock_unused(self, is_unused: bool) -> None:
        """Whether somebody publishes /clock and this node does not follow it."""
        self._is_clock_unused = is_unused

    def of_another_time(self) -> str:
        """What there is to say of the first input whose stamps are too old, for the log; empty where none is."""
        old = [record for record in self._records.values() if record.is_too_old]
        return f"{old[0].input.topic}: {self._age_text(old[0])}" if old else ""

    def lost(self, topic: str, count: int) -> None:
        """The middleware lost ``count`` further messages."""
        self._lost[topic] = self._lost.get(topic, 0) + count

    def statuses(self, now_ns: int, waiting_ns: int | None = None) -> list[Status]:
        """One diagnostic status per topic; without a time of waiting it is the node's."""
        waiting_ns = self._now(now_ns if waiting_ns is None else waiting_ns)
        return [self._status(record, now_ns, waiting_ns) for record in self._records.values()]

    def messages(self, factory: MessageFactory, now_ns: int, waiting_ns: int | None = None) -> list[Any]:
        """One ship_msgs/InputHealth per topic; without a time of waiting it is the node's."""
        waiting_ns = self._now(now_ns if waiting_ns is None else waiting_ns)
        return [self._message(factory, record, now_ns, waiting_ns) for record in self._records.values()]

    def refused_and_noted(self) -> dict[str, tuple[Counter[str], Counter[str]]]:
        """Topic → reason → messages that were not used, and messages used with a note, of topics that had either."""
        return {
            topic: (record.reasons - record.noted, record.noted)
            for topic, record in self._records.items()
            if record.reasons
        }

    def _now(self, waiting_ns: int) -> int:
        self._waiting_ns = waiting_ns
        if self._start_ns is None:
            self._start_ns = waiting_ns
        return waiting_ns

    def _message(self, factory: MessageFactory, record: InputRecord, now_ns: int, waiting_ns: int) -> Any:
        return factory.make(
            "ship_msgs/msg/InputHealth",
            header=make_header(factory, now_ns),
            topic=record.input.topic,
            received=record.received,
            accepted=record.accepted,
            rejected=record.rejected,
            rate_hz=record.rate_hz(waiting_ns),
            latency_s=record.latency_s,
            age_s=record.age_s(now_ns),
            level=int(self._judge(record, waiting_ns)[0]),
            reasons=list(record.reasons),
            reason_counts=np.array(list(record.reasons.values()), dtype=np.uint64),
        )

    def _status(self, record: InputRecord, now_ns: int, waiting_ns: int) -> Status:
        level, text = self._judge(record, waiting_ns)
        values = {
            "received": str(record.received),
            "accepted": str(record.accepted),
            "rejected": str(record.rejected),
            "rate [Hz]": f"{record.rate_hz(waiting_ns):.2f}",
            "latency [s]": f"{record.latency_s:.3f}",
            "age [s]": f"{record.age_s(now_ns):.3f}",
        }
        values |= {f"reason {reason}": str(count) for reason, count in record.reasons.items()}
        edges = [f"up to {edge:g} s" for edge in LATE_EDGES_S] + [f"above {LATE_EDGES_S[-1]:g} s"]
        values |= {f"late {edge}": str(n) for edge, n in zip(edges, record.late_delays, strict=True) if n}
        topic = record.input.topic
        if topic in self._publishers:
            values["publishers"] = str(self._publishers[topic])
        if topic in self._lost:
            values["lost by the middleware"] = str(self._lost[topic])
        return Status(f"input {topic}", level, text, values)

    def _judge(self, record: InputRecord, waiting_ns: int) -> _Judgement:
        """The worst that there is to say; the earlier of equals."""
        judgements = [
            *self._judge_connection(record, waiting_ns),
            *([(Level.ERROR, self._age_text(record))] if record.is_too_old else []),
            *_judge_refusals(record, waiting_ns),
            *_judge_silence(record, waiting_ns),
        ]
        if record.received == 0:
            judgements.append((Level.OK, "no message yet"))
        judgements.append((Level.OK, f"{_rate_text(record, waiting_ns)}, latency {_latency_text(record)}"))
        return max(judgements, key=lambda judgement: judgement[0])

    def _age_text(self, record: InputRecord) -> str:
        hint = " /clock is published: start with use_sim_time:=true" if self._is_clock_unused else ""
        return f"stamps {_latency_text(record)} before the node's clock: a bag of another time?{hint}"

    def _judge_connection(self, record: InputRecord, waiting_ns: int) -> list[_Judgement]:
        """Whether messages can come at all."""
        topic, judgements = record.input.topic, []
        if topic in self._incompatible:
            judgements.append((Level.ERROR, f"incompatible QoS: {self._incompatible[topic]}"))
        waited = self._start_ns is not None and waiting_ns - self._start_ns >= WATCHDOG_NS
        if waited and record.last_arrival_ns is None:
            publishers = self._publishers.get(topic)
            waited_s = (waiting_ns - (self._start_ns or 0)) * 1e-9
            if publishers:
                hint = f"{publishers} publisher(s) but no message for {waited_s:.0f} s: QoS mismatch, or it is silent"
            else:
                hint = f"no message for {waited_s:.0f} s since the start"
                hint += ": nobody publishes it" if publishers == 0 else ""
            if record.input.required:
                judgements.append((Level.ERROR, f"required: {hint}"))
            elif publishers or record.input.named:
                judgements.append((Level.WARN, hint))
        return judgements


def _judge_refusals(record: InputRecord, waiting_ns: int) -> list[_Judgement]:
    """Whether what comes can be used."""
    if record.future_in_a_row >= FUTURE_ERROR:
        return [(Level.ERROR, f"clock offset: {record.future_in_a_row} in a row from the future; {record.last_text}")]
    if record.refused_in_a_row >= REFUSALS_WARN:
        level = Level.ERROR if record.refused_in_a_row >= REFUSALS_ERROR else Level.WARN
        run = f"{record.refused_in_a_row} refused in a row"
        return [(level, f"{run}, last {record.last_refusal}: {record.last_text}")]
    recent = record.last_refusal_ns is not None and waiting_ns - record.last_refusal_ns <= REFUSAL_SHOWN_NS
    if recent and record.last_refusal not in _EXPECTED_REASONS:
        return [(Level.WARN, f"refused, {record.last_refusal}: {record.last_text}")]
    return []


def _rate_text(record: InputRecord, waiting_ns: int) -> str:
    rate_hz = record.rate_hz(waiting_ns)
    return f"messages: {record.received}" if math.isnan(rate_hz) else f"{rate_hz:.1f} Hz"


def _latency_text(record: InputRecord) -> str:
    return "nan s" if math.isnan(record.latency_s) else duration_text(round(record.latency_s * 1e9))


def _judge_silence(record: InputRecord, waiting_ns: int) -> list[_Judgement]:
    """Whether it still comes."""
    if record.last_arrival_ns is None:
        return []
    silence_ns = waiting_ns - record.last_arrival_ns
    expected_ns = max(LEAST_SILENCE_NS, SILENT_PERIODS * record.mean_period_ns)
    if silence_ns <= (WATCHDOG_NS if math.isnan(record.mean_period_ns) else expected_ns):
        return []
    level = Level.ERROR if record.input.required and silence_ns > SILENCE_ERROR_NS else Level.WARN
    return [(level, f"silent for {silence_ns * 1e-9:.1f} s")]
