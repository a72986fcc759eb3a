"""Statistics of the input topics: counts, rate, latency, age, consecutive rejections.

All times come from the arguments, ns. The statistics are evaluated in :mod:`ship_node.health.input_health`.
"""

import itertools
import math
from collections import Counter, deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.inputs_outputs import InputTopic

WINDOW = 50
"""Number of intervals between arrivals for the rate, and number of accepted messages for the latency."""

MAX_AGE_S = 10.0
"""Maximum age of a stamp, s; an older stamp shows a wrong clock or a bag played without /clock."""

DELAY_BIN_EDGES_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Upper edges of the histogram of the delays of late messages, s."""

_MAX_FAILURES = 20


class InputRecord:
    """Statistics of one topic.

    Attributes:
        input: the topic.
        received, accepted, rejected: numbers of messages since the start.
        reasons: number of rejections and remarks by reason, in order of first appearance.
        note_counts: number of remarks by reason; ``reasons`` includes these remarks.
        late_delays: number of late messages per bin of :data:`DELAY_BIN_EDGES_S`; the last bin is above all edges.
        consecutive_rejections: number of rejections since the last accepted message; messages of a source that is
            switched off and messages dropped unread do not count.
        consecutive_future_stamps: number of messages in a row that were rejected for a stamp in the future.
        last_rejection_ns: timeout-clock time of the last rejection; None if there was none.
        last_rejection: the last rejection; None if there was none.
        is_too_old: True if the last accepted stamp was older than the maximum age.
        last_arrival_ns: timeout-clock time of the last message; None if there was none.
    """

    def __init__(self, input_topic: InputTopic) -> None:
        self.input = input_topic
        self.received = self.accepted = self.rejected = 0
        self.reasons: Counter[Reason] = Counter()
        self.note_counts: Counter[Reason] = Counter()
        self.late_delays = [0] * (len(DELAY_BIN_EDGES_S) + 1)
        self.reset_times()

    def reset_times(self) -> None:
        """Reset everything that depends on time; keep the counts."""
        self.last_rejection_ns: int | None = None
        self.last_rejection: Rejection | None = None
        self.last_arrival_ns: int | None = None
        self._intervals_ns: deque[int] = deque(maxlen=WINDOW)
        self.reset_stamps()

    def reset_stamps(self) -> None:
        """Reset everything that depends on stamps; keep the counts and the arrival times."""
        self.consecutive_rejections = self.consecutive_future_stamps = 0
        self.is_too_old = False
        self._newest_stamp_ns: int | None = None
        self._latencies_ns: deque[int] = deque(maxlen=WINDOW)

    def add_arrival(self, waiting_ns: int) -> None:
        """Count the arrival of a message."""
        self.received += 1
        if self.last_arrival_ns is not None:
            self._intervals_ns.append(waiting_ns - self.last_arrival_ns)
        self.last_arrival_ns = waiting_ns

    def add_block(self, arrivals_ns: np.ndarray, stamps_ns: np.ndarray, max_age_ns: int) -> None:
        """Count a block of used messages as :meth:`add_arrival` and :meth:`add_accepted` count single messages.

        Args:
            arrivals_ns: receive times, equal by both clocks, shape (N,).
            stamps_ns: stamps in ascending order, shape (N,).
            max_age_ns: see :meth:`add_accepted`.
        """
        self.received += len(arrivals_ns)
        self.accepted += len(arrivals_ns)
        self.consecutive_rejections = self.consecutive_future_stamps = 0
        arrivals = arrivals_ns[-WINDOW - 1 :].tolist()
        if self.last_arrival_ns is not None and len(arrivals_ns) <= WINDOW:
            arrivals.insert(0, self.last_arrival_ns)
        self._intervals_ns.extend(later - earlier for earlier, later in itertools.pairwise(arrivals))
        self.last_arrival_ns = arrivals[-1]
        ages_ns = arrivals_ns - stamps_ns
        self._latencies_ns.extend(ages_ns[-WINDOW:].tolist())
        too_old = int(np.count_nonzero(ages_ns > max_age_ns))
        self.is_too_old = bool(ages_ns[-1] > max_age_ns)
        if too_old:
            self.reasons[Reason.CLOCK] += too_old
            self.note_counts[Reason.CLOCK] += too_old
        if self._newest_stamp_ns is None or stamps_ns[-1] > self._newest_stamp_ns:
            self._newest_stamp_ns = int(stamps_ns[-1])

    def add_accepted(self, stamp_ns: int, receive_ns: int, max_age_ns: int) -> None:
        """Count a used message and end a run of rejections; a stamp older than ``max_age_ns`` adds a remark CLOCK."""
        self.accepted += 1
        self.consecutive_rejections = self.consecutive_future_stamps = 0
        self._latencies_ns.append(receive_ns - stamp_ns)
        self.is_too_old = receive_ns - stamp_ns > max_age_ns
        if self.is_too_old:
            self.reasons[Reason.CLOCK] += 1
            self.note_counts[Reason.CLOCK] += 1
        if self._newest_stamp_ns is None or stamp_ns > self._newest_stamp_ns:
            self._newest_stamp_ns = stamp_ns

    def add_rejected(self, rejection: Rejection, waiting_ns: int, receive_ns: int, stamp_ns: int | None) -> None:
        """Count a rejected message; the delay of a late message is added to the histogram."""
        self.rejected += 1
        self.reasons[rejection.reason] += 1
        # A source that is switched off may be good: its messages do not count as consecutive rejections.
        self.consecutive_rejections += rejection.reason is not Reason.OFF
        self.consecutive_future_stamps = self.consecutive_future_stamps + 1 if rejection.reason is Reason.FUTURE else 0
        self.last_rejection_ns, self.last_rejection = waiting_ns, rejection
        if rejection.reason is Reason.LATE and stamp_ns is not None:
            delay_s = (receive_ns - stamp_ns) * 1e-9
            self.late_delays[sum(delay_s > edge for edge in DELAY_BIN_EDGES_S)] += 1

    def add_dropped(self, count: int, reason: Reason, why: str, waiting_ns: int) -> None:
        """Count messages that were dropped unread; the count of consecutive rejections stays."""
        self.received += count
        self.rejected += count
        self.reasons[reason] += count
        if reason is Reason.BEHIND:
            # The node drops messages that have arrived, so there is no timeout.
            self.last_arrival_ns = waiting_ns
        else:
            why = f"{self.reasons[reason]} messages dropped, the last {why}"
        self.last_rejection_ns, self.last_rejection = waiting_ns, Rejection(reason, why)

    @property
    def mean_period_ns(self) -> float:
        """Mean time between arrivals, ns; NaN before three messages.

        The longest interval is left out, so that one gap does not hide the next.
        """
        if len(self._intervals_ns) < 2:
            return math.nan
        return (sum(self._intervals_ns) - max(self._intervals_ns)) / (len(self._intervals_ns) - 1)

    def rate_hz(self, waiting_ns: int) -> float:
        """Return the mean arrival rate, Hz; NaN before two messages.

        The time since the last message is added to the time span if it is longer than every stored interval.
        """
        if self.last_arrival_ns is None or not self._intervals_ns:
            return math.nan
        since_ns = waiting_ns - self.last_arrival_ns
        gap_ns = since_ns if since_ns > max(self._intervals_ns) else 0
        span_ns = sum(self._intervals_ns) + gap_ns
        return len(self._intervals_ns) * 1e9 / span_ns if span_ns > 0 else math.nan

    @property
    def latency_s(self) -> float:
        """Median time from the stamp of an accepted message to its arrival, s; NaN if there was none yet.

        If the core decides later on a message, the time of the decision replaces the arrival.
        """
        if not self._latencies_ns:
            return math.nan
        ordered, middle = sorted(self._latencies_ns), len(self._latencies_ns) // 2
        # For an odd number of values both indices are the same.
        return 0.5 * (ordered[middle] + ordered[~middle]) * 1e-9

    def age_s(self, now_ns: int) -> float:
        """Return the time since the newest accepted stamp, s; NaN if there was none yet."""
        return math.nan if self._newest_stamp_ns is None else (now_ns - self._newest_stamp_ns) * 1e-9


class InputRecords:
    """Statistics of all inputs of a node, updated by the adapter and the node runtime.

    Rates and timeouts are measured by the timeout clock (:class:`ship_node.adapters.adapter.Adapter`), ages and
    latencies by the node's clock.

    Args:
        inputs: the input topics; any other topic raises KeyError.
        max_age_s: maximum age of a stamp, s; see :data:`MAX_AGE_S`.

    Attributes:
        records: topic → its statistics.
        start_ns: first timeout-clock time; None before the first call with a time.
    """

    def __init__(self, inputs: Iterable[InputTopic], max_age_s: float = MAX_AGE_S) -> None:
        self._max_age_ns = round(max_age_s * 1e9)
        self.records = {input_topic.topic: InputRecord(input_topic) for input_topic in inputs}
        self.start_ns: int | None = None
        self._waiting_ns: int | None = None
        self._failures: deque[str] = deque(maxlen=_MAX_FAILURES)

    def record_input(
        self,
        topic: str,
        waiting_ns: int,
        receive_ns: int,
        reading: ReadMessage[Any],
        rejection: Rejection | None,
        is_used: bool,
    ) -> None:
        """Record a message that was read, and the immediate result.

        Args:
            topic: the input topic.
            waiting_ns: receive time by the timeout clock.
            receive_ns: receive time by the node's clock.
            reading: the message as read.
            rejection: reason of a rejection; None if the message was used, or if a decision follows later.
            is_used: True if a message without rejection counts as used at once.
        """
        self.record_arrival(topic, waiting_ns)
        if not reading.covariance_known:
            self.record_note(topic, Reason.COVARIANCE_UNKNOWN)
        for _, part_rejection in reading.rejected_parts:
            self.record_note(topic, part_rejection.reason)
        if rejection is not None:
            self.record_rejected(topic, rejection, receive_ns, reading.value.time_ns)
        elif is_used:
            self.record_accepted(topic, reading.value.time_ns, receive_ns)

    def record_block(
        self, topic: str, receive_ns: np.ndarray, stamps_ns: np.ndarray, covariance_known: bool
    ) -> None:
        """Record a block of messages that were all used, as :meth:`record_input` does for each.

        Args:
            topic: the input topic.
            receive_ns: receive times, equal by both clocks, shape (N,).
            stamps_ns: stamps in ascending order, shape (N,).
            covariance_known: True if the messages give a covariance.
        """
        self._now(int(receive_ns[0]))
        self._now(int(receive_ns[-1]))
        record = self.records[topic]
        record.add_block(receive_ns, stamps_ns, self._max_age_ns)
        if not covariance_known:
            record.reasons[Reason.COVARIANCE_UNKNOWN] += len(receive_ns)
            record.note_counts[Reason.COVARIANCE_UNKNOWN] += len(receive_ns)

    def record_unreadable(
        self, topic: str, waiting_ns: int, receive_ns: int, stamp_ns: int, rejection: Rejection
    ) -> None:
        """Record a message that was rejected before the core; the receive times are as in :meth:`record_input`."""
        self.record_arrival(topic, waiting_ns)
        self.record_rejected(topic, rejection, receive_ns, stamp_ns)

    def record_decision(self, topic: str, decision: MeasurementDecision[Any], now_ns: int) -> None:
        """Record the decision on a measurement of a topic; a revised decision only adds a remark.

        Args:
            topic: the input topic.
            decision: decision on the measurement.
            now_ns: time of the decision by the node's clock.
        """
        time_ns = decision.measurement.time_ns
        if decision.revised:
            self.record_note(topic, Reason.REVISED)
        elif decision.accepted:
            self.record_accepted(topic, time_ns, now_ns)
            if decision.reason is not Reason.NONE:
                self.record_note(topic, decision.reason)
        else:
            self.record_rejected(topic, Rejection(decision.reason, decision.text), now_ns, time_ns)
        for _, part_rejection in decision.rejected_parts:
            self.record_note(topic, part_rejection.reason)

    def record_arrival(self, topic: str, waiting_ns: int) -> None:
        """Record the arrival of a message at a timeout-clock time."""
        self.records[topic].add_arrival(self._now(waiting_ns))

    def record_accepted(self, topic: str, stamp_ns: int, receive_ns: int) -> None:
        """Record a used message."""
        self.records[topic].add_accepted(stamp_ns, receive_ns, self._max_age_ns)

    def record_rejected(self, topic: str, rejection: Rejection, receive_ns: int, stamp_ns: int | None = None) -> None:
        """Record a rejected message.

        Args:
            topic: the input topic.
            rejection: the reason.
            receive_ns: time of the rejection by the node's clock.
            stamp_ns: stamp of the message; None if the stamp is unusable.
        """
        if rejection.reason is Reason.FAILED:
            self.record_failure(f"{topic}: {rejection.text}")
        waiting_ns = receive_ns if self._waiting_ns is None else self._waiting_ns
        self.records[topic].add_rejected(rejection, waiting_ns, receive_ns, stamp_ns)

    def record_note(self, topic: str, reason: Reason) -> None:
        """Record a remark on a message, for example COVARIANCE_UNKNOWN."""
        self.records[topic].reasons[reason] += 1
        self.records[topic].note_counts[reason] += 1

    def record_dropped(self, topic: str, count: int, reason: Reason, why: str, waiting_ns: int) -> None:
        """Record messages that were dropped unread.

        Args:
            topic: the input topic.
            count: number of messages.
            reason: OVERFLOW if a bound was exceeded, BEHIND if the node is behind.
            why: text for the user about the bound, or about the node that is behind.
            waiting_ns: time of the report by the timeout clock.
        """
        self.records[topic].add_dropped(count, reason, why, self._now(waiting_ns))

    def record_failure(self, text: str) -> None:
        """Record an exception of the suite's own code that was caught, for the log of a live node."""
        self._failures.append(text)

    def take_failures(self) -> list[str]:
        """Return the exceptions recorded since the last call, the newest twenty at most."""
        failures = list(self._failures)
        self._failures.clear()
        return failures

    def restart(self) -> None:
        """Reset everything that depends on time, after the clock went back or the node was reset; keep the counts."""
        self.start_ns = None
        for record in self.records.values():
            record.reset_times()

    def reset_stamps(self) -> None:
        """Reset everything that depends on stamps, after all clocks stepped."""
        for record in self.records.values():
            record.reset_stamps()

    def rejection_and_note_counts(self) -> dict[str, tuple[Counter[Reason], Counter[Reason]]]:
        """Return topic → (rejections by reason, remarks by reason).

        Topics without rejections and remarks are left out.
        """
        return {
            topic: (record.reasons - record.note_counts, record.note_counts)
            for topic, record in self.records.items()
            if record.reasons
        }

    def _now(self, waiting_ns: int) -> int:
        self._waiting_ns = waiting_ns
        if self.start_ns is None:
            self.start_ns = waiting_ns
        return waiting_ns
