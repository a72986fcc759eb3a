"""What has come on one input topic: counts, rate, latency, age, refusals in a row. Time only from arguments, ns."""

import math
import statistics
from collections import Counter, deque

from ship_node.edge.topics import InputTopic

WINDOW = 50
"""Arrivals from which rate and latency are taken."""

LATE_EDGES_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Upper edges of the histogram of the delays of late messages, s."""


class InputRecord:
    """The book of one topic.

    Attributes:
        input: the topic.
        received, accepted, rejected: messages since the start.
        reasons: how often each reason was met, in order of first appearance.
        noted: of these, with messages that were used all the same.
        late_delays: late messages per bin of :data:`LATE_EDGES_S`, and above.
        refused_in_a_row: messages refused since the last accepted one.
        future_in_a_row: likewise, stamped in the future.
        last_refusal_ns: when the last message was refused, in the time of waiting; None where none was.
        last_refusal: its reason.
        last_text: what was said about it.
        is_too_old: whether the last accepted one was stamped too long before the node's clock.
        last_arrival_ns: when the last message came, in the time of waiting; None where none has.
    """

    def __init__(self, input_topic: InputTopic) -> None:
        self.input = input_topic
        self.received = self.accepted = self.rejected = 0
        self.reasons: Counter[str] = Counter()
        self.noted: Counter[str] = Counter()
        self.late_delays = [0] * (len(LATE_EDGES_S) + 1)
        self.forget_times()

    def forget_times(self) -> None:
        """Keep the counts, start anew with everything that has to do with time."""
        self.refused_in_a_row = self.future_in_a_row = 0
        self.last_refusal_ns: int | None = None
        self.last_refusal = self.last_text = ""
        self.last_arrival_ns: int | None = None
        self.is_too_old = False
        self._newest_stamp_ns: int | None = None
        self._intervals_ns: deque[int] = deque(maxlen=WINDOW)
        self._latencies_ns: deque[int] = deque(maxlen=WINDOW)

    def add_arrival(self, waiting_ns: int) -> None:
        """A message came."""
        self.received += 1
        if self.last_arrival_ns is not None:
            self._intervals_ns.append(waiting_ns - self.last_arrival_ns)
        self.last_arrival_ns = waiting_ns

    def add_accepted(self, stamp_ns: int, receive_ns: int, max_age_ns: int) -> None:
        """A message was used; that ends a run of refusals. One older than ``max_age_ns`` counts for ``clock``."""
        self.accepted += 1
        self.refused_in_a_row = self.future_in_a_row = 0
        self._latencies_ns.append(receive_ns - stamp_ns)
        self.is_too_old = receive_ns - stamp_ns > max_age_ns
        if self.is_too_old:
            self.reasons["clock"] += 1
        if self._newest_stamp_ns is None or stamp_ns > self._newest_stamp_ns:
            self._newest_stamp_ns = stamp_ns

    def add_rejected(self, reason: str, text: str, waiting_ns: int, receive_ns: int, stamp_ns: int | None) -> None:
        """A message was refused; the delay of a late one goes into the histogram."""
        self.rejected += 1
        self.reasons[reason] += 1
        self.refused_in_a_row += 1
        self.future_in_a_row = self.future_in_a_row + 1 if reason == "future" else 0
        self.last_refusal_ns, self.last_refusal, self.last_text = waiting_ns, reason, text
        if reason == "late" and stamp_ns is not None:
            delay_s = (receive_ns - stamp_ns) * 1e-9
            self.late_delays[sum(delay_s > edge for edge in LATE_EDGES_S)] += 1

    def add_overflow(self, count: int, why: str, waiting_ns: int) -> None:
        """Messages were cut; that says nothing about those that were looked at."""
        self.received += count
        self.rejected += count
        self.reasons["overflow"] += count
        self.last_refusal_ns, self.last_refusal = waiting_ns, "overflow"
        self.last_text = f"{self.reasons['overflow']} messages cut, the last {why}"

    @property
    def mean_period_ns(self) -> float:
        """Mean time between arrivals, NaN before three came.

        The longest interval is left out, so that one gap does not hide the next.
        """
        if len(self._intervals_ns) < 2:
            return math.nan
        return (sum(self._intervals_ns) - max(self._intervals_ns)) / (len(self._intervals_ns) - 1)

    def rate_hz(self, waiting_ns: int) -> float:
        """Mean rate of arrival, a silence that is longer than any interval included; NaN before two came."""
        if self.last_arrival_ns is None or not self._intervals_ns:
            return math.nan
        since_ns = waiting_ns - self.last_arrival_ns
        silence_ns = since_ns if since_ns > max(self._intervals_ns) else 0
        span_ns = sum(self._intervals_ns) + silence_ns
        return len(self._intervals_ns) * 1e9 / span_ns if span_ns > 0 else math.nan

    @property
    def latency_s(self) -> float:
        """Median time from stamp to arrival of the accepted ones, NaN before one came."""
        return statistics.median(self._latencies_ns) * 1e-9 if self._latencies_ns else math.nan

    def age_s(self, now_ns: int) -> float:
        """Time since the newest stamp accepted, NaN before one came."""
        return math.nan if self._newest_stamp_ns is None else (now_ns - self._newest_stamp_ns) * 1e-9
