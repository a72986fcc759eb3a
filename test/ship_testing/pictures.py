"""Hand-made pictures of a suite: all well, and the two faults of the design of the page."""

from collections import deque
from dataclasses import replace

import numpy as np

from ship_geometry.rotations import ARCSEC
from ship_watch.history import History, SafetyPoint
from ship_watch.picture import (
    ANGLES,
    AlertShown,
    AngleShown,
    NisVerdict,
    Picture,
    Presence,
    Priority,
    Safety,
    SourceShown,
)

NS = 1_000_000_000
NOW_NS = 1_777_636_807 * NS
"""2026-05-01 12:00:07 UTC."""

_VALUES_DEG = {"heading": 34.39, "pitch": -0.1, "roll": -2.1, "azimuth": 359.88, "elevation": 68.74}
_ACCURACIES = {"heading": 3.3, "pitch": 2.7, "roll": 2.8, "azimuth": 4.9, "elevation": 5.3}
_LIMITS = {"heading": 5.0, "pitch": 3.0, "roll": 3.0, "azimuth": 10.0, "elevation": 10.0}
_AGES = {"ins": 0.1, "star.fore": 0.6, "star.starboard": 0.6, "lights": 0.6, "encoder": 0.1, "baselines": 0.3}
_AGES |= {"gnss": 0.1, "weather": 1.1}


def angle(name: str) -> AngleShown:
    """An angle as all is well."""
    return AngleShown(
        name=name,
        value=float(np.deg2rad(_VALUES_DEG[name])),
        accuracy_95=_ACCURACIES[name] * ARCSEC,
        limit=_LIMITS[name] * ARCSEC,
        protection_level=float("nan"),
        safety=Safety.SAFE,
        reason="",
        age_s=0.1,
        is_old=False,
        stamp_ns=NOW_NS,
        since_ns=NOW_NS - 300 * NS,
    )


def source(name: str) -> SourceShown:
    """A source as all is well."""
    verdict = NisVerdict(1.01, 400, "σ as stated (1.01)", True) if name.startswith(("star", "lights")) else None
    return SourceShown(
        name=name,
        presence=Presence.IN,
        reason="",
        disagreement="",
        residual=float("nan"),
        verdict=verdict,
        age_s=_AGES.get(name, 0.5),
        rate_hz=2.0,
        refused=0,
        out_since_ns=0,
        topics=(),
    )


def all_well() -> Picture:
    """Five angles SAFE, eight sources IN, no alert."""
    return Picture(
        utc_ns=NOW_NS,
        angles=tuple(angle(name) for name in ANGLES),
        ages_s={"stars": 0.5, "lights": 0.6, "ins": 0.1},
        pointing_by="2 lights",
        horizon="geodetic",
        sources=tuple(source(name) for name in _AGES),
        alerts=(),
        inputs=(),
        events=(),
        waiting_for="",
    )


def faulty() -> Picture:
    """A knocked star sensor, and an encoder that has been silent for twelve seconds: SAFE, CAUTION, UNSAFE, OLD."""
    well = all_well()
    changes = {
        "heading": {"accuracy_95": 4.2 * ARCSEC, "safety": Safety.CAUTION, "reason": "one star source, no cross-check"},
        "roll": {"accuracy_95": 3.7 * ARCSEC, "safety": Safety.CAUTION, "reason": "over the limit"},
    }
    old = {"safety": Safety.UNSAFE, "reason": "encoder silent since 11:59:55", "is_old": True, "age_s": 12.0}
    changes |= {"azimuth": old, "elevation": old}
    knocked = replace(
        source("star.starboard"),
        presence=Presence.OUT,
        reason="81 refused in a row",
        disagreement="right +49″",
        residual=8.1,
        refused=81,
        out_since_ns=NOW_NS - 39 * NS,
    )
    silent = replace(
        source("encoder"), presence=Presence.OUT, reason="silent", age_s=12.0, out_since_ns=NOW_NS - 12 * NS
    )
    inside = tuple(each for each in well.sources if each.name not in ("star.starboard", "encoder"))
    alerts = (
        alert("pointing", "pointing lost, encoder silent", NOW_NS - 10 * NS),
        alert("star.starboard", "out", NOW_NS - 38 * NS),
    )
    return replace(
        well,
        angles=tuple(replace(each, **changes.get(each.name, {})) for each in well.angles),
        pointing_by="no pointing",
        sources=(knocked, silent, *inside),
        alerts=alerts,
    )


def alert(subject: str, text: str, raised_ns: int, priority: Priority = Priority.WARNING, state: int = 1) -> AlertShown:
    """An alert."""
    return AlertShown(
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


def history(*, is_faulty: bool = False) -> History:
    """Ten minutes of words, one a second: half a minute of CAUTION after four, and with faults the last ones."""
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
    return History(ribbons=points)
