"""State of a suite at one time, as page, terminal, alerts and report use it.

:class:`SuiteState` is made by :meth:`ship_watch.suite_monitor.SuiteMonitor.current_state` from the messages of a suite.
Displays do not evaluate the messages again. Angles are in radians, ages in seconds, times in integer ns. NaN means no
value; an infinite age means that nothing was received. Each kind of alert has one line of advice for people;
docs/explanation/alerts.md has the same table.
"""

import enum
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

ANGLES = ("heading", "pitch", "roll", "azimuth", "elevation")
"""Names of the angles, in the order in which they are displayed."""

CAUSE_NODE = "its node"
"""Cause of a source that is OUT because the node that reads it has stopped reporting."""

ADVICE = {
    "attitude.silent": "Check that the node ship_attitude runs, and its log; use the gyro meanwhile",
    "attitude.degraded": "Read the error budget; wait for stars; do not use lost angles",
    "pointing.silent": "Check that the node optical_axis runs, and its log",
    "pointing.degraded": "Send up the other drone; sight both lights",
    "stars.out": "Check what the star sensors share: network, clock, cover, GNSS fix",
    "ins.out": "Check the INS's own alarms; let the INS settle; by night the attitude continues by the stars alone",
    "star.ID.out": "Clean the sensor and check its mounting; calibrate its installation if it was moved",
    "star.ID.remounted": "Check the bolts of its mounting; calibrate its installation before the next voyage",
    "reference.ID.out": "Check the reference system's own alarms; let the system settle",
    "reference.ID.remounted": "Check the bolts of its mounting; calibrate its installation before the next voyage",
    "encoder.out": "Check the mount's controller; home the axes",
    "lights.out": "No action while the drones are on deck; otherwise check lamps and identities",
    "baselines.out": "Check the radio link and the receivers' fix",
    "ship_attitude.out": "Check the alerts of the attitude and the load of the computer",
    "gnss.out": "Check antenna and receiver",
    "weather.out": "Check the weather station",
    "SOURCE.unreported": "Restart the node",
    "SOURCE.mended": "Correct the identities of the drones",
    "SOURCE.rate": "Check the settings of the source and the network",
    "stars.old": "No action by day or under clouds: the accuracy decays as the error budget shows",
    "lights.old": "Sight the lights",
    "clock.ahead": "Set the clocks: NTP or PTP on the computer and the instrument",
    "NODE.box": "Free disk space; restart the node for a new black box",
    "NODE.clock": "Check which node publishes /clock",
    "NODE.stamps": "Set the clock; for a played bag start the node with use_sim_time",
    "NODE.name": "Stop one of the two nodes",
    "NODE.overload": "Stop other programs on the computer; lower the rates; play a bag more slowly",
    "NODE.recovered": "Read the log for the failure; compare the alignment with the previous one",
    "NODE.software": "Keep the black box and report the problem",
    "NODE.sink.ID": "Check cable, port and disk, see /diagnostics; displays on this line show no values or old ones",
    "NODE.source.ID": "Check the instrument and its line; /diagnostics lists the sentences received",
    "disk.full": "Delete or move recordings",
}
"""Kind of an alert → advice."""

_ENDINGS = {"unreported": "SOURCE", "mended": "SOURCE", "rate": "SOURCE"}
_NODE_ENDINGS = ("box", "clock", "stamps", "name", "overload", "recovered", "software")


class Safety(enum.IntEnum):
    """Safety of an angle, in the terms of IMO MSC.1/Circ.1575; a worse safety has a larger number."""

    SAFE = 0
    CAUTION = 1
    UNSAFE = 2


class Presence(enum.Enum):
    """Presence of a source: used (IN), not used (OUT), not configured (OFF)."""

    IN = "IN"
    OUT = "OUT"
    OFF = "OFF"
    """Not configured: no node has reported a topic of the source."""


class Priority(enum.IntEnum):
    """Priority of an alert, as in ship_msgs/Alert."""

    CAUTION = 0
    WARNING = 1
    ALARM = 2


@dataclass(frozen=True)
class AngleState:
    """State of one angle.

    Attributes:
        name: one of :data:`ANGLES`.
        value: the angle, rad: heading and azimuth from north to the right, pitch bow up, roll port up, elevation up.
        accuracy_95: 1.96 sigma, rad. The accuracy of an azimuth is multiplied by the cosine of the elevation.
        limit: the ship's limit of ``accuracy_95``, rad.
        protection_level: bound of the error under any single fault, rad; NaN if there is none.
        safety: the displayed safety.
        reason: reason why the angle is not SAFE; empty if SAFE. During a hold the reason contains the time until the
            safety gets better, as in "within 3″ again; SAFE in 4 s".
        age_s: time since the last value arrived, s.
        is_old: True if the age is over its limit; the value is then displayed in grey, with its age.
        stamp_ns: time of the value, UTC as POSIX time; 0 before the first value.
        since_ns: UTC of the last change of ``safety``; 0 before the first value.
        because_of: the source that causes a safety other than SAFE; empty if none is known.
        over_limit_s: time for which the accuracy has been over its limit, s; 0 if it is within the limit.
        unheld_safety: current safety and reason without hold; None if unknown (from a SuiteState message), or in
            :attr:`without_hold`. A worse safety is displayed at once, a better safety after the hold time.
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
    over_limit_s: float = 0.0
    unheld_safety: tuple[Safety, str] | None = None

    @property
    def is_recovering(self) -> bool:
        """True if the safety without hold is SAFE but the displayed safety is not yet SAFE."""
        return (
            self.unheld_safety is not None and self.unheld_safety[0] is Safety.SAFE and self.safety is not Safety.SAFE
        )

    @property
    def without_hold(self) -> "AngleState":
        """The angle with its safety without hold, for callers with a hold of their own."""
        if self.unheld_safety is None:
            return self
        safety, reason = self.unheld_safety
        return replace(
            self, safety=safety, reason=reason, because_of=self.because_of if safety else "", unheld_safety=None
        )


@dataclass(frozen=True)
class NisConsistency:
    """Consistency of a source's stated sigma with its innovations of the last minute (NIS test).

    Attributes:
        ratio: √(sum of NIS / ``degrees_of_freedom``); NaN if nothing was accepted.
        degrees_of_freedom: sum of the degrees of freedom.
        text: "σ as stated (1.01)", "σ optimistic by 1.6", "σ pessimistic by 1.3"; empty with too few innovations.
        is_consistent: True if the ratio is within 1 ± 3.3/√(2·degrees_of_freedom), or if nothing was accepted.
    """

    ratio: float
    degrees_of_freedom: int
    text: str
    is_consistent: bool


@dataclass(frozen=True)
class SourceState:
    """Presence and fault of a source, from which events and the safety of angles are derived.

    Attributes:
        name: "ins", "star.<id>", "reference.<name>", "lights", "encoder", "baselines", "ship_attitude", "gnss" or
            "weather".
        presence: IN, OUT or OFF.
        reason: reason why the source is OUT, such as "81 rejected in a row", "no data" or "excluded"; empty if IN.
        disagreement: largest offset of a source that is OUT, as "reads 49″ high", or correction in the data of a source
            that is IN, as "names exchanged" for lights. Empty if unknown.
        residual: mean ratio of the last rejected residuals to their sigmas; NaN if there is none.
        out_since_ns: UTC of the begin of the fault: first rejection, exclusion or last message; 0 if IN or unknown.
        because_of: cause of a source that is OUT without a fault of its own: another source that it needs, or
            :data:`CAUSE_NODE`. Empty for a fault of the source itself.
    """

    name: str
    presence: Presence
    reason: str = ""
    disagreement: str = ""
    residual: float = math.nan
    out_since_ns: int = 0
    because_of: str = ""


@dataclass(frozen=True, kw_only=True)
class SourceDetails(SourceState):
    """State of a source with its ages, rates and NIS consistency.

    Attributes:
        nis_consistency: consistency of the source's sigma; None if the source has no accepted innovations.
        age_s: time since the last message arrived, s.
        rate_hz: largest mean rate of arrival of the source's topics, Hz; NaN before two messages.
        rejected_in_a_row: messages rejected in a row, at the input or by the filter.
        topics: topics on which the source publishes, relative to the namespace of the suite.
        mounting_shift: angle between the mounting before an exclusion and after the reinstatement, rad, for ten minutes
            after the reinstatement; NaN otherwise.
    """

    nis_consistency: NisConsistency | None
    age_s: float
    rate_hz: float
    rejected_in_a_row: int
    topics: tuple[str, ...]
    mounting_shift: float = math.nan


@dataclass(frozen=True)
class AlertEntry:
    """One alert as published by the alert node; ``state`` as in ship_msgs/Alert, times UTC as POSIX time."""

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
        """True if the alert needs no acknowledgement, because it is acknowledged or NORMAL."""
        return self.state in (0, 3)

    @property
    def is_over(self) -> bool:
        """True if the situation is over and the alert is not acknowledged."""
        return self.state == 4

    @property
    def advice(self) -> str:
        """Advice for people, one line; empty for an unknown alert id."""
        return advice_for(self.id)

    @property
    def urgency(self) -> tuple[int, int, int, int, str]:
        """Sort key: group (unacknowledged, over but unacknowledged, acknowledged), then priority, then last change."""
        tier = 2 if self.is_acknowledged else int(self.is_over)
        return tier, -self.priority, -self.changed_ns, -self.raised_ns, self.id


@dataclass(frozen=True)
class InputState:
    """State of one input topic as last reported, with the rejections in the last 60 s.

    ``level`` is as in diagnostic_msgs/DiagnosticStatus, ``latency_s`` the mean time from stamp to arrival. If several
    nodes read the topic, the largest number of rejections of one node is given.
    """

    topic: str
    rate_hz: float
    latency_s: float
    age_s: float
    level: int
    rejected_60s: int
    reasons: Mapping[str, int]


@dataclass(frozen=True)
class Event:
    """One change in the suite.

    Attributes:
        utc_ns: time of the change, UTC as POSIX time.
        kind: "state", "status", "mode", "source", "alert" or "node".
        subject: the angle, source, alert or node.
        text: the change, for people: "roll SAFE → CAUTION, over the limit".
    """

    utc_ns: int
    kind: str
    subject: str
    text: str


@dataclass(frozen=True)
class OverallState:
    """Safety of the whole suite.

    Attributes:
        safety: the worst safety of all angles; UNSAFE without an angle.
        text: the shortest reason, followed by the angles with this reason unless all angles have it; empty if SAFE.
    """

    safety: Safety
    text: str


@dataclass(frozen=True)
class SuiteState:
    """State of a suite at one time.

    Attributes:
        utc_ns: time of the suite, UTC as POSIX time: stamp of the output or InputHealth with the least delay, plus the
            time since its arrival; 0 before the first stamp.
        angles: angles in the order of :data:`ANGLES`; angles of a theodolite only if the suite has one.
        ages_s: "stars", "lights" or "ins" → age of the newest source of this kind that is IN, s; if all sources of the
            kind are OUT or not used, the time since one of them was used.
        pointing_by: method of the pointing, such as "2 lights", "stars" or "encoder"; "no pointing" while INVALID;
            empty before the first pointing.
        horizon: horizon of the attitude: "geodetic", "gravity"; empty before the first attitude.
        sources: sources that are OUT first, each followed by the sources that are OUT because of it, then the others in
            a fixed order.
        alerts: alerts as last published, the most urgent first; None without an alert node.
        inputs: input topics in the order of their names.
        events: events, the newest first, at most 200.
        waiting_for: the required output that was never received, "ship/attitude"; empty if none is missing.
    """

    utc_ns: int
    angles: tuple[AngleState, ...]
    ages_s: Mapping[str, float]
    pointing_by: str
    horizon: str
    sources: tuple[SourceDetails, ...]
    alerts: tuple[AlertEntry, ...] | None
    inputs: tuple[InputState, ...]
    events: tuple[Event, ...]
    waiting_for: str

    @property
    def is_old(self) -> bool:
        """True if no output is received any more; no age or count of this state is then current."""
        return all(angle.is_old for angle in self.angles)

    @property
    def overall(self) -> OverallState:
        """Worst safety of all angles, with the shortest reason of an angle whose cause is known, else of any angle."""
        worst = max((angle.safety for angle in self.angles), default=Safety.UNSAFE)
        if worst is Safety.SAFE:
            return OverallState(worst, "")
        worst_angles = [angle for angle in self.angles if angle.safety is worst]
        caused = [angle.reason for angle in worst_angles if angle.because_of]
        reasons = caused or [angle.reason for angle in worst_angles]
        reason = min(reasons, key=len, default=f"waiting for {self.waiting_for}" if self.waiting_for else "")
        names = [angle.name for angle in self.angles if angle.safety is worst and angle.reason == reason]
        return OverallState(worst, reason if len(names) == len(self.angles) else f"{reason} ({', '.join(names)})")


class SuiteStateSource(Protocol):
    """Source of suite states for a display: a running suite or a bag."""

    @property
    def label(self) -> str:
        """Origin of the data: "LIVE", "BAG" or "SIMULATED", with an addition."""

    @property
    def name(self) -> str:
        """Name of the ship: its namespace without slashes, or the name of the bag."""

    @property
    def location(self) -> str:
        """Namespace and domain, or bag, for the display while it waits for data."""

    def current_state(self) -> SuiteState:
        """Return the current state. Displays read it twice a second; a source for several displays caches the state."""


def kind_of(alert_id: str) -> str:
    """Return the kind of an alert, such as "star.ID.out" for "star.fore.out"; no key of :data:`ADVICE` if unknown."""
    if alert_id in ADVICE:
        return alert_id
    first, _, ending = alert_id.rpartition(".")
    if ending in _ENDINGS:
        return f"{_ENDINGS[ending]}.{ending}"
    if line := re.search(r"\.(sink|source)\.[^.]+$", alert_id):
        return f"NODE.{line[1]}.ID"
    device = first.partition(".")[0]
    if device in ("star", "reference"):
        return f"{device}.ID.{ending}"
    return f"NODE.{ending}" if ending in _NODE_ENDINGS else ""


def advice_for(alert_id: str) -> str:
    """Return the advice for an alert, one line; empty for an unknown id."""
    return ADVICE.get(kind_of(alert_id), "")
