"""Which sources take part, which are out and why, and in which direction the guilty one is off.

A source is OUT when a node excludes it, when five of its measurements in a row were refused (until ten in a row were
accepted; the ship's limits may say otherwise), when it is silent, or when it says itself that it is invalid. What
cannot be used only because another source is out is OUT as well, and says which one it needs.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_estimation.refusals import Reason
from ship_watch.limits import Limits
from ship_watch.picture import Presence, SourceShown
from ship_watch.reports import TopicReports
from ship_watch.streak import NO_DISAGREEMENT, SHOWN_NS, Disagreement, Streak
from ship_watch.topics import member_of, place_of, source_of_name, source_of_topic
from ship_watch.verdict import NisWindow

_NEEDS: dict[Reason, dict[str, tuple[str, ...]]] = {
    Reason.GAP: {
        "star": ("ins",),
        "reference": ("ins",),
        "lights": ("encoder", "ship_attitude", "baselines"),
    },
    Reason.NO_FIX: {"star": ("gnss",)},
    Reason.NOT_FIXED: {"lights": ("baselines",)},
}
"""Reason of a refusal → first word of the source that was refused → the sources one of which is to blame for it."""

_SAYS_SO_ITSELF = {(Reason.GAP, "encoder"), (Reason.GAP, "ship_attitude"), (Reason.NO_FIX, "gnss")}
"""Reason and source where the device itself says that it has no value."""

_PUT_RIGHT = {int(Reason.LIGHT_CONFLICT): "names exchanged"}
"""Reason of a measurement that was used → what was put right in it."""

_NOTHING_USABLE = {"star": "no stars", "lights": "no lights", "reference": "invalid"}
_UNUSABLE_PERIODS = 5.0

STAR_INNOVATION = "star/innovation"
"""There a star sensor is compared with itself, along other axes than by the filter."""

_STAR_INVALID = 3
"""Status of a StarHorizonAttitude without an attitude."""

_NS = 1e-9


@dataclass(frozen=True)
class _Fault:
    """Why a source is out: since when (UTC), and who is to blame where it is not the source itself."""

    reason: str
    since_ns: int = 0
    because_of: str = ""


class _Source:
    """All that was told of one source."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.topics: dict[str, TopicReports] = {}
        self.streaks: dict[tuple[str, str], Streak] = {}
        self.used_at_refusal: dict[tuple[str, str], int] = {}
        self.window = NisWindow()
        self.excluded_since: dict[str, int] = {}
        self.judged_ns: int | None = None
        self.used_ns: int | None = None
        self.put_right_ns: int | None = None
        self.put_right = ""
        self.blamed_on = ""

    @property
    def first_word(self) -> str:
        return self.name.partition(".")[0]

    def period_ns(self) -> float:
        """The usual time between its messages, ns; NaN where unknown."""
        periods = [period for topic in self.topics.values() if not math.isnan(period := topic.period_ns())]
        return min(periods, default=math.nan)


class SourceBook:
    """What innovations, health and integrity tell of the sources, held against the limits of the ship."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._sources: dict[str, _Source] = {}
        self._reports: dict[str, TopicReports] = {}

    @property
    def inputs(self) -> list[TopicReports]:
        """The topics on which nodes report, in the order of their names."""
        return [self._reports[topic] for topic in sorted(self._reports)]

    def has_theodolite(self) -> bool:
        """Whether a node reads the encoders or the lights of a theodolite."""
        return any(topic.startswith("theodolite/") for topic in self._reports)

    def beacon_count(self) -> int:
        """How many lights have a baseline."""
        return sum(1 for topic in self._reports if topic.startswith("beacon/") and topic.endswith("/baseline"))

    def used_age_s(self, name: str, now_ns: int) -> float:
        """Time since a measurement of a source was used, as told by innovations, s; infinite where none was."""
        source = self._sources.get(name)
        return math.inf if source is None or source.used_ns is None else max(0, now_ns - source.used_ns) * _NS

    def age_s(self, name: str, now_ns: int) -> float:
        """Time since anything of a source arrived, s; infinite where nothing did."""
        source = self._sources.get(name)
        topics = source.topics.values() if source else ()
        return min((topic.age_s(now_ns) for topic in topics), default=math.inf)

    # -- what is told ---------------------------------------------------------------------------------------

    def note_health(self, message: Any, now_ns: int) -> bool:
        """Take an InputHealth; the answer is whether the node that tells it has started since the last one."""
        topic = str(message.topic)
        if topic not in self._reports:
            self._reports[topic] = TopicReports(topic)
            if name := source_of_topic(topic):
                self._source(name).topics[topic] = self._reports[topic]
        return self._reports[topic].note(message, now_ns)

    def heard(self, topic: str, now_ns: int) -> None:
        """Take note that a message of an input topic came."""
        if topic in self._reports:
            self._reports[topic].heard(now_ns)

    def note_innovation(self, topic: str, message: Any, now_ns: int) -> str:
        """Take an Innovation that came on a topic; the answer is the source, empty where it speaks of none."""
        name = self._who(str(message.source))
        if not name:
            return ""
        source, stamp_ns = self._source(name), ns_from_stamp(message.header.stamp)
        key = (topic, str(message.source))
        streak = self._streak(source, key)
        streak.note(stamp_ns, message, now_ns, source.period_ns())
        if message.accepted:
            self._note_use(source, topic, stamp_ns, message, now_ns)
        else:
            source.used_at_refusal[key] = max((reports.used for reports in source.topics.values()), default=0)
        if len(message.components):
            source.judged_ns = now_ns
        return name

    def note_solution(self, name: str, message: Any, now_ns: int) -> None:
        """Take the solution of a star sensor: the innovations of the node that made it tell of refused stars alone."""
        if name:
            streak = self._streak(self._source(name), (STAR_INNOVATION, name))
            is_used = message.status != _STAR_INVALID
            streak.note_whole(ns_from_stamp(message.header.stamp), is_used, now_ns)

    def note_integrity(self, topic: str, message: Any, utc_ns: int) -> None:
        """Take an Integrity: the sources that it excludes are out, those that it excluded before are not."""
        excluded = {self._who(str(name)) for name in message.excluded} - {""}
        for name in excluded:
            self._source(name).excluded_since.setdefault(topic, utc_ns)
        for name, source in self._sources.items():
            if name not in excluded:
                source.excluded_since.pop(topic, None)

    # -- what it comes to -----------------------------------------------------------------------------------

    def shown(self, now_ns: int, utc_offset_ns: int) -> list[SourceShown]:
        """All sources now: OUT first, those that are to blame before those that need them, then in a fixed order.

        Args:
            now_ns: the caller's time.
            utc_offset_ns: UTC minus the caller's time.
        """
        found = {name: self._fault(source, now_ns, utc_offset_ns) for name, source in self._sources.items()}
        faults = {name: fault for name, fault in found.items() if fault is not None}
        shown = []
        for source in self._sources.values():
            fault = faults.get(source.name)
            if fault is not None:
                fault = self._blamed(source, fault, {name for name, other in faults.items() if not other.because_of})
            shown.append(self._shown(source, fault, now_ns))
        shown += [_off(name) for name in self._not_configured()]
        return sorted(shown, key=_order)

    def _fault(self, source: _Source, now_ns: int, utc_offset_ns: int) -> _Fault | None:
        """What puts a source out; None where it is in. What it says itself stands before what is said of it."""
        longest_s = self._limits.of_input(source.name).age_s
        topics = list(source.topics.values())
        if missed := [topic for topic in topics if topic.is_expected]:
            return _Fault(_with_members("never heard", missed, topics))
        if silent := [topic for topic in topics if topic.is_silent(now_ns, longest_s)]:
            since_ns = min(topic.arrived_ns or 0 for topic in silent) + utc_offset_ns
            if all(topic.is_untold(now_ns) for topic in silent):
                return _Fault("not reported", since_ns, "its node")
            return _Fault(_with_members("silent", silent, topics), since_ns)
        worst: tuple[str, Streak] | None = None
        for key, streak in source.streaks.items():
            used = max((reports.used for reports in source.topics.values()), default=0)
            streak.used_silently(now_ns, source.period_ns(), used - source.used_at_refusal.get(key, 0))
            if streak.is_out and (worst is None or streak.refused > worst[1].refused):
                worst = key[1], streak
        since_ns = min(worst[1].out_since_ns, now_ns + utc_offset_ns) if worst else 0  # stamps may be of the future
        if source.excluded_since:
            return _Fault("excluded", since_ns or min(source.excluded_since.values()))
        if worst is not None:
            return _Fault(_refusal_text(source.name, *worst), since_ns)
        return self._unusable(source, now_ns, utc_offset_ns)

    def _unusable(self, source: _Source, now_ns: int, utc_offset_ns: int) -> _Fault | None:
        """A source that is judged, arrives, and has given nothing that could be judged for some time."""
        word, period_ns = _NOTHING_USABLE.get(source.first_word), source.period_ns()
        if word is None or source.judged_ns is None or math.isnan(period_ns):
            return None
        if now_ns - source.judged_ns <= max(2e9, _UNUSABLE_PERIODS * period_ns):
            return None
        return _Fault(word, source.judged_ns + utc_offset_ns)

    def _blamed(self, source: _Source, fault: _Fault, guilty: set[str]) -> _Fault:
        """The same fault, with the source that it comes from where that is known to be out itself."""
        reasons = {
            streak.reason
            for key, streak in source.streaks.items()
            if streak.is_out and fault.reason == _refusal_text(source.name, key[1], streak)
        }
        if fault.reason == _NOTHING_USABLE.get(source.first_word):
            reasons = {Reason.GAP}  # what waits for another source is refused only when that has been missed for long
        needed = [name for reason in reasons for name in _NEEDS.get(reason, {}).get(source.first_word, ())]
        blamed = next((name for name in needed if name in guilty), "")
        if not blamed and source.blamed_on in needed:
            blamed = source.blamed_on  # that one is back, and this has not been accepted often enough since
        source.blamed_on = blamed
        return replace(fault, reason=f"needs {blamed}", because_of=blamed) if blamed else fault

    def _shown(self, source: _Source, fault: _Fault | None, now_ns: int) -> SourceShown:
        streaks = source.streaks.values()
        off = [streak.disagreement for streak in streaks if fault and not fault.because_of]
        furthest = max(off, key=lambda one: abs(one.sigmas) if one.text else -1.0, default=NO_DISAGREEMENT)
        if fault is None and source.put_right_ns is not None and now_ns - source.put_right_ns <= SHOWN_NS:
            furthest = Disagreement(source.put_right, math.nan)
        rates = [topic.rate_hz for topic in source.topics.values() if not math.isnan(topic.rate_hz)]
        judged = any(streak.is_judged for streak in streaks)
        return SourceShown(
            name=source.name,
            presence=self._presence(source, fault),
            reason=fault.reason if fault else "",
            disagreement=furthest.text,
            residual=furthest.sigmas,
            verdict=source.window.verdict(now_ns) if judged else None,
            age_s=self.age_s(source.name, now_ns),
            rate_hz=max(rates, default=math.nan),
            refused=max((streak.refused for streak in streaks), default=0),
            out_since_ns=fault.since_ns if fault else 0,
            topics=tuple(sorted(source.topics)),
            because_of=fault.because_of if fault else "",
        )

    def _presence(self, source: _Source, fault: _Fault | None) -> Presence:
        if fault is not None:
            return Presence.OUT
        never = all(topic.arrived_ns is None for topic in source.topics.values())
        return Presence.OFF if never and not source.streaks else Presence.IN

    def _not_configured(self) -> list[str]:
        """The instruments that a ship usually has, of which no topic was ever named."""
        usual = ["ins", "gnss", "weather"] if "ins" in self._sources else []
        usual += ["lights", "encoder", "baselines"] if self.has_theodolite() else []
        return [name for name in usual if name not in self._sources]

    def _note_use(self, source: _Source, topic: str, stamp_ns: int, message: Any, now_ns: int) -> None:
        """A measurement was used: of an exposure also each light that its components name."""
        degrees = sum(1 for residual in message.residual if math.isfinite(residual))
        if message.reason != Reason.REVISED:
            source.window.add(now_ns, float(message.nis), degrees)
        source.used_ns = now_ns
        if word := _PUT_RIGHT.get(int(message.reason)):
            source.put_right, source.put_right_ns = word, now_ns
        if source.name == "lights":
            for light in {str(name).partition(" ")[0] for name in message.components}:
                if streak := source.streaks.get((topic, f"light.{light}")):
                    streak.note_whole(stamp_ns, True, now_ns)

    def _streak(self, source: _Source, key: tuple[str, str]) -> Streak:
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

    def _source(self, name: str) -> _Source:
        if name not in self._sources:
            self._sources[name] = _Source(name)
        return self._sources[name]


def blamed(sources: Iterable[SourceShown], words: tuple[str, ...]) -> SourceShown | None:
    """The first source that is out by a fault of its own, among those whose name begins with one of some words."""
    for source in sources:
        if source.presence is Presence.OUT and not source.because_of and source.name.partition(".")[0] in words:
            return source
    return None


def _refusal_text(source: str, name: str, streak: Streak) -> str:
    """Words for a run of refusals: that the gate refuses need not be said."""
    if (streak.reason, source) in _SAYS_SO_ITSELF:
        return "invalid"
    if streak.reason is Reason.EXCLUDED:
        return "excluded"
    if not streak.refused:
        return _with_member(f"{streak.accepted_again} accepted again", name)
    told = streak.reason not in (Reason.GATE, Reason.NONE)
    text = f"{streak.refused} refused in a row" + (f": {streak.reason.word.replace('_', ' ')}" if told else "")
    return _with_member(text, name)


def _with_member(text: str, name: str) -> str:
    member = member_of(name)
    return f"{member} {text}" if member else text


def _with_members(text: str, topics: list[TopicReports], all_topics: list[TopicReports]) -> str:
    """The text, and of which of its parts, where it does not hold of the whole source."""
    members = sorted({member_of(topic.topic) for topic in topics} - {""})
    return f"{', '.join(members)} {text}" if members and len(topics) < len(all_topics) else text


def _off(name: str) -> SourceShown:
    nan = math.nan
    return SourceShown(name, Presence.OFF, "", "", nan, None, math.inf, nan, 0, 0, ())


def _order(source: SourceShown) -> tuple[int, bool, tuple[int, str]]:
    ranks = {Presence.OUT: 0, Presence.IN: 1, Presence.OFF: 2}
    return ranks[source.presence], bool(source.because_of), place_of(source.name)
