"""State of one source: measurement decisions, NIS consistency, the reason why it is OUT, and the source at fault.

The NIS test compares the stated sigma of a source with its innovations of the last minute.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

from ship_estimation.rejection_rules import Reason
from ship_watch.sources.reports import TopicReports
from ship_watch.sources.source_history import MIN_DISPLAY_NS, NO_DISAGREEMENT, DecisionHistory
from ship_watch.suite_state import CAUSE_NODE, NisConsistency, Presence, SourceDetails, SourceState
from ship_watch.topics import source_member

WINDOW_NS = 60_000_000_000
"""Length of the window of innovations, ns."""

BAND_SIGMAS = 3.3
"""Half width of the band in which the sigma is consistent, in sigmas of the ratio (two-sided probability 99.9 %)."""

MAX_BAND = 0.5
"""Largest half width of the band for which a text is given, reached with 22 degrees of freedom."""


_NEEDS: dict[Reason, dict[str, tuple[str, ...]]] = {
    Reason.GAP: {
        "star": ("ins",),
        "reference": ("ins",),
        "lights": ("encoder", "ship_attitude", "baselines"),
    },
    Reason.NO_FIX: {"star": ("gnss",)},
    Reason.NOT_FIXED: {"lights": ("baselines",)},
}
"""Reason of a rejection → kind of the rejected source → the sources that may cause the rejection."""

_SELF_REPORTED = {(Reason.GAP, "encoder"), (Reason.GAP, "ship_attitude"), (Reason.NO_FIX, "gnss")}
"""Pairs of reason and source for which the rejected message itself states that it has no value."""

_CORRECTIONS = {int(Reason.LIGHT_CONFLICT): "names exchanged"}
"""Reason of an accepted measurement → text of the correction that was made in it."""

_NO_USABLE_DATA = {"star": "no stars", "lights": "no lights", "reference": "invalid"}
"""Kind of source → reason while all data of the source are unusable."""

_UNUSABLE_PERIODS = 5.0
"""Number of periods without usable data, but at least 2 s, after which a source is OUT."""


class NisWindow:
    """Accepted innovations of one source in the last minute: sum of their NIS and of their degrees of freedom."""

    def __init__(self) -> None:
        self._entries: deque[tuple[int, float, int]] = deque()
        self._nis, self._degrees_of_freedom = 0.0, 0
        self._consistency: NisConsistency | None = None

    def add(self, now_ns: int, nis: float, degrees_of_freedom: int) -> None:
        """Add the innovation of an accepted measurement; a NIS that is not finite is ignored.

        Args:
            now_ns: caller's time, ns.
            nis: normalised innovation squared.
            degrees_of_freedom: number of residuals of the innovation.
        """
        if degrees_of_freedom > 0 and math.isfinite(nis):
            self._entries.append((now_ns, nis, degrees_of_freedom))
            self._nis += nis
            self._degrees_of_freedom += degrees_of_freedom
            self._consistency = None
        self._drop_old(now_ns)

    def consistency(self, now_ns: int) -> NisConsistency:
        """Return the consistency of the last minute.

        With N degrees of freedom, the sigma is consistent if r = √(NIS / N) is within 1 ± 3.3/√(2 N). The sum of N
        squares of unit normals has the mean N and the variance 2 N, so that r has the sigma 1/√(2 N).
        """
        self._drop_old(now_ns)
        if self._consistency is None:  # kept, because this method is called more often than innovations arrive
            self._consistency = self._compute_consistency()
        return self._consistency

    def _compute_consistency(self) -> NisConsistency:
        degrees = self._degrees_of_freedom
        if degrees == 0:
            return NisConsistency(math.nan, 0, "", is_consistent=True)
        ratio = math.sqrt(max(self._nis, 0.0) / degrees)
        band = BAND_SIGMAS / math.sqrt(2.0 * degrees)
        fits = abs(ratio - 1.0) <= band
        if not band <= MAX_BAND or ratio == 0.0:
            return NisConsistency(ratio, degrees, "", fits)
        return NisConsistency(ratio, degrees, f"σ {consistent_text(ratio) if fits else inconsistent_text(ratio)}", fits)

    def _drop_old(self, now_ns: int) -> None:
        entries = self._entries
        while entries and now_ns - entries[0][0] > WINDOW_NS:
            _, nis, degrees = entries.popleft()
            self._nis -= nis
            self._degrees_of_freedom -= degrees
            self._consistency = None
        if not entries:
            self._nis = 0.0  # remove rounding errors


def consistent_text(ratio: float) -> str:
    """Return the text of a consistent ratio of real to stated sigma: "as stated (1.01)"."""
    return f"as stated ({ratio:.2f})"


def inconsistent_text(ratio: float) -> str:
    """Return the text of an inconsistent ratio: "optimistic by 1.6" if errors exceed the stated sigma."""
    factor = ratio if ratio > 1.0 else 1.0 / ratio
    # Two decimals if the factor would be 1.0 with one decimal.
    return f"{'optimistic' if ratio > 1.0 else 'pessimistic'} by {factor:.{2 if factor < 1.05 else 1}f}"


@dataclass(frozen=True)
class SourceFault:
    """Reason why a source is OUT, begin of the fault (UTC, ns), and the other source that causes the fault.

    ``because_of`` is empty for a fault of the source itself.
    """

    reason: str
    since_ns: int = 0
    because_of: str = ""


class SourceRecord:
    """Reports and measurement decisions of one source.

    Attributes:
        name: name of the source.
        first_word: kind of the source, the first part of its name: "star" for all star sensors.
        period_ns: usual time between messages of the source, ns; NaN if unknown.
        used: largest number of messages of one topic of the source that one node has used so far.
        topics: topic → reports on it, in the order of the topics' names.
        decisions: (innovation topic, name in it) → measurement decisions.
        used_at_rejection: (innovation topic, name in it) → value of ``used`` at the last rejection.
        nis_window: accepted innovations of the last minute.
        excluded_since: integrity topic → time of the exclusion, UTC, ns.
        evaluated_ns: arrival of the last innovation with components; None before the first.
        used_ns: arrival of the last accepted innovation; None before the first.
        corrected_ns: arrival of the last accepted measurement that had to be corrected; None before the first.
        correction: text of the last correction.
        last_cause: source that was the cause of the last fault; empty if no other source was the cause.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.period_ns, self.used = math.nan, 0
        self.topics: dict[str, TopicReports] = {}
        self.decisions: dict[tuple[str, str], DecisionHistory] = {}
        self.used_at_rejection: dict[tuple[str, str], int] = {}
        self.nis_window = NisWindow()
        self.excluded_since: dict[str, int] = {}
        self.evaluated_ns: int | None = None
        self.used_ns: int | None = None
        self.corrected_ns: int | None = None
        self.correction = ""
        self.last_cause = ""
        self.first_word = name.partition(".")[0]
        self._in_state = SourceState(name, Presence.IN)

    def add_topic(self, reports: TopicReports) -> None:
        """Add a topic on which the source publishes."""
        self.topics = dict(sorted({**self.topics, reports.topic: reports}.items()))

    def update_from_reports(self) -> None:
        """Update period and count of used messages from the reports on its topics."""
        periods = [topic.period_ns for topic in self.topics.values() if not math.isnan(topic.period_ns)]
        self.period_ns = min(periods, default=math.nan)
        self.used = max(topic.used for topic in self.topics.values())

    def age_s(self, now_ns: int) -> float:
        """Return the time since the last message of the source, s; infinite before the first message."""
        return min((topic.age_s(now_ns) for topic in self.topics.values()), default=math.inf)

    def record_use(self, topic: str, stamp_ns: int, message: Any, now_ns: int) -> None:
        """Record an accepted Innovation, also for each light in its components that has a decision history."""
        degrees = sum(1 for residual in message.residual if math.isfinite(residual))
        if message.reason != Reason.REVISED:
            self.nis_window.add(now_ns, float(message.nis), degrees)
        self.used_ns = now_ns
        if word := _CORRECTIONS.get(int(message.reason)):
            self.correction, self.corrected_ns = word, now_ns
        if self.name == "lights":
            for light in {str(name).partition(" ")[0] for name in message.components}:
                if history := self.decisions.get((topic, f"light.{light}")):
                    history.record_exposure(stamp_ns, True, now_ns)

    def fault(self, now_ns: int, utc_offset_ns: int) -> SourceFault | None:
        """Reinstate the source if it is used again; return the reason why it is OUT, None if it is IN.

        Missing data have priority over an exclusion, and an exclusion has priority over rejections.

        Args:
            now_ns: caller's time, ns.
            utc_offset_ns: UTC minus caller's time, ns.
        """
        topics = list(self.topics.values())
        if never_received := [topic for topic in topics if topic.is_never_received]:
            return SourceFault(_with_members("never received", never_received, topics))
        if timed_out := [topic for topic in topics if topic.is_timed_out(now_ns)]:
            since_ns = min(topic.arrived_ns or 0 for topic in timed_out) + utc_offset_ns
            if all(topic.is_report_overdue(now_ns) for topic in timed_out):
                return SourceFault("not reported", since_ns, CAUSE_NODE)
            return SourceFault(_with_members("no data", timed_out, topics), since_ns)
        worst: tuple[str, DecisionHistory] | None = None
        for key, history in self.decisions.items():
            history.reinstate_if_used(now_ns, self.period_ns, self.used - self.used_at_rejection.get(key, 0))
            if history.is_out and (worst is None or history.rejected_in_a_row > worst[1].rejected_in_a_row):
                worst = key[1], history
        since_ns = min(worst[1].out_since_ns, now_ns + utc_offset_ns) if worst else 0  # stamps may lie in the future
        if self.excluded_since:
            return SourceFault("excluded", since_ns or min(self.excluded_since.values()))
        if worst is not None:
            return SourceFault(_rejection_text(self.name, *worst), since_ns)
        return self._no_usable_data(now_ns, utc_offset_ns)

    def _no_usable_data(self, now_ns: int, utc_offset_ns: int) -> SourceFault | None:
        """Return the fault of a source that sends only data that cannot be evaluated; None otherwise."""
        word = _NO_USABLE_DATA.get(self.first_word)
        if word is None or self.evaluated_ns is None or math.isnan(self.period_ns):
            return None
        if not all(topic.is_report_recent(now_ns) for topic in self.topics.values()):
            return None
        if now_ns - self.evaluated_ns <= max(2e9, _UNUSABLE_PERIODS * self.period_ns):
            return None
        return SourceFault(word, self.evaluated_ns + utc_offset_ns)

    def attribute_fault(self, fault: SourceFault, faulty_names: set[str]) -> SourceFault:
        """Return the fault, with its cause if a source that this source needs is OUT.

        Args:
            fault: fault of this source.
            faulty_names: names of the sources that are OUT due to a fault of their own.
        """
        reasons = {
            history.reason
            for key, history in self.decisions.items()
            if history.is_out and fault.reason == _rejection_text(self.name, key[1], history)
        }
        if fault.reason == _NO_USABLE_DATA.get(self.first_word):
            reasons = {Reason.GAP}  # assumed: waiting measurements are rejected with GAP only much later
        needed = [name for reason in reasons for name in _NEEDS.get(reason, {}).get(self.first_word, ())]
        cause = next((name for name in needed if name in faulty_names), "")
        if not cause and self.last_cause in needed:
            cause = self.last_cause  # the needed source is IN again, but this source is not yet reinstated
        self.last_cause = cause
        return replace(fault, reason=f"needs {cause}", because_of=cause) if cause else fault

    def source_state(self, fault: SourceFault | None, now_ns: int) -> SourceState:
        """Return the state of the source: OUT with a fault, OFF before any message or decision, else IN."""
        if fault is None:
            if not self.decisions and all(topic.arrived_ns is None for topic in self.topics.values()):
                return SourceState(self.name, Presence.OFF)
            is_put_right = self.corrected_ns is not None and now_ns - self.corrected_ns <= MIN_DISPLAY_NS
            return replace(self._in_state, disagreement=self.correction) if is_put_right else self._in_state
        disagreements = [] if fault.because_of else [history.disagreement for history in self.decisions.values()]
        largest = max(disagreements, key=lambda one: abs(one.sigmas) if one.text else -1.0, default=NO_DISAGREEMENT)
        return SourceState(
            self.name, Presence.OUT, fault.reason, largest.text, largest.sigmas, fault.since_ns, fault.because_of
        )

    def source_details(self, state: SourceState, now_ns: int) -> SourceDetails:
        """Return the displayed data of the source in this state."""
        histories = self.decisions.values()
        rates = [topic.rate_hz for topic in self.topics.values() if not math.isnan(topic.rate_hz)]
        has_acceptances = any(history.has_acceptances for history in histories)
        return SourceDetails(
            **vars(state),
            nis_consistency=self.nis_window.consistency(now_ns) if has_acceptances else None,
            age_s=self.age_s(now_ns),
            rate_hz=max(rates, default=math.nan),
            rejected_in_a_row=max((streak.rejected_in_a_row for streak in histories), default=0),
            topics=tuple(self.topics),
        )


def _rejection_text(source: str, name: str, history: DecisionHistory) -> str:
    """Return the text of a run of rejections, with its reason unless the reason is the gate."""
    if (history.reason, source) in _SELF_REPORTED:
        return "invalid"
    if history.reason is Reason.EXCLUDED:
        return "excluded"
    if history.reason is Reason.OFF:
        return "switched off"
    if not history.rejected_in_a_row:
        return _with_member(f"{history.accepted_in_a_row} accepted again", name)
    has_reason = history.reason not in (Reason.GATE, Reason.NONE)
    text = f"{history.rejected_in_a_row} rejected in a row" + (
        f": {history.reason.word.replace('_', ' ')}" if has_reason else ""
    )
    return _with_member(text, name)


def _with_member(text: str, name: str) -> str:
    member = source_member(name)
    return f"{member}: {text}" if member else text


def _with_members(text: str, topics: list[TopicReports], all_topics: list[TopicReports]) -> str:
    """Return the text, with the names of the members if the text does not apply to the whole source."""
    members = sorted({source_member(topic.topic) for topic in topics} - {""})
    return f"{', '.join(members)}: {text}" if members and len(topics) < len(all_topics) else text
