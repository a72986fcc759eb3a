"""One source: what was told of it, why it is out, and who is to blame for that."""

import math
from dataclasses import dataclass, replace
from typing import Any

from ship_estimation.refusals import Reason
from ship_watch.picture import Presence, SourceShown
from ship_watch.reports import TopicReports
from ship_watch.streak import NO_DISAGREEMENT, SHOWN_NS, Disagreement, Streak
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
        """What its name begins with: "star" of all star sensors."""
        return self.name.partition(".")[0]

    def period_ns(self) -> float:
        """The usual time between its messages, ns; NaN where unknown."""
        periods = [period for topic in self.topics.values() if not math.isnan(period := topic.period_ns())]
        return min(periods, default=math.nan)

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

    def fault(self, longest_s: float, now_ns: int, utc_offset_ns: int) -> SourceFault | None:
        """What puts it out; None where it is in. What it says itself stands before what is said of it.

        Args:
            longest_s: silence after which it is out, s.
            now_ns: the caller's time.
            utc_offset_ns: UTC minus the caller's time.
        """
        topics = list(self.topics.values())
        if missed := [topic for topic in topics if topic.is_expected]:
            return SourceFault(_with_members("never heard", missed, topics))
        if silent := [topic for topic in topics if topic.is_silent(now_ns, longest_s)]:
            since_ns = min(topic.arrived_ns or 0 for topic in silent) + utc_offset_ns
            if all(topic.is_untold(now_ns) for topic in silent):
                return SourceFault("not reported", since_ns, "its node")
            return SourceFault(_with_members("silent", silent, topics), since_ns)
        worst: tuple[str, Streak] | None = None
        for key, streak in self.streaks.items():
            used = max((reports.used for reports in self.topics.values()), default=0)
            streak.used_silently(now_ns, self.period_ns(), used - self.used_at_refusal.get(key, 0))
            if streak.is_out and (worst is None or streak.refused > worst[1].refused):
                worst = key[1], streak
        since_ns = min(worst[1].out_since_ns, now_ns + utc_offset_ns) if worst else 0  # stamps may be of the future
        if self.excluded_since:
            return SourceFault("excluded", since_ns or min(self.excluded_since.values()))
        if worst is not None:
            return SourceFault(_refusal_text(self.name, *worst), since_ns)
        return self._unusable(now_ns, utc_offset_ns)

    def _unusable(self, now_ns: int, utc_offset_ns: int) -> SourceFault | None:
        """It is judged, arrives, and has given nothing that could be judged for some time."""
        word, period_ns = _NOTHING_USABLE.get(self.first_word), self.period_ns()
        if word is None or self.judged_ns is None or math.isnan(period_ns):
            return None
        if now_ns - self.judged_ns <= max(2e9, _UNUSABLE_PERIODS * period_ns):
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

    def shown(self, fault: SourceFault | None, now_ns: int) -> SourceShown:
        """What is shown of it with this fault, or in where it has none."""
        streaks = self.streaks.values()
        off = [streak.disagreement for streak in streaks if fault and not fault.because_of]
        furthest = max(off, key=lambda one: abs(one.sigmas) if one.text else -1.0, default=NO_DISAGREEMENT)
        if fault is None and self.put_right_ns is not None and now_ns - self.put_right_ns <= SHOWN_NS:
            furthest = Disagreement(self.put_right, math.nan)
        rates = [topic.rate_hz for topic in self.topics.values() if not math.isnan(topic.rate_hz)]
        judged = any(streak.is_judged for streak in streaks)
        return SourceShown(
            name=self.name,
            presence=self._presence(fault),
            reason=fault.reason if fault else "",
            disagreement=furthest.text,
            residual=furthest.sigmas,
            verdict=self.window.verdict(now_ns) if judged else None,
            age_s=self.age_s(now_ns),
            rate_hz=max(rates, default=math.nan),
            refused=max((streak.refused for streak in streaks), default=0),
            out_since_ns=fault.since_ns if fault else 0,
            topics=tuple(sorted(self.topics)),
            because_of=fault.because_of if fault else "",
        )

    def _presence(self, fault: SourceFault | None) -> Presence:
        if fault is not None:
            return Presence.OUT
        never = all(topic.arrived_ns is None for topic in self.topics.values())
        return Presence.OFF if never and not self.streaks else Presence.IN


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
