"""What a watch officer is shown at one moment: the contract between what is judged and what is drawn.

:class:`Picture` is made by :meth:`ship_watch.watch.Watch.look` from the messages of a suite. The live page, the
terminal view, the alerts and the report read it; none of them judges anew. Angles are in radians, ages in seconds,
times in integer ns. NaN means that there is no value; an infinite age, that nothing was ever heard.
"""

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from ship_watch.alert_advice import advice_for

ANGLES = ("heading", "pitch", "roll", "azimuth", "elevation")
"""The angles of a picture, in the order in which they are shown."""

ITS_NODE = "its node"
"""What a source is out because of where the node that reads it has ended: nothing is known of the source itself."""


class Safety(enum.IntEnum):
    """How far an angle may be relied on, in the words of IMO MSC.1/Circ.1575; the worse the larger."""

    SAFE = 0
    CAUTION = 1
    UNSAFE = 2


class Presence(enum.Enum):
    """Whether a source takes part."""

    IN = "IN"
    OUT = "OUT"
    OFF = "OFF"
    """It is not configured: no topic of it was ever named."""


class Priority(enum.IntEnum):
    """Urgency of an alert, as in ship_msgs/Alert."""

    CAUTION = 0
    WARNING = 1
    ALARM = 2


@dataclass(frozen=True)
class AngleShown:
    """One angle as a tile or a line shows it.

    Attributes:
        name: one of :data:`ANGLES`.
        value: the angle, rad: heading and azimuth from north to the right, pitch bow up, roll port up, elevation up.
        accuracy_95: 1.96 sigma, rad; of the azimuth times the cosine of the elevation.
        limit: the ship's limit of ``accuracy_95``, rad.
        protection_level: bound under any single fault, rad; NaN where none is told.
        safety: the word.
        reason: why it is not SAFE, a few words, true now: where only the patience holds the word, when a better one
            comes: "within 3″ again; SAFE in 4 s"; empty where it is SAFE.
        age_s: time since the last value arrived.
        is_old: whether that is too long: the value is then shown greyed, with its age.
        stamp_ns: time of the value, UTC as POSIX time; 0 before the first.
        since_ns: UTC since which the word stands; 0 before the first.
        because_of: the source that is to blame for a word that is not SAFE; empty where none is known.
        over_s: for how long the accuracy has been over its limit; 0 where it is not.
        now: word and reason of this moment, which the shown ones follow at once where they get worse and after some
            time where they get better; None where they are those that are shown.
    """

    name: str
    value: float
    accuracy_95: float
    limit: float
    protection_level: float
    safety: Safety
    reason: str
    age_s: float
    is_old: bool
    stamp_ns: int
    since_ns: int
    because_of: str = ""
    over_s: float = 0.0
    now: tuple[Safety, str] | None = None

    @property
    def is_good_again(self) -> bool:
        """True if the word of this moment is SAFE and the shown one is not yet."""
        return self.now is not None and self.now[0] is Safety.SAFE and self.safety is not Safety.SAFE

    @property
    def held_by_nothing(self) -> "AngleShown":
        """The angle with the word of this moment, for whom has a patience of his own."""
        if self.now is None:
            return self
        safety, reason = self.now
        return replace(self, safety=safety, reason=reason, because_of=self.because_of if safety else "", now=None)


@dataclass(frozen=True)
class NisVerdict:
    """Whether the stated sigma of a source fits its innovations of the last minute.

    Attributes:
        ratio: √(mean NIS / degrees of freedom); NaN where nothing was accepted.
        degrees: degrees of freedom in all.
        text: "σ as stated (1.01)", "σ optimistic by 1.6", "σ pessimistic by 1.3", or empty with too few.
        is_as_stated: whether the ratio lies within 1 ± 3.3/√(2·degrees).
    """

    ratio: float
    degrees: int
    text: str
    is_as_stated: bool


@dataclass(frozen=True)
class SourceStanding:
    """Whether a source takes part, and what is wrong with it: by this words and events are judged.

    Attributes:
        name: "ins", "star.<id>", "reference.<name>", "lights", "encoder", "baselines", "gnss", "weather".
        presence: IN, OUT or OFF.
        reason: why it is OUT: "81 refused in a row", "silent", "invalid", "excluded"; empty where it is IN.
        disagreement: how it disagrees, "right +49″"; of one that is IN what is put right in it, "names exchanged" of
            lights; empty where nothing is known.
        residual: mean of its last residuals over its sigma where it disagrees, NaN elsewhere.
        out_since_ns: UTC of the first refusal or of the silence; 0 where it is IN.
        because_of: the source that is to blame where this one is OUT only because it needs that one, or "its node"
            where the node that reads it says nothing any more; empty where it is to blame itself.
    """

    name: str
    presence: Presence
    reason: str
    disagreement: str
    residual: float
    out_since_ns: int
    because_of: str


@dataclass(frozen=True)
class SourceShown(SourceStanding):
    """One source: an instrument, or what belongs together of one.

    Attributes:
        verdict: of its sigma; None where it has no innovations.
        age_s: time since the last message arrived.
        rate_hz: mean rate of arrival; NaN before two messages.
        refused: messages refused in a row, in input or filter.
        topics: relative topics it comes by.
        mounting_shift: angle between its mounting before an exclusion and after its reinstatement, rad, for ten minutes
            after that; NaN otherwise.
    """

    verdict: NisVerdict | None
    age_s: float
    rate_hz: float
    refused: int
    topics: tuple[str, ...]
    mounting_shift: float = math.nan


@dataclass(frozen=True)
class AlertShown:
    """One alert as the alert node published it; ``state`` as in ship_msgs/Alert."""

    id: str
    instance: int
    priority: Priority
    state: int
    source: str
    text: str
    value: float
    limit: float
    unit: str
    raised_ns: int
    changed_ns: int

    @property
    def is_acknowledged(self) -> bool:
        """Whether nobody needs to acknowledge it any more."""
        return self.state in (0, 3)

    @property
    def is_over(self) -> bool:
        """Whether its situation is gone, and nobody acknowledged it."""
        return self.state == 4

    @property
    def advice(self) -> str:
        """Advice for people, one line; empty for an alert that this suite does not know."""
        return advice_for(self.id)

    @property
    def urgency(self) -> tuple[int, int, int, int, str]:
        """Its place: unacknowledged, over but unacknowledged, acknowledged; in each by priority, newest first.

        The newest is the one that changed last: raised, graver, repeated, over or acknowledged.
        """
        tier = 2 if self.is_acknowledged else int(self.is_over)
        return tier, -self.priority, -self.changed_ns, -self.raised_ns, self.id


@dataclass(frozen=True)
class InputShown:
    """One input topic, with what its node and what the filter behind it refused."""

    topic: str
    rate_hz: float
    latency_s: float
    age_s: float
    level: int
    refused_60s: int
    reasons: Mapping[str, int]


@dataclass(frozen=True)
class Event:
    """Something that changed.

    Attributes:
        utc_ns: when, UTC as POSIX time.
        kind: "state", "status", "mode", "source", "alert" or "node".
        subject: the angle, source, alert or node.
        text: what changed, for people: "roll SAFE → CAUTION, over the limit".
    """

    utc_ns: int
    kind: str
    subject: str
    text: str


@dataclass(frozen=True)
class OverallState:
    """One word for the whole suite.

    Attributes:
        safety: the worst word of all angles; UNSAFE where there is no angle.
        text: the shortest of the reasons for it, and behind it the angles that have it, unless all have; empty where
            all are SAFE.
    """

    safety: Safety
    text: str


@dataclass(frozen=True)
class Picture:
    """All of one moment.

    Attributes:
        utc_ns: the suite's time now, UTC as POSIX time: newest stamp plus the time since it came; 0 before the first.
        angles: in the order of :data:`ANGLES`; those of a theodolite only where one was ever heard.
        ages_s: age of stars, lights and INS, keys "stars", "lights", "ins": of the newest such source that is IN, as
            ``sources`` has it; where all are OUT the time since one was used.
        pointing_by: "2 lights", "1 light", "encoder", "no pointing"; empty without a theodolite.
        horizon: "geodetic", "gravity"; empty before the first attitude.
        sources: OUT first, each followed by those that are out because of it, then in a fixed order.
        alerts: as last published, the most urgent first; None where no alert node was heard.
        inputs: in the order of their topics.
        events: the newest first, at most 200.
        waiting_for: what was never heard and is needed, "ship/attitude"; empty where nothing is missing.
    """

    utc_ns: int
    angles: tuple[AngleShown, ...]
    ages_s: Mapping[str, float]
    pointing_by: str
    horizon: str
    sources: tuple[SourceShown, ...]
    alerts: tuple[AlertShown, ...] | None
    inputs: tuple[InputShown, ...]
    events: tuple[Event, ...]
    waiting_for: str

    @property
    def is_old(self) -> bool:
        """True if no output comes any more: no tick, age or count of the picture is then of now."""
        return all(angle.is_old for angle in self.angles)

    @property
    def overall(self) -> OverallState:
        """Worst word of all angles, with the shortest reason that names a source, else the shortest."""
        worst = max((angle.safety for angle in self.angles), default=Safety.UNSAFE)
        if worst is Safety.SAFE:
            return OverallState(worst, "")
        worst_angles = [angle for angle in self.angles if angle.safety is worst]
        caused = [angle.reason for angle in worst_angles if angle.because_of]
        reasons = caused or [angle.reason for angle in worst_angles]
        reason = min(reasons, key=len, default=f"waiting for {self.waiting_for}" if self.waiting_for else "")
        names = [angle.name for angle in self.angles if angle.safety is worst and angle.reason == reason]
        return OverallState(worst, reason if len(names) == len(self.angles) else f"{reason} ({', '.join(names)})")


class Pictures(Protocol):
    """Where whoever draws has pictures from: a running suite or a bag."""

    @property
    def label(self) -> str:
        """Where the data are from: "LIVE", "BAG" or "SIMULATED", and what is to be added."""
        ...

    @property
    def name(self) -> str:
        """The ship: its namespace without slashes, or the name of the bag."""
        ...

    @property
    def place(self) -> str:
        """Where it looks, in words, for who waits: namespace and domain."""
        ...

    def look(self) -> Picture:
        """The picture now. Who draws asks twice a second: a source that serves several keeps the last one."""
        ...
