"""Which sources take part, which are out and why, and in which direction the guilty one is off.

A source is OUT when a node excludes it, when five of its measurements in a row were refused (until ten in a row were
accepted; the ship's limits may say otherwise), when it is silent, or when it says itself that it is invalid. What
cannot be used only because another source is out is OUT as well, and says which one it needs.
"""

import math
from collections.abc import Iterable
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_watch.limits import Limits
from ship_watch.names import MOST_NAMES, has_room
from ship_watch.one_source import HeardSource, SourceFault, standing_off
from ship_watch.picture import Presence, SourceShown, SourceStanding
from ship_watch.reports import TopicReports
from ship_watch.streak import Streak
from ship_watch.topics import place_of, source_of_name, source_of_topic

STAR_INNOVATION = "star/innovation"
"""There a star sensor is compared with itself, along other axes than by the filter."""

_STAR_INVALID = 3
"""Status of a StarHorizonAttitude without an attitude."""

_NS = 1e-9


class SourceBook:
    """What innovations, health and integrity tell of the sources, held against the limits of the ship.

    Attributes:
        has_theodolite: whether a node reads the encoders or the lights of a theodolite.
        beacon_count: how many lights have a baseline.
    """

    def __init__(self, limits: Limits) -> None:
        self.has_theodolite, self.beacon_count = False, 0
        self._limits = limits
        self._sources: dict[str, HeardSource] = {}
        self._reports: dict[str, TopicReports] = {}

    @property
    def inputs(self) -> list[TopicReports]:
        """The topics on which nodes report, in the order of their names."""
        return [self._reports[topic] for topic in sorted(self._reports)]

    def reads(self, topic: str) -> bool:
        """Return True if a node reports on that input topic."""
        return topic in self._reports

    def used_age_s(self, name: str, now_ns: int) -> float:
        """Time since a measurement of a source was used, as told by innovations, s; infinite where none was."""
        source = self._sources.get(name)
        return math.inf if source is None or source.used_ns is None else max(0, now_ns - source.used_ns) * _NS

    def age_s(self, name: str, now_ns: int) -> float:
        """Time since anything of a source arrived, s; infinite where nothing did."""
        source = self._sources.get(name)
        return math.inf if source is None else source.age_s(now_ns)

    # -- what is told ---------------------------------------------------------------------------------------

    def note_health(self, message: Any, now_ns: int) -> bool:
        """Take an InputHealth; the answer is whether the node that tells it has started since the last one."""
        topic = str(message.topic)
        if not has_room(self._reports, topic, "input topic"):
            return False
        if topic not in self._reports:
            name = source_of_topic(topic)
            reports = self._reports[topic] = TopicReports(topic, self._limits.of_input(name).age_s)
            if name and has_room(self._sources, name, "source"):
                self._source(name).add(reports)
            self.has_theodolite |= topic.startswith("theodolite/")
            self.beacon_count += topic.startswith("beacon/") and topic.endswith("/baseline")
        has_started = self._reports[topic].note(message, now_ns)
        if (name := source_of_topic(topic)) in self._sources:
            self._source(name).note_reports()
        return has_started

    def heard(self, topic: str, now_ns: int) -> None:
        """Take note that a message of an input topic came."""
        if topic in self._reports:
            self._reports[topic].heard(now_ns)

    def note_innovation(self, topic: str, message: Any, now_ns: int) -> str:
        """Take an Innovation that came on a topic; the answer is the source, empty where it speaks of none."""
        name, key = self._who(str(message.source)), (topic, str(message.source))
        if not name or not has_room(self._sources, name, "source"):
            return ""
        source, stamp_ns = self._source(name), ns_from_stamp(message.header.stamp)
        if not has_room(source.streaks, key, "name of a source"):
            return ""
        streak = self._streak(source, key)
        streak.note(stamp_ns, message, now_ns, source.period_ns)
        if message.accepted:
            source.note_use(topic, stamp_ns, message, now_ns)
        else:
            source.used_at_refusal[key] = source.used
        if len(message.components):
            source.judged_ns = now_ns
        return name

    def note_solution(self, name: str, message: Any, now_ns: int) -> None:
        """Take the solution of a star sensor: the innovations of the node that made it tell of refused stars alone."""
        if name and has_room(self._sources, name, "source"):
            streak = self._streak(self._source(name), (STAR_INNOVATION, name))
            is_used = message.status != _STAR_INVALID
            streak.note_whole(ns_from_stamp(message.header.stamp), is_used, now_ns)

    def note_integrity(self, topic: str, message: Any, utc_ns: int) -> None:
        """Take an Integrity: the sources that it excludes are out, those that it excluded before are not."""
        excluded = {self._who(str(name)) for name in message.excluded[:MOST_NAMES]} - {""}
        excluded = {name for name in excluded if has_room(self._sources, name, "source")}
        for name in excluded:
            self._source(name).excluded_since.setdefault(topic, utc_ns)
        for name, source in self._sources.items():
            if name not in excluded:
                source.excluded_since.pop(topic, None)

    # -- what it comes to -----------------------------------------------------------------------------------

    def standings(self, now_ns: int, utc_offset_ns: int) -> list[SourceStanding]:
        """Return how all sources stand: OUT first, each cause directly before its consequences, in a fixed order.

        Args:
            now_ns: the caller's time.
            utc_offset_ns: UTC minus the caller's time.
        """
        faults: dict[str, SourceFault] = {}
        for name, source in self._sources.items():
            fault = source.fault(now_ns, utc_offset_ns)
            if fault is not None:
                faults[name] = fault
        guilty = {name for name, fault in faults.items() if not fault.because_of}
        because = {name: self._sources[name].blamed(fault, guilty) for name, fault in faults.items()}
        standings = [source.standing(because.get(name), now_ns) for name, source in self._sources.items()]
        standings += [standing_off(name) for name in self._not_configured()]
        return _causes_first(sorted(standings, key=_order))

    def shown(self, standings: Iterable[SourceStanding], now_ns: int) -> list[SourceShown]:
        """Return all sources with all that is known of them, as they stand by :meth:`standings`."""
        return [(self._sources.get(each.name) or HeardSource(each.name)).shown(each, now_ns) for each in standings]

    def _not_configured(self) -> list[str]:
        """The instruments that a ship usually has, of which no topic was ever named."""
        usual = ["ins", "gnss", "weather"] if "ins" in self._sources else []
        usual += ["lights", "encoder", "baselines"] if self.has_theodolite else []
        return [name for name in usual if name not in self._sources]

    def _streak(self, source: HeardSource, key: tuple[str, str]) -> Streak:
        streak = source.streaks.get(key)
        if streak is None:
            limits = self._limits.of_input(source.name)
            streak = source.streaks[key] = Streak(limits.refusals, limits.accepted)
        return streak

    def _who(self, name: str) -> str:
        """The source of a name; the ship of a theodolite that reads no attitude of the ship is her INS."""
        source = source_of_name(name)
        is_ins = source == "ship_attitude" and "ship/attitude" not in self._reports and "ins/imu" in self._reports
        return "ins" if is_ins else source

    def _source(self, name: str) -> HeardSource:
        if name not in self._sources:
            self._sources[name] = HeardSource(name)
        return self._sources[name]


def blamed(sources: Iterable[SourceStanding], words: tuple[str, ...]) -> SourceStanding | None:
    """The first source that is out by a fault of its own, among those whose name begins with one of some words."""
    for source in sources:
        if source.presence is Presence.OUT and not source.because_of and source.name.partition(".")[0] in words:
            return source
    return None


def newest_age_s(first_word: str, sources: Iterable[SourceShown], used_age_s: float) -> float:
    """Return the age of a kind of source, s: of its newest that is IN, as the list of sources has it.

    Args:
        first_word: what the names of the kind begin with, as "star".
        sources: all.
        used_age_s: time since one of the kind was used, s, which is returned where all of them are OUT.
    """
    used = (each for each in sources if each.presence is Presence.IN and each.name.partition(".")[0] == first_word)
    return min((each.age_s for each in used), default=used_age_s)


def _order(source: SourceStanding) -> tuple[bool, bool, bool, tuple[int, str]]:
    presence = source.presence
    return presence is not Presence.OUT, presence is Presence.OFF, bool(source.because_of), place_of(source.name)


def _causes_first(sources: list[SourceStanding]) -> list[SourceStanding]:
    """Return the sources with those that are out because of another one that is out directly after that one."""
    causes = {source.name for source in sources if source.presence is Presence.OUT and not source.because_of}
    consequences: dict[str, list[SourceStanding]] = {}
    for source in sources:
        if source.because_of in causes:
            consequences.setdefault(source.because_of, []).append(source)
    return [
        each
        for source in sources
        if source.because_of not in causes
        for each in (source, *consequences.get(source.name, ()))
    ]
