"""Presence of all sources, the reasons why sources are OUT, overloaded nodes, and the offsets of faulty sources.

A source is OUT if a node excludes it, if five of its measurements in a row were rejected, if it sends no usable data,
or if it reports itself invalid. After rejections the source is IN again when ten measurements in a row were accepted;
both numbers are defaults of the ship's limits. A source that cannot be used because another source is OUT is also OUT,
with the other source as its cause.

An overloaded node cannot keep up with its inputs and drops waiting messages. Measurements of good sources then lack
their counterparts, in that node and in the nodes that read its output. These sources are not faulty.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_watch.safety.limits import Limits
from ship_watch.sources.reports import TopicReports
from ship_watch.sources.source_history import DecisionHistory
from ship_watch.sources.source_record import SourceFault, SourceRecord
from ship_watch.suite_state import Presence, SourceDetails, SourceState
from ship_watch.topics import MAX_NAMES, display_order, has_room, source_of_name, source_of_topic

REPORT_TIMEOUT_NS = 5_000_000_000
"""Maximum age of an overload report with which its node counts as overloaded, ns. A node reports once a second, and
less often if it hardly runs."""

_NEW_OVERLOAD_NS = 2 * REPORT_TIMEOUT_NS
"""Time without a report after which the next report starts a new overload, ns."""

_ONSET_NS = REPORT_TIMEOUT_NS
"""Time before the first report within which a source that goes OUT is attributed to the overload, ns."""

_NODES = ("ship_attitude", "star_attitude", "optical_axis")
"""Nodes that report an overload, in the order in which their texts are preferred."""

_ATTITUDE_NODES = _NODES[:2]


STAR_INNOVATION = "star/innovation"
"""Topic of the innovations of single stars against the solution of their sensor, along the axes of the sensor."""

_STAR_INVALID = 3
"""Status of a StarHorizonAttitude without an attitude."""

_NS = 1e-9

_UNUSED_S = 5.0
"""A source counts as unused if its last use is older than its last message by more than this time, s."""


@dataclass
class _Overload:
    text: str
    since_ns: int
    reported_ns: int


class OverloadedNodes:
    """Overloaded nodes, from innovations with the reason BEHIND."""

    def __init__(self) -> None:
        self._nodes: dict[str, _Overload] = {}
        self._out_since_ns: dict[str, int] = {}
        self._causes: dict[str, str] = {}

    def record_report(self, message: Any, now_ns: int) -> None:
        """Record an Innovation with the reason BEHIND if its source is a node, not the source of a dropped message."""
        node = str(message.source)
        if node not in _NODES:
            return
        known = self._nodes.get(node)
        since_ns = now_ns if known is None or now_ns - known.reported_ns > _NEW_OVERLOAD_NS else known.since_ns
        self._nodes[node] = _Overload(str(message.reason_text), since_ns, now_ns)

    def overload_text(self, now_ns: int, is_pointing: bool, by_attitude: bool) -> str:
        """Return the overload text of the first overloaded node on which an output depends; empty if there is none.

        Args:
            now_ns: caller's time, ns.
            is_pointing: True for the pointing, False for the attitude.
            by_attitude: True if the pointing uses the attitude that the suite publishes.
        """
        own = ("optical_axis",) if is_pointing else ()
        nodes = (*own, *(_ATTITUDE_NODES if by_attitude or not is_pointing else ()))
        return next((self._nodes[node].text for node in nodes if self._is_overloaded(node, now_ns)), "")

    def with_causes(self, sources: Sequence[SourceState], now_ns: int) -> list[SourceState]:
        """Return the sources; a source that went OUT during an overload or just before has the node as its cause.

        The cause stays until the source is IN again.

        Args:
            sources: states from the measurements.
            now_ns: caller's time, ns.
        """
        node = next((node for node in _NODES if self._is_overloaded(node, now_ns)), "")
        return [self._with_cause(source, node, now_ns) for source in sources]

    def _with_cause(self, source: SourceState, node: str, now_ns: int) -> SourceState:
        name = source.name
        if source.presence is not Presence.OUT:
            self._out_since_ns.pop(name, None)
            self._causes.pop(name, None)
        elif not source.because_of:
            since_ns = self._out_since_ns.setdefault(name, now_ns)
            if node and since_ns >= self._nodes[node].since_ns - _ONSET_NS:
                self._causes[name] = node
            if name in self._causes:
                node = self._causes[name]
                return replace(source, reason=f"{node} is behind", disagreement="", because_of=node)
        return source

    def _is_overloaded(self, node: str, now_ns: int) -> bool:
        known = self._nodes.get(node)
        return known is not None and now_ns - known.reported_ns <= REPORT_TIMEOUT_NS


class SourceRecords:
    """Records of all sources, from innovations, input health and integrity, with the limits of the ship.

    Attributes:
        has_theodolite: True if a node reads the encoders or the lights of a theodolite.
        beacon_count: number of lights with a baseline.
    """

    def __init__(self, limits: Limits) -> None:
        self.has_theodolite, self.beacon_count = False, 0
        self._limits = limits
        self._sources: dict[str, SourceRecord] = {}
        self._reports: dict[str, TopicReports] = {}

    @property
    def inputs(self) -> list[TopicReports]:
        """Reports on input topics, in the order of the topics' names."""
        return [self._reports[topic] for topic in sorted(self._reports)]

    def is_reported(self, topic: str) -> bool:
        """True if a node reports on an input topic."""
        return topic in self._reports

    def used_age_s(self, name: str, now_ns: int) -> float:
        """Return the time since an innovation of a source was accepted, s; infinite before the first."""
        source = self._sources.get(name)
        return math.inf if source is None or source.used_ns is None else max(0, now_ns - source.used_ns) * _NS

    def age_s(self, name: str, now_ns: int) -> float:
        """Return the time since the last message of a source, s; infinite before the first."""
        source = self._sources.get(name)
        return math.inf if source is None else source.age_s(now_ns)

    # -- messages -------------------------------------------------------------------------------------------

    def record_health(self, message: Any, now_ns: int) -> bool:
        """Record an InputHealth; return True if its node has started since the last InputHealth."""
        topic = str(message.topic)
        if not has_room(self._reports, topic, "input topic"):
            return False
        if topic not in self._reports:
            name = source_of_topic(topic)
            reports = self._reports[topic] = TopicReports(topic, self._limits.input_limits(name).age_s)
            if name and has_room(self._sources, name, "source"):
                self._source_record(name).add_topic(reports)
            self.has_theodolite |= topic.startswith("theodolite/")
            self.beacon_count += topic.startswith("beacon/") and topic.endswith("/baseline")
        has_started = self._reports[topic].record_report(message, now_ns)
        if (name := source_of_topic(topic)) in self._sources:
            self._source_record(name).update_from_reports()
        return has_started

    def record_arrival(self, topic: str, now_ns: int) -> None:
        """Record the arrival of a message of an input topic."""
        if topic in self._reports:
            self._reports[topic].record_arrival(now_ns)

    def record_innovation(self, topic: str, message: Any, now_ns: int) -> str:
        """Record an Innovation received on a topic; return the name of its source, empty if it has none."""
        name, key = self._source_name(str(message.source)), (topic, str(message.source))
        if not name or not has_room(self._sources, name, "source"):
            return ""
        source, stamp_ns = self._source_record(name), ns_from_stamp(message.header.stamp)
        if not has_room(source.decisions, key, "name of a source"):
            return ""
        history = self._decision_history(source, key)
        history.record(stamp_ns, message, now_ns, source.period_ns)
        if message.accepted:
            source.record_use(topic, stamp_ns, message, now_ns)
        else:
            source.used_at_rejection[key] = source.used
        if len(message.components):
            source.evaluated_ns = now_ns
        return name

    def record_solution(self, name: str, message: Any, now_ns: int) -> None:
        """Record the solution of a star sensor, because `star/innovation` contains only rejected stars."""
        if name and has_room(self._sources, name, "source"):
            history = self._decision_history(self._source_record(name), (STAR_INNOVATION, name))
            is_used = message.status != _STAR_INVALID
            history.record_exposure(ns_from_stamp(message.header.stamp), is_used, now_ns)

    def record_integrity(self, topic: str, message: Any, utc_ns: int) -> None:
        """Record the excluded sources of an Integrity; sources no longer excluded are cleared."""
        excluded = {self._source_name(str(name)) for name in message.excluded[:MAX_NAMES]} - {""}
        excluded = {name for name in excluded if has_room(self._sources, name, "source")}
        for name in excluded:
            self._source_record(name).excluded_since.setdefault(topic, utc_ns)
        for name, source in self._sources.items():
            if name not in excluded:
                source.excluded_since.pop(topic, None)

    # -- results --------------------------------------------------------------------------------------------

    def source_states(self, now_ns: int, utc_offset_ns: int) -> list[SourceState]:
        """Return the states of all sources: OUT first, causes directly before consequences, otherwise in a fixed order.

        Args:
            now_ns: caller's time, ns.
            utc_offset_ns: UTC minus caller's time, ns.
        """
        faults: dict[str, SourceFault] = {}
        for name, source in self._sources.items():
            fault = source.fault(now_ns, utc_offset_ns)
            if fault is not None:
                faults[name] = fault
        faulty_names = {name for name, fault in faults.items() if not fault.because_of}
        because = {name: self._sources[name].attribute_fault(fault, faulty_names) for name, fault in faults.items()}
        states = [source.source_state(because.get(name), now_ns) for name, source in self._sources.items()]
        states += [SourceState(name, Presence.OFF) for name in self._unconfigured_names()]
        return _causes_first(sorted(states, key=_order))

    def source_details(self, states: Iterable[SourceState], now_ns: int) -> list[SourceDetails]:
        """Return the displayed data of all sources, for states from :meth:`source_states`."""
        return [
            (self._sources.get(each.name) or SourceRecord(each.name)).source_details(each, now_ns) for each in states
        ]

    def _unconfigured_names(self) -> list[str]:
        """Return the usual instruments of a ship for which no node has reported a topic."""
        usual = ["ins", "gnss", "weather"] if "ins" in self._sources else []
        usual += ["lights", "encoder", "baselines"] if self.has_theodolite else []
        return [name for name in usual if name not in self._sources]

    def _decision_history(self, source: SourceRecord, key: tuple[str, str]) -> DecisionHistory:
        history = source.decisions.get(key)
        if history is None:
            limits = self._limits.input_limits(source.name)
            history = source.decisions[key] = DecisionHistory(limits.refusals, limits.accepted)
        return history

    def _source_name(self, name: str) -> str:
        """Return the source of a name in a message; "ship_attitude" is the INS for a theodolite that reads the INS."""
        source = source_of_name(name)
        is_ins = source == "ship_attitude" and "ship/attitude" not in self._reports and "ins/imu" in self._reports
        return "ins" if is_ins else source

    def _source_record(self, name: str) -> SourceRecord:
        if name not in self._sources:
            self._sources[name] = SourceRecord(name)
        return self._sources[name]


def first_faulty_source(sources: Iterable[SourceState], kinds: tuple[str, ...]) -> SourceState | None:
    """Return the first source of some kinds that is OUT due to a fault of its own; None if there is none."""
    for source in sources:
        if source.presence is Presence.OUT and not source.because_of and source.name.partition(".")[0] in kinds:
            return source
    return None


def newest_age_s(kind: str, sources: Iterable[SourceDetails], used_age_s: float) -> float:
    """Return the age of a kind of source, s: the age of its newest source that is IN.

    Args:
        kind: first part of the names of the kind, as "star".
        sources: all sources.
        used_age_s: time since a source of the kind was used, s. This time is returned if all sources of the kind are
            OUT, or if their data arrive but are not used.
    """
    is_in = (each for each in sources if each.presence is Presence.IN and each.name.partition(".")[0] == kind)
    age_s = min((each.age_s for each in is_in), default=used_age_s)
    return age_s if used_age_s - age_s <= _UNUSED_S else used_age_s


def _order(source: SourceState) -> tuple[bool, bool, bool, tuple[int, str]]:
    presence = source.presence
    return presence is not Presence.OUT, presence is Presence.OFF, bool(source.because_of), display_order(source.name)


def _causes_first(sources: list[SourceState]) -> list[SourceState]:
    """Return the sources with each consequence directly after the source that causes it."""
    causes = {source.name for source in sources if source.presence is Presence.OUT and not source.because_of}
    consequences: dict[str, list[SourceState]] = {}
    for source in sources:
        if source.because_of in causes:
            consequences.setdefault(source.because_of, []).append(source)
    return [
        each
        for source in sources
        if source.because_of not in causes
        for each in (source, *consequences.get(source.name, ()))
    ]
