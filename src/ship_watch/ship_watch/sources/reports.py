"""Reports on one input topic in ``input_health``, from one or several nodes that read the topic."""

import math
from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_watch.suite_state import InputState
from ship_watch.topics import MAX_NAME_LENGTH, MAX_NAMES

WINDOW_NS = 60_000_000_000
"""Time over which rejections are counted, ns."""

MIN_TIMEOUT_NS = 2_000_000_000
"""Minimum timeout of a topic without a configured timeout, ns."""

TIMEOUT_PERIODS = 3.0
"""Timeout of a topic without a configured timeout, in message periods."""

UNKNOWN_RATE_TIMEOUT_NS = 5_000_000_000
"""Timeout of a topic without a configured timeout whose rate is not known yet, ns."""

_REPORTER_TIMEOUT_NS = 10_000_000_000
"""Time without a report after which a node no longer counts as reporting, ns."""

_MAX_REPORTERS = 16
"""Maximum number of nodes that report on one topic."""

_MAX_REPORTS = 1000
"""Maximum number of reports with rejections that are kept: one a second from sixteen nodes for a minute."""

_REPORT_PERIOD_NS = 1_000_000_000.0
"""Report period of a node until it is known from its reports, ns."""


@dataclass
class _Reporter:
    """Last report of one node on the topic. A report does not contain the name of the node."""

    number: int
    stamp_ns: int
    received_ns: int
    received: int
    accepted: int
    rejected: int
    reasons: dict[str, int]

    def may_precede(self, other: "_Reporter") -> bool:
        """True if ``other`` may be the next report of the same node, whose counters never decrease."""
        return (
            other.stamp_ns > self.stamp_ns
            and other.received >= self.received
            and other.accepted >= self.accepted
            and other.rejected >= self.rejected
            and all(other.reasons.get(word, 0) >= count for word, count in self.reasons.items())
        )


class TopicReports:
    """All reports on one topic.

    Args:
        topic: name of the topic.
        timeout_s: time without a message after which the topic is timed out, s; 0 for three periods, at least 2 s.

    Attributes:
        topic: name of the topic.
        arrived_ns: arrival of the last message of the topic, caller's time, ns; None before the first message.
        reported_ns: arrival of the last report, caller's time, ns; None before the first report.
        rate_hz: mean rate of arrival, Hz; NaN until it is known.
        period_ns: usual time between two messages, ns; NaN if unknown.
        used: largest number of messages that one node has used so far.
    """

    def __init__(self, topic: str, timeout_s: float = 0.0) -> None:
        self.topic = topic
        self._configured_timeout_ns = timeout_s * 1e9
        self.arrived_ns: int | None = None
        self.reported_ns: int | None = None
        self.rate_hz = math.nan
        self.period_ns = math.nan
        self.used = 0
        self._latency_s = math.nan
        self._report_period_ns = _REPORT_PERIOD_NS
        self._level = 0
        self._has_new_messages = False
        self._reporters: list[_Reporter] = []
        self._timeout_ns = self._computed_timeout_ns()
        self._node_count = 0
        self._rejections: deque[tuple[int, int, int, dict[str, int]]] = deque(maxlen=_MAX_REPORTS)

    def record_report(self, message: Any, now_ns: int) -> bool:
        """Record a report; return True if it is from a node that has started since the last report."""
        reasons = zip(message.reasons, message.reason_counts, strict=False)
        report = _Reporter(
            0,
            ns_from_stamp(message.header.stamp),
            now_ns,
            int(message.received),
            int(message.accepted),
            int(message.rejected),
            {str(word)[:MAX_NAME_LENGTH]: int(count) for word, count in islice(reasons, MAX_NAMES)},
        )
        self.reported_ns = now_ns
        self.rate_hz, self._latency_s, self._level = float(message.rate_hz), float(message.latency_s), message.level
        is_new, before = self._match_reporter(report)
        if report.received:
            self._update_arrival(message, report, before)
        self.used = max(reporter.accepted for reporter in self._reporters)
        self._timeout_ns = self._computed_timeout_ns()
        return is_new

    def record_arrival(self, now_ns: int) -> None:
        """Record the arrival of a message of the topic, ns."""
        self.arrived_ns = now_ns if self.arrived_ns is None else max(self.arrived_ns, now_ns)

    @property
    def is_never_received(self) -> bool:
        """True if a node reports the topic as missing and no reporting node has ever received it."""
        return self._level > 0 and bool(self._reporters) and not any(one.received for one in self._reporters)

    def age_s(self, now_ns: int) -> float:
        """Return the time since the last message arrived, s; infinite before the first message.

        Single arrivals are not reported, so the time stays constant after a report with new messages, as long as this
        report is recent (:meth:`is_report_recent`).
        """
        if self.arrived_ns is None:
            return math.inf
        if self._has_new_messages and self.reported_ns is not None and self.is_report_recent(now_ns):
            now_ns = self.reported_ns
        return max(0, now_ns - self.arrived_ns) * 1e-9

    def is_timed_out(self, now_ns: int) -> bool:
        """True if no message arrived within the timeout.

        After a report with new messages, only the next report can show that the messages have stopped. A late report,
        as on a busy computer, is no timeout of the topic until the report is overdue (:meth:`is_report_overdue`).
        """
        if self.arrived_ns is None or (self._has_new_messages and not self.is_report_overdue(now_ns)):
            return False
        return now_ns - self.arrived_ns >= self._timeout_ns

    def _computed_timeout_ns(self) -> float:
        """Return the timeout of the topic, ns.

        A report does not include messages that arrive after it, so that a long report period lengthens the timeout.
        """
        is_unknown = math.isnan(self.period_ns)
        period_ns = 0.0 if is_unknown else self.period_ns
        least_ns = UNKNOWN_RATE_TIMEOUT_NS if is_unknown else MIN_TIMEOUT_NS
        limit_ns = self._configured_timeout_ns or max(least_ns, TIMEOUT_PERIODS * period_ns)
        return max(limit_ns, 1.5 * self._report_period_ns + period_ns)

    def is_report_overdue(self, now_ns: int) -> bool:
        """True if the node that reads the topic has not reported for three report periods."""
        return self.reported_ns is not None and now_ns - self.reported_ns > 3.0 * self._report_period_ns

    def is_report_recent(self, now_ns: int) -> bool:
        """True if the last report is at most 1.5 report periods old."""
        return self.reported_ns is not None and now_ns - self.reported_ns <= 1.5 * self._report_period_ns

    def input_state(self, now_ns: int) -> InputState:
        """Return the displayed state of the topic."""
        while self._rejections and now_ns - self._rejections[0][0] > WINDOW_NS:
            self._rejections.popleft()
        # Nodes that read the same messages reject the same messages, so the largest count of one node is taken.
        refused_by: dict[int, int] = {}
        reasons_by: dict[tuple[int, str], int] = {}
        for _, number, count, grown in self._rejections:
            refused_by[number] = refused_by.get(number, 0) + count
            for word, more in grown.items():
                reasons_by[number, word] = reasons_by.get((number, word), 0) + more
        reasons: dict[str, int] = {}
        for (_, word), count in reasons_by.items():
            reasons[word] = max(reasons.get(word, 0), count)
        refused = max(refused_by.values(), default=0)
        age_s = self.age_s(now_ns)
        return InputState(self.topic, self.rate_hz, self._latency_s, age_s, int(self._level), refused, reasons)

    def _update_arrival(self, message: Any, report: _Reporter, before: _Reporter | None) -> None:
        """Update the period of the topic and the arrival of the last message from a report.

        The arrival is the time of the report minus the difference of the message's age and the mean latency. A report
        contains no stamps of rejected messages, which are assumed to arrive after the previous report, one period
        apart. Without new messages the mean rate decreases, so the period is then not updated.
        """
        come = report.received - (before.received if before else 0)
        self._has_new_messages = come > 0
        if self._has_new_messages and message.rate_hz > 0.0:
            self.period_ns = 1e9 / float(message.rate_hz)
        since_s = float(message.age_s - message.latency_s)
        if math.isfinite(since_s):
            self.record_arrival(report.received_ns - round(max(since_s, 0.0) * 1e9))
        if before and self._has_new_messages and (self.arrived_ns is None or self.arrived_ns <= before.received_ns):
            passed_ns = 0.0 if math.isnan(self.period_ns) else come * self.period_ns
            self.record_arrival(min(report.received_ns, before.received_ns + round(passed_ns)))

    def _match_reporter(self, report: _Reporter) -> tuple[bool, _Reporter | None]:
        """Replace the previous report of the same node; the oldest report if several may be the previous report.

        The report period and the new rejections are recorded too.

        Returns:
            True if a new node reports after another node; and the previous report of the same node, or None.
        """
        before = min(
            (known for known in self._reporters if known.may_precede(report)),
            key=lambda known: known.stamp_ns,
            default=None,
        )
        if before is None:
            is_new = bool(self._reporters)
            fresh = [
                known for known in self._reporters if report.received_ns - known.received_ns < _REPORTER_TIMEOUT_NS
            ]
            self._reporters = fresh[-_MAX_REPORTERS:]
            self._node_count += 1
            report.number = self._node_count
            self._reporters.append(report)
            return is_new, None
        if before.received_ns < report.received_ns:
            self._report_period_ns = min(max(float(report.received_ns - before.received_ns), 1e8), 1e10)
        report.number = before.number
        grown = {word: n - before.reasons.get(word, 0) for word, n in report.reasons.items()}
        grown = {word: n for word, n in grown.items() if n > 0}
        if grown:
            self._rejections.append((report.received_ns, report.number, report.rejected - before.rejected, grown))
        self._reporters[self._reporters.index(before)] = report
        return False, before
