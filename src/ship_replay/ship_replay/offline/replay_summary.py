"""Result of a replay: counts of messages, status history of each output, and exclusions of sources.

A status history contains the share of each status, the spans of one status, and the reasons for poor statuses.
Exclusions and reinstatements, with their times, are read from the Integrity messages.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.stamps import NS_PER_S, ns_from_stamp, utc_text
from ship_estimation.rejection_rules import Reason
from ship_node.adapters.adapter import Adapter
from ship_replay.offline.message_times import LogDelays, MessageTimes, exceeded_limits
from ship_watch.orientations import ORIENTATIONS
from theodolite_calib.adapters.triangulation_adapter import POSITION_TOPIC

STATUS_NAMES = ("VALID", "COASTING", "DEGRADED", "INVALID")
"""Status names, by the values of ship_msgs/ShipAttitude and OpticalAxisPointing."""

STATUS_TOPICS = frozenset((*(orientation.topic for orientation in ORIENTATIONS), POSITION_TOPIC))

_POOR = "DEGRADED", "INVALID"
_ACCEPTED_WITH_NOTE = Reason.COVARIANCE_UNKNOWN.word
"""Reason that is only a note on a used message, and never a rejection."""

_MIN_POOR_SHARE = 0.01
_MAX_SPANS = 12
_MAX_DIAGNOSTICS = 4
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")

INTEGRITY_TOPICS = {"ship/attitude": "ship/integrity", "theodolite/pointing": "theodolite/integrity"}
"""Topic of an output → topic of its protection levels and excluded sources."""


@dataclass(frozen=True)
class Span:
    """Consecutive outputs with one status.

    Attributes:
        status: name of the status.
        start_ns: stamp of the first output.
        end_ns: stamp of the next output with another status; for the last span, stamp of the last output.
        count: number of outputs.
    """

    status: str
    start_ns: int
    end_ns: int
    count: int


class _Run(NamedTuple):
    """Outputs of one status that were published consecutively. Runs are sorted by their first stamp."""

    first_ns: int
    last_ns: int
    status: str
    outputs: int


class StatusHistory:
    """Status history of one output topic.

    Attributes:
        counts: status → number of outputs.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._runs: list[_Run] = []
        self._diagnostic_counts: Counter[str] = Counter()
        self._last_diagnostic: dict[str, str] = {}

    def add(self, message: Any) -> None:
        """Add the next output in the order of publication."""
        self._add(int(message.status), ns_from_stamp(message.header.stamp), ns_from_stamp(message.header.stamp), 1)

    def add_run(self, statuses: Sequence[int], stamps_ns: np.ndarray) -> None:
        """Add outputs in the order of publication, with ascending stamps."""
        start = 0
        for status, group in groupby(statuses):
            end = start + len(list(group))
            self._add(int(status), int(stamps_ns[start]), int(stamps_ns[end - 1]), end - start)
            start = end

    def _add(self, status: int, first_ns: int, last_ns: int, count: int) -> None:
        """Add consecutive outputs of one status."""
        word = STATUS_NAMES[status] if status < len(STATUS_NAMES) else f"status {status}"
        self.counts[word] += count
        if self._runs and self._runs[-1].status == word:
            last = self._runs[-1]
            self._runs[-1] = last._replace(last_ns=max(last.last_ns, last_ns), outputs=last.outputs + count)
        else:
            self._runs.append(_Run(first_ns, last_ns, word, count))

    def add_diagnostic(self, text: str) -> None:
        """Add a diagnostic text about the status; kept only if the last output was DEGRADED or INVALID."""
        if self._runs and self._runs[-1].status in _POOR:
            # Texts are counted without their numbers, which change each time.
            reason = _NUMBER.sub("", text)
            self._diagnostic_counts[reason] += 1
            self._last_diagnostic[reason] = text

    @property
    def diagnostic_lines(self) -> list[str]:
        """The four most frequent diagnostic texts about poor outputs, each with the numbers of its last occurrence."""
        total = self._diagnostic_counts.total()
        most = self._diagnostic_counts.most_common(_MAX_DIAGNOSTICS)
        return [f"diagnostics, {count} of {total}: {self._last_diagnostic[reason]}" for reason, count in most]

    @property
    def spans(self) -> list[Span]:
        """Spans in order of time; a span begins with its first stamp and ends where the next span begins."""
        # INVALID outputs are not published in order of stamps, so the runs are sorted before grouping.
        groups = [list(group) for _, group in groupby(sorted(self._runs), key=lambda run: run.status)]
        starts_ns = [group[0].first_ns for group in groups]
        ends_ns = [*starts_ns[1:], max((run.last_ns for run in self._runs), default=0)]
        return [
            Span(group[0].status, start_ns, end_ns, sum(run.outputs for run in group))
            for group, start_ns, end_ns in zip(groups, starts_ns, ends_ns, strict=False)
        ]

    def lines(self, topic: str) -> list[str]:
        """Return the table of statuses: shares by time and by count, then the longest spans in order of time."""
        spans, counts = self.spans, self.counts
        if not spans:
            return [f"status of {topic}: no output"]
        start_ns, total_ns = spans[0].start_ns, spans[-1].end_ns - spans[0].start_ns
        lines = [f"status of {topic} from {utc_text(start_ns)}, {total_ns / NS_PER_S:.1f} s:"]
        known = [word for word in STATUS_NAMES if word in counts]
        for word in [*known, *(word for word in counts if word not in STATUS_NAMES)]:
            duration_ns = sum(span.end_ns - span.start_ns for span in spans if span.status == word)
            share = duration_ns / total_ns if total_ns else counts[word] / counts.total()
            lines.append(f"  {word:9} {share:6.1%} of the time, {counts[word]} of {counts.total()} outputs")
        longest = sorted(spans, key=lambda span: span.start_ns - span.end_ns)[:_MAX_SPANS]
        shown = sorted(longest, key=lambda span: span.start_ns)
        for span in shown if len(spans) > 1 else ():
            from_s, until_s = ((time_ns - start_ns) / NS_PER_S for time_ns in (span.start_ns, span.end_ns))
            lines.append(f"  {from_s:9.1f} s to {until_s:9.1f} s  {span.status:9} {span.count} outputs")
        if len(spans) > len(shown):
            lines.append(f"  and {len(spans) - len(shown)} shorter spans")
        return lines


def poor_status_reasons(
    history: StatusHistory, adapter: Adapter, config: Any, times: Mapping[str, MessageTimes], health: Sequence[Any]
) -> list[str]:
    """Return the reasons for INVALID or DEGRADED outputs of a node, one line each below a heading.

    The list is empty if at most 1 % of the outputs were INVALID or DEGRADED. The node's own diagnostics come first,
    then problems of its configuration and its inputs.

    Args:
        history: status history of the node's output.
        adapter: adapter of the node.
        config: configuration of the node.
        times: stamps and arrival times of the node's inputs, by topic.
        health: InputHealth messages of the node after the last message.
    """
    counts = history.counts
    if sum(counts[word] for word in _POOR) <= _MIN_POOR_SHARE * counts.total():
        return []
    diagnostics = history.diagnostic_lines
    warnings = [warning for warning in adapter.start_warnings if not any(warning in text for text in diagnostics)]
    reasons = [*diagnostics, *warnings, *_reference_only_reasons(config)]
    reasons += [excess.text for excess in exceeded_limits(config, dict(times), "the bag")]
    reasons += [line for message in health if (line := low_use_text(message))]
    poor = " and ".join(f"{counts[word]} {word}" for word in reversed(_POOR) if counts[word])
    why = reasons or ["no input was missing or rejected for long: see ship/innovation or theodolite/innovation"]
    return [f"why {poor} of {counts.total()} outputs of {adapter.node_name}:", *(f"  {reason}" for reason in why)]


def _reference_only_reasons(config: Any) -> list[str]:
    """Return the reason if references but no stars are configured: references alone never give VALID."""
    if isinstance(config, ShipAttitudeConfig) and config.references and not config.star_sensors:
        return ["no star_sensors are configured: by references alone the attitude stays DEGRADED, horizon GRAVITY"]
    return []


def low_use_text(health: Any) -> str:
    """Return a line about an input without messages, or of which at most half was used; empty otherwise."""
    if not health.received:
        return f"no messages on '{health.topic}'"
    if 2 * health.accepted > health.received:
        return ""
    reason, count = most_frequent_rejection(health)
    reason_text = f", {count} rejected: {reason}" if reason else ""
    return f"{health.accepted} of {health.received} messages on '{health.topic}' were used{reason_text}"


def most_frequent_rejection(health: Any) -> tuple[str, int]:
    """Return the most frequent rejection reason of an input and its count; empty and 0 without rejections."""
    counts = dict(zip(health.reasons, map(int, health.reason_counts), strict=True))
    counts.pop(_ACCEPTED_WITH_NOTE, None)
    reason = max(counts, key=lambda name: counts[name], default="")
    return reason, counts.get(reason, 0)


@dataclass
class ExclusionSpan:
    """One exclusion of a source.

    Attributes:
        source: name of the source.
        start_ns: stamp from which the source is excluded.
        end_ns: stamp of the first Integrity message without the source; None if it is still excluded at the end.
    """

    source: str
    start_ns: int
    end_ns: int | None = None


class ExclusionHistory:
    """Exclusions reported by one output's Integrity messages, in order of their beginning."""

    def __init__(self) -> None:
        self._exclusions: list[ExclusionSpan] = []
        self._current: dict[str, ExclusionSpan] = {}

    def add(self, message: Any) -> None:
        """Add the next Integrity message in order of stamps."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        for source in [source for source in self._current if source not in message.excluded]:
            self._current.pop(source).end_ns = stamp_ns
        for source, excluded_for_s in zip(message.excluded, message.excluded_for_s, strict=False):
            if source not in self._current:
                exclusion = ExclusionSpan(source, stamp_ns - round(excluded_for_s * NS_PER_S))
                self._current[source] = exclusion
                self._exclusions.append(exclusion)

    def lines(self, start_ns: int) -> list[str]:
        """Return one line per exclusion, with times in seconds from `start_ns`."""
        lines = []
        for one in self._exclusions:
            line = f"  {one.source} excluded at {(one.start_ns - start_ns) / NS_PER_S:.1f} s"
            if one.end_ns is None:
                lines.append(f"{line}, still excluded at the end")
            else:
                lines.append(f"{line}, reinstated at {(one.end_ns - start_ns) / NS_PER_S:.1f} s")
        return lines


@dataclass
class ReplaySummary:
    """Result of a replay.

    Attributes:
        inputs: relative topic → number of messages processed.
        outputs: topic → number of messages written, truth included.
        rejected: input topic, after the node's name if several nodes are replayed → reason → number of messages not
            used.
        accepted_with_note: the same topics → reason → number of messages used with a note, or of message parts not
            used.
        undecodable: relative topic → number of messages that do not match their type.
        status_histories: topic with a status → its status history.
        exclusions: topic of Integrity messages → history of the reported exclusions.
        times: relative topic → stamps and arrival times of its messages.
        log_delays: statistics of log time minus stamp.
        reasons: reasons for which outputs were INVALID or DEGRADED, one line each.
        absent: optional input topics that are not in the bag.
        problems: nodes that are not replayed, and problems of the bag, one line each.
        duration_s: length of the bag, s.
        elapsed_s: processing time, s.
    """

    inputs: Counter[str] = field(default_factory=Counter)
    outputs: Counter[str] = field(default_factory=Counter)
    rejected: dict[str, dict[str, int]] = field(default_factory=dict)
    accepted_with_note: dict[str, dict[str, int]] = field(default_factory=dict)
    undecodable: Counter[str] = field(default_factory=Counter)
    status_histories: dict[str, StatusHistory] = field(default_factory=dict)
    exclusions: dict[str, ExclusionHistory] = field(default_factory=dict)
    times: dict[str, MessageTimes] = field(default_factory=dict)
    log_delays: LogDelays = field(default_factory=LogDelays)
    reasons: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    duration_s: float = 0.0
    elapsed_s: float = 0.0

    def unread_lines(self) -> list[str]:
        """Return a line for each topic with messages that do not match their type."""
        return [f"topic '{topic}': {count} messages cannot be read" for topic, count in self.undecodable.items()]

    def status_lines(self) -> list[str]:
        """Return each output's status history, with the exclusions and reinstatements of sources below it."""
        lines = []
        for topic, status_history in sorted(self.status_histories.items()):
            lines += status_history.lines(topic)
            history = self.exclusions.get(INTEGRITY_TOPICS.get(topic, ""))
            if history is not None and status_history.spans:
                lines += history.lines(status_history.spans[0].start_ns)
        return lines
