"""What ``input_health`` says of one topic, by one node or by several that read it."""

import math
from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_watch.names import LONGEST_NAME, MOST_NAMES
from ship_watch.picture import InputShown

WINDOW_NS = 60_000_000_000
"""Refusals of so long are counted, ns."""

LEAST_SILENCE_NS = 2_000_000_000
"""Nothing shorter is silence, ns."""

SILENT_PERIODS = 3.0

UNKNOWN_PERIOD_NS = 5_000_000_000
"""So long may a topic be silent whose rate is not known yet, ns."""

_FORGOTTEN_NS = 10_000_000_000
"""A node that has not reported for so long reports no more, ns."""

_MOST_REPORTERS = 16
"""Nodes that report on one topic."""

_MOST_REPORTS = 1000
"""Reports with refusals that are kept: those of a minute, of sixteen nodes, once a second."""

_REPORT_PERIOD_NS = 1_000_000_000.0
"""How often a node reports, as long as that is not known from its reports, ns."""


@dataclass
class _Reporter:
    """One of the nodes that report on the topic: its last report. The message does not name the node."""

    number: int
    stamp_ns: int
    heard_ns: int
    received: int
    accepted: int
    rejected: int
    reasons: dict[str, int]

    def may_go_on_with(self, other: "_Reporter") -> bool:
        """Whether this may be the same node's next report: its counters never go back."""
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
        topic: its name.
        longest_s: it is silent when it has not come for so long, s; 0 for three periods, 2 s at least.

    Attributes:
        topic: its name.
        arrived_ns: when its last message arrived, by the caller's time; None where none was ever told.
        reported_ns: when the last report came.
        rate_hz: mean rate of arrival; NaN before it is known.
        period_ns: the usual time between two messages, ns; NaN where unknown.
        used: messages used so far, by the node that has used most of them.
    """

    def __init__(self, topic: str, longest_s: float = 0.0) -> None:
        self.topic = topic
        self._longest_ns = longest_s * 1e9
        self.arrived_ns: int | None = None
        self.reported_ns: int | None = None
        self.rate_hz = math.nan
        self.period_ns = math.nan
        self.used = 0
        self._latency_s = math.nan
        self._report_period_ns = _REPORT_PERIOD_NS
        self._level = 0
        self._has_come = False
        self._reporters: list[_Reporter] = []
        self._silence_ns = self._silence()
        self._nodes = 0
        self._refused: deque[tuple[int, int, int, dict[str, int]]] = deque(maxlen=_MOST_REPORTS)

    def note(self, message: Any, now_ns: int) -> bool:
        """Take a report; the answer is whether it comes from a node that has started since the last one."""
        reasons = zip(message.reasons, message.reason_counts, strict=False)
        report = _Reporter(
            0,
            ns_from_stamp(message.header.stamp),
            now_ns,
            int(message.received),
            int(message.accepted),
            int(message.rejected),
            {str(word)[:LONGEST_NAME]: int(count) for word, count in islice(reasons, MOST_NAMES)},
        )
        self.reported_ns = now_ns
        self.rate_hz, self._latency_s, self._level = float(message.rate_hz), float(message.latency_s), message.level
        is_new, before = self._assign(report)
        if report.received:
            self._note_arrival(message, report, before)
        self.used = max(reporter.accepted for reporter in self._reporters)
        self._silence_ns = self._silence()
        return is_new

    def heard(self, now_ns: int) -> None:
        """Take note that a message of the topic itself came, or a word on one."""
        self.arrived_ns = now_ns if self.arrived_ns is None else max(self.arrived_ns, now_ns)

    @property
    def is_expected(self) -> bool:
        """Whether a node misses the topic and nothing of it ever came to that node, whoever else may hear it."""
        return self._level > 0 and bool(self._reporters) and not any(one.received for one in self._reporters)

    def age_s(self, now_ns: int) -> float:
        """Time since the last message arrived, s; infinite where none did.

        Between two reports it stands as long as messages came until the last: they are not told one by one.
        """
        if self.arrived_ns is None:
            return math.inf
        if self._has_come and self.reported_ns is not None and self.is_fresh(now_ns):
            now_ns = self.reported_ns
        return max(0, now_ns - self.arrived_ns) * 1e-9

    def is_silent(self, now_ns: int) -> bool:
        """Whether it has not come for too long.

        After a report that messages came, only the next report can tell that they ceased. A report that is late, as on
        a busy computer, is no silence. Reports that have ceased, too, are (:meth:`is_untold`).
        """
        if self.arrived_ns is None or (self._has_come and not self.is_untold(now_ns)):
            return False
        return now_ns - self.arrived_ns >= self._silence_ns

    def _silence(self) -> float:
        """After how long it is silent, ns.

        A report says nothing of a message that came after it, so that reports that are rare lengthen this.
        """
        is_unknown = math.isnan(self.period_ns)
        period_ns = 0.0 if is_unknown else self.period_ns
        least_ns = UNKNOWN_PERIOD_NS if is_unknown else LEAST_SILENCE_NS
        limit_ns = self._longest_ns or max(least_ns, SILENT_PERIODS * period_ns)
        return max(limit_ns, 1.5 * self._report_period_ns + period_ns)

    def is_untold(self, now_ns: int) -> bool:
        """Whether the node that reads it has not reported for three of its periods."""
        return self.reported_ns is not None and now_ns - self.reported_ns > 3.0 * self._report_period_ns

    def is_fresh(self, now_ns: int) -> bool:
        """Whether the last report is no older than reports usually are."""
        return self.reported_ns is not None and now_ns - self.reported_ns <= 1.5 * self._report_period_ns

    def shown(self, now_ns: int) -> InputShown:
        """What is shown of the topic."""
        while self._refused and now_ns - self._refused[0][0] > WINDOW_NS:
            self._refused.popleft()
        # Nodes that read the same messages refuse the same: of each number the largest of any node.
        refused_by: dict[int, int] = {}
        reasons_by: dict[tuple[int, str], int] = {}
        for _, number, count, grown in self._refused:
            refused_by[number] = refused_by.get(number, 0) + count
            for word, more in grown.items():
                reasons_by[number, word] = reasons_by.get((number, word), 0) + more
        reasons: dict[str, int] = {}
        for (_, word), count in reasons_by.items():
            reasons[word] = max(reasons.get(word, 0), count)
        refused = max(refused_by.values(), default=0)
        age_s = self.age_s(now_ns)
        return InputShown(self.topic, self.rate_hz, self._latency_s, age_s, int(self._level), refused, reasons)

    def _note_arrival(self, message: Any, report: _Reporter, before: _Reporter | None) -> None:
        """When the last message came: as long ago as its stamp is older than stamps are at arrival in the mean.

        Of refused messages the report tells no stamp. They came after the last report, a period apart. While nothing
        comes the mean rate sinks, and tells no longer what is usual.
        """
        come = report.received - (before.received if before else 0)
        self._has_come = come > 0
        if self._has_come and message.rate_hz > 0.0:
            self.period_ns = 1e9 / float(message.rate_hz)
        since_s = float(message.age_s - message.latency_s)
        if math.isfinite(since_s):
            self.heard(report.heard_ns - round(max(since_s, 0.0) * 1e9))
        if before and self._has_come and (self.arrived_ns is None or self.arrived_ns <= before.heard_ns):
            passed_ns = 0.0 if math.isnan(self.period_ns) else come * self.period_ns
            self.heard(min(report.heard_ns, before.heard_ns + round(passed_ns)))

    def _assign(self, report: _Reporter) -> tuple[bool, _Reporter | None]:
        """Put the report in the place of the one before it; of several that it may follow, of the oldest.

        Returns:
            Whether a node has started since; the report before it, None where there is none.
        """
        before = min(
            (known for known in self._reporters if known.may_go_on_with(report)),
            key=lambda known: known.stamp_ns,
            default=None,
        )
        if before is None:
            is_new = bool(self._reporters)
            fresh = [known for known in self._reporters if report.heard_ns - known.heard_ns < _FORGOTTEN_NS]
            self._reporters = fresh[-_MOST_REPORTERS:]
            self._nodes += 1
            report.number = self._nodes
            self._reporters.append(report)
            return is_new, None
        if before.heard_ns < report.heard_ns:
            self._report_period_ns = min(max(float(report.heard_ns - before.heard_ns), 1e8), 1e10)
        report.number = before.number
        grown = {word: n - before.reasons.get(word, 0) for word, n in report.reasons.items()}
        grown = {word: n for word, n in grown.items() if n > 0}
        if grown:
            self._refused.append((report.heard_ns, report.number, report.rejected - before.rejected, grown))
        self._reporters[self._reporters.index(before)] = report
        return False, before
