"""One source: what was told of it, why it is out, and who is to blame for that."""

import math
from dataclasses import dataclass, replace
from typing import Any

from ship_estimation.refusals import Reason
from ship_watch.picture import ITS_NODE, Presence, SourceShown, SourceStanding
from ship_watch.reports import TopicReports
from ship_watch.streak import NO_DISAGREEMENT, SHOWN_NS, Streak
from ship_watch.topics import member_of
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


@dataclass(frozen=True)
class SourceFault:
    """Why a source is out, since when (UTC), and who is to blame where it is not the source itself."""

    reason: str
    since_ns: int = 0
    because_of: str = ""


class HeardSource:
    """All that was told of one source.

    Attributes:
        first_word: what its name begins with: "star" of all star sensors.
        period_ns: the usual time between its messages, ns; NaN where unknown.
        used: how many of its messages were used so far, by the node that has used most of them.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.period_ns, self.used = math.nan, 0
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
        self.first_word = name.partition(".")[0]
        self._well = SourceStanding(name, Presence.IN, "", "", math.nan, 0, "")

    def add(self, reports: TopicReports) -> None:
        """Take a further topic that it comes by; they are kept in the order of their names."""
        self.topics = dict(sorted({**self.topics, reports.topic: reports}.items()))

    def note_reports(self) -> None:
        """Take note that there is a new report on one of its topics."""
        periods = [topic.period_ns for topic in self.topics.values() if not math.isnan(topic.period_ns)]
        self.period_ns = min(periods, default=math.nan)
        self.used = max(topic.used for topic in self.topics.values())

    def age_s(self, now_ns: int) -> float:
        """Time since anything of it arrived, s; infinite where nothing did."""
        return min((topic.age_s(now_ns) for topic in self.topics.values()), default=math.inf)

    def note_use(self, topic: str, stamp_ns: int, message: Any, now_ns: int) -> None:
        """Take an Innovation of what was used: of an exposure also each light that its components name."""
        degrees = sum(1 for residual in message.residual if math.isfinite(residual))
        if message.reason != Reason.REVISED:
            self.window.add(now_ns, float(message.nis), degrees)
        self.used_ns = now_ns
        if word := _PUT_RIGHT.get(int(message.reason)):
            self.put_right, self.put_right_ns = word, now_ns
        if self.name == "lights":
            for light in {str(name).partition(" ")[0] for name in message.components}:
                if streak := self.streaks.get((topic, f"light.{light}")):
                    streak.note_whole(stamp_ns, True, now_ns)

    def fault(self, now_ns: int, utc_offset_ns: int) -> SourceFault | None:
        """What puts it out; None where it is in. What it says itself stands before what is said of it.

        Args:
            now_ns: the caller's time.
            utc_offset_ns: UTC minus the caller's time.
        """
        topics = list(self.topics.values())
        if missed := [topic for topic in topics if topic.is_expected]:
            return SourceFault(_with_members("never heard", missed, topics))
        if silent := [topic for topic in topics if topic.is_silent(now_ns)]:
            since_ns = min(topic.arrived_ns or 0 for topic in silent) + utc_offset_ns
            if all(topic.is_untold(now_ns) for topic in silent):
                return SourceFault("not reported", since_ns, ITS_NODE)
            return SourceFault(_with_members("silent", silent, topics), since_ns)
        worst: tuple[str, Streak] | None = None
        for key, streak in self.streaks.items():
            streak.used_silently(now_ns, self.period_ns, self.used - self.used_at_refusal.get(key, 0))
            if streak.is_out and (worst is None or streak.refused > worst[1].refused):
                worst = key[1], streak
        since_ns = min(worst[1].out_since_ns, now_ns + utc_offset_ns) if worst else 0  # stamps may be of the future
        if self.excluded_since:
            return SourceFault("excluded", since_ns or min(self.excluded_since.values()))
        if worst is not None:
            return SourceFault(_refusal_text(self.name, *worst), since_ns)
        return self._unusable(now_ns, utc_offset_ns)

    def _unusable(self, now_ns: int, utc_offset_ns: int) -> SourceFault | None:
        """It is judged, arrives as reports tell, and has given nothing that could be judged for some time."""
        word = _NOTHING_USABLE.get(self.first_word)
        if word is None or self.judged_ns is None or math.isnan(self.period_ns):
            return None
        if not all(topic.is_fresh(now_ns) for topic in self.topics.values()):
            return None
        if now_ns - self.judged_ns <= max(2e9, _UNUSABLE_PERIODS * self.period_ns):
            return None
        return SourceFault(word, self.judged_ns + utc_offset_ns)

    def blamed(self, fault: SourceFault, guilty: set[str]) -> SourceFault:
        """The same fault, with the source that it comes from where that is known to be out itself."""
        reasons = {
            streak.reason
            for key, streak in self.streaks.items()
            if streak.is_out and fault.reason == _refusal_text(self.name, key[1], streak)
        }
        if fault.reason == _NOTHING_USABLE.get(self.first_word):
            reasons = {Reason.GAP}  # what waits for another source is refused only when that has been missed for long
        needed = [name for reason in reasons for name in _NEEDS.get(reason, {}).get(self.first_word, ())]
        blamed = next((name for name in needed if name in guilty), "")
        if not blamed and self.blamed_on in needed:
            blamed = self.blamed_on  # that one is back, and this has not been accepted often enough since
        self.blamed_on = blamed
        return replace(fault, reason=f"needs {blamed}", because_of=blamed) if blamed else fault

    def standing(self, fault: SourceFault | None, now_ns: int) -> SourceStanding:
        """How it stands with this fault; in where it has none, unless nothing was ever heard of it."""
        if fault is None:
            if not self.streaks and all(topic.arrived_ns is None for topic in self.topics.values()):
                return standing_off(self.name)
            is_put_right = self.put_right_ns is not None and now_ns - self.put_right_ns <= SHOWN_NS
            return replace(self._well, disagreement=self.put_right) if is_put_right else self._well
        off = [] if fault.because_of else [streak.disagreement for streak in self.streaks.values()]
        furthest = max(off, key=lambda one: abs(one.sigmas) if one.text else -1.0, default=NO_DISAGREEMENT)
        return SourceStanding(
            self.name, Presence.OUT, fault.reason, furthest.text, furthest.sigmas, fault.since_ns, fault.because_of
        )

    def shown(self, standing: SourceStanding, now_ns: int) -> SourceShown:
        """What is shown of it where it stands so."""
        streaks = self.streaks.values()
        rates = [topic.rate_hz for topic in self.topics.values() if not math.isnan(topic.rate_hz)]
        judged = any(streak.is_judged for streak in streaks)
        return SourceShown(
            **vars(standing),
            verdict=self.window.verdict(now_ns) if judged else None,
            age_s=self.age_s(now_ns),
            rate_hz=max(rates, default=math.nan),
            refused=max((streak.refused for streak in streaks), default=0),
            topics=tuple(self.topics),
        )


def standing_off(name: str) -> SourceStanding:
    """How a source stands that is not configured."""
    return SourceStanding(name, Presence.OFF, "", "", math.nan, 0, "")


def _refusal_text(source: str, name: str, streak: Streak) -> str:
    """Words for a run of refusals: that the gate refuses need not be said."""
    if (streak.reason, source) in _SAYS_SO_ITSELF:
        return "invalid"
    if streak.reason is Reason.EXCLUDED:
        return "excluded"
    if streak.reason is Reason.OFF:
        return "taken out"
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
