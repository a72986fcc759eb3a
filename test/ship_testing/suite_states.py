"""Hand-made suite states: a suite with a theodolite, its variants, and the two example faults of the page's design."""

import math
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from ship_geometry.rotations import ARCSEC
from ship_monitor.terminal.styled_text import Line
from ship_watch.history.history import History, SafetyPoint
from ship_watch.safety.limits import Limits
from ship_watch.suite_state import (
    ANGLES,
    AlertEntry,
    AngleState,
    Event,
    InputState,
    NisConsistency,
    Presence,
    Priority,
    Safety,
    SourceDetails,
    SuiteState,
)

NS = 1_000_000_000
NOW_NS = 1_777_636_807 * NS
"""2026-05-01 12:00:07 UTC."""

LIMITS = Limits(heading_arcsec=5.0, tilt_arcsec=3.0, pointing_arcsec=10.0)
"""Limits of the ship in these states."""

_VALUES_DEG = {"heading": 34.392, "pitch": -0.12, "roll": -2.1, "azimuth": 359.88, "elevation": 68.74}
_ACCURACIES = {"heading": 3.3, "pitch": 2.7, "roll": 2.8, "azimuth": 4.9, "elevation": 5.3}
_AGES = {"ins": 0.1, "star.fore": 0.6, "star.starboard": 0.6, "lights": 0.6, "encoder": 0.1, "baselines": 0.3}
_AGES |= {"gnss": 0.1, "weather": 1.1}


def angle(name: str, **changes: Any) -> AngleState:
    """Return an angle in normal state."""
    well = AngleState(
        name=name,
        value=float(np.deg2rad(_VALUES_DEG[name])),
        accuracy_95=_ACCURACIES[name] * ARCSEC,
        limit=LIMITS.angle_limit(name),
        protection_level=math.nan,
        safety=Safety.SAFE,
        reason="",
        age_s=0.1,
        is_old=False,
        stamp_ns=NOW_NS,
        since_ns=NOW_NS - 300 * NS,
    )
    return replace(well, **changes)


def unsafe_angle(name: str, because_of: str = "") -> AngleState:
    """Return an angle that is UNSAFE."""
    return angle(name, accuracy_95=math.nan, safety=Safety.UNSAFE, reason="invalid", because_of=because_of)


def angle_over_limit(name: str, because_of: str = "", share: float = 1.5) -> AngleState:
    """Return an angle with an accuracy of ``share`` times its limit."""
    limit = LIMITS.angle_limit(name)
    changes = {"accuracy_95": share * limit, "safety": Safety.CAUTION, "reason": "over the limit", "over_limit_s": 7.0}
    return angle(name, because_of=because_of, **changes)


def angles_without_data(*names: str) -> list[AngleState]:
    """Return angles that were never received."""
    changes = {"value": math.nan, "accuracy_95": math.nan, "safety": Safety.UNSAFE, "reason": "waiting"}
    return [angle(name, age_s=math.inf, is_old=True, **changes) for name in names]


def angles_timed_out(*names: str, age_s: float = 7.0, reason: str = "no data") -> list[AngleState]:
    """Return angles that were not received for some seconds."""
    return [angle(name, safety=Safety.UNSAFE, reason=reason, age_s=age_s, is_old=True) for name in names]


def source(name: str, **changes: Any) -> SourceDetails:
    """Return a source in normal state."""
    consistency = NisConsistency(1.01, 400, "σ as stated (1.01)", True) if name.startswith(("star", "lights")) else None
    well = SourceDetails(
        name=name,
        presence=Presence.IN,
        reason="",
        disagreement="",
        residual=math.nan,
        out_since_ns=0,
        because_of="",
        nis_consistency=consistency,
        age_s=_AGES.get(name, 0.5),
        rate_hz=2.0,
        rejected_in_a_row=0,
        topics=(f"{name.replace('.', '/')}/topic",),
    )
    return replace(well, **changes)


def source_out(name: str, reason: str, **changes: Any) -> SourceDetails:
    """Return a source that is OUT."""
    return source(name, presence=Presence.OUT, reason=reason, **changes)


def late_input(topic: str, latency_s: float) -> InputState:
    """Return an input topic whose stamps are ``latency_s`` behind the clock (ahead if ``latency_s`` is negative)."""
    return InputState(topic, 2.0, latency_s, 0.1, 0, 0, {})


def alert(subject: str, text: str, raised_ns: int, priority: Priority = Priority.WARNING, state: int = 1) -> AlertEntry:
    """Return an alert."""
    return AlertEntry(
        id=subject,
        instance=1,
        priority=priority,
        state=state,
        source=subject,
        text=text,
        value=8.1,
        limit=3.3,
        unit="σ",
        raised_ns=raised_ns,
        changed_ns=raised_ns,
    )


def suite_state(*changed: AngleState | SourceDetails, **changes: Any) -> SuiteState:
    """Return a suite with a theodolite in normal state: five angles SAFE, eight sources IN, no alert.

    The given angles and sources replace those with the same names; sources that are OUT are first.
    """
    angles = {name: angle(name) for name in ANGLES}
    sources = {name: source(name) for name in _AGES}
    for one in changed:
        if isinstance(one, AngleState):
            angles[one.name] = one
        else:
            sources[one.name] = one
    well = SuiteState(
        utc_ns=NOW_NS,
        angles=tuple(angles.values()),
        ages_s={"stars": 0.5, "lights": 0.6, "ins": 0.1},
        pointing_by="2 lights",
        horizon="geodetic",
        sources=tuple(sorted(sources.values(), key=lambda one: one.presence is not Presence.OUT)),
        alerts=(),
        inputs=(),
        events=(),
        waiting_for="",
    )
    return replace(well, **changes)


SHIFTED_SENSOR = source_out(
    "star.starboard",
    "81 rejected in a row",
    disagreement="reads 49″ high",
    residual=8.1,
    rejected_in_a_row=81,
    out_since_ns=NOW_NS - 39 * NS,
    topics=("star/starboard/observations",),
)
SHIFTED_SENSOR_ALERT = replace(
    alert("star.starboard", "star.starboard out", NOW_NS - 38 * NS), id="star.starboard.out", instance=2
)
SHIFTED_SENSOR_INPUT = InputState(SHIFTED_SENSOR.topics[0], 2.0, 0.1, 0.6, 1, 81, {"gate": 9, "attitude_conflict": 72})


def state_with_mounting_shift(*changed: AngleState | SourceDetails, **changes: Any) -> SuiteState:
    """Return a state with a displaced star sensor, the first example fault in the design of page and terminal."""
    text = "WARNING star.starboard rejected"
    well = {
        "alerts": (SHIFTED_SENSOR_ALERT,),
        "inputs": (SHIFTED_SENSOR_INPUT,),
        "events": (
            Event(NOW_NS - 36 * NS, "state", "roll", "roll SAFE → CAUTION, over the limit"),
            Event(NOW_NS - 38 * NS, "alert", SHIFTED_SENSOR_ALERT.id, text),
        ),
    }
    heading = angle("heading", accuracy_95=4.2 * ARCSEC, safety=Safety.CAUTION, reason="one star source")
    roll = angle("roll", accuracy_95=3.7 * ARCSEC, safety=Safety.CAUTION, reason="over the limit")
    return suite_state(heading, roll, SHIFTED_SENSOR, *changed, **well | changes)


def state_with_two_faults() -> SuiteState:
    """Return the state with a displaced star sensor, and an encoder without messages for twelve seconds.

    The state contains angles that are SAFE, CAUTION, UNSAFE and old.
    """
    angles = angles_timed_out("azimuth", "elevation", age_s=12.0, reason="no data from encoder")
    encoder = source_out("encoder", "no data", age_s=12.0, out_since_ns=NOW_NS - 12 * NS)
    lost_pointing = alert("encoder", "Pointing lost: no data from encoder", NOW_NS - 10 * NS)
    return state_with_mounting_shift(
        *angles, encoder, alerts=(lost_pointing, SHIFTED_SENSOR_ALERT), pointing_by="no pointing"
    )


def history(*, is_faulty: bool = False) -> History:
    """Return ten minutes of states, one a second: heading, pitch and roll are CAUTION from 212 s to 240 s.

    With ``is_faulty``, heading and roll are CAUTION from 561 s on, and the theodolite's angles UNSAFE from 588 s on.
    """
    points = deque()
    for second in range(600):
        words = dict.fromkeys(ANGLES, Safety.SAFE)
        if 212 <= second < 240:
            words |= dict.fromkeys(("heading", "pitch", "roll"), Safety.CAUTION)
        if is_faulty and second >= 561:
            words |= dict.fromkeys(("heading", "roll"), Safety.CAUTION)
        if is_faulty and second >= 588:
            words |= dict.fromkeys(("azimuth", "elevation"), Safety.UNSAFE)
        points.append(SafetyPoint(NOW_NS - (599 - second) * NS, words))
    return History(safety=points)


def plain_text(line: Line) -> str:
    """Return the text of a line of the terminal view without its styles."""
    return "".join(piece.text for piece in line)
