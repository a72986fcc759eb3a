"""Pictures made by hand: a suite with a theodolite where all is well, and what is changed in it."""

import math
from dataclasses import replace
from typing import Any

from ship_watch.limits import Limits
from ship_watch.picture import ANGLES, AngleShown, InputShown, Picture, Presence, Safety, SourceShown

UTC = 1_700_000_000_000_000_000
SOURCES = ("ins", "star.bow", "star.starboard", "lights", "encoder", "baselines", "ship_attitude", "gnss", "weather")


def angle(name: str, accuracy: float = 0.5, **changes: Any) -> AngleShown:
    """An angle whose accuracy is a share of its limit."""
    limit = Limits().of_angle(name)
    good = AngleShown(name, 0.1, accuracy * limit, limit, 2.0 * limit, Safety.SAFE, "", 0.1, False, UTC, UTC)
    return replace(good, **changes)


def source(name: str, **changes: Any) -> SourceShown:
    """A source that is IN."""
    good = SourceShown(name, Presence.IN, "", "", math.nan, None, 0.1, 2.0, 0, 0, (f"{name}/topic",))
    return replace(good, **changes)


def out(name: str, reason: str, **changes: Any) -> SourceShown:
    """A source that is OUT."""
    return source(name, presence=Presence.OUT, reason=reason, **changes)


def picture(*changed: AngleShown | SourceShown, **changes: Any) -> Picture:
    """A suite with a theodolite; the angles and sources given stand in the places of those of their names."""
    angles = {name: angle(name) for name in ANGLES}
    sources = {name: source(name) for name in SOURCES}
    for one in changed:
        if isinstance(one, AngleShown):
            angles[one.name] = one
        else:
            sources[one.name] = one
    shown = sorted(sources.values(), key=lambda one: one.presence is not Presence.OUT)
    ages = {"stars": 0.5, "lights": 0.6, "ins": 0.1}
    well = Picture(UTC, tuple(angles.values()), ages, "2 lights", "geodetic", tuple(shown), None, (), (), "")
    return replace(well, **changes)


def lost(name: str, because_of: str = "", **changes: Any) -> AngleShown:
    """An angle that is UNSAFE."""
    return angle(name, math.nan, safety=Safety.UNSAFE, reason="invalid", because_of=because_of, **changes)


def over(name: str, because_of: str = "", share: float = 1.5) -> AngleShown:
    """An angle that is over its limit, but not by three times."""
    return angle(name, share, safety=Safety.CAUTION, reason="over the limit", because_of=because_of)


def never_heard(*names: str) -> list[AngleShown]:
    """Angles that were never told."""
    return [
        angle(name, math.nan, value=math.nan, safety=Safety.UNSAFE, reason="waiting", age_s=math.inf, is_old=True)
        for name in names
    ]


def silent(*names: str) -> list[AngleShown]:
    """Angles that were not told for some seconds."""
    return [angle(name, safety=Safety.UNSAFE, reason="silent", age_s=7.0, is_old=True) for name in names]


def late_input(topic: str, latency_s: float) -> InputShown:
    """An input topic whose stamps are so far behind the clock, negative ahead of it."""
    return InputShown(topic, 2.0, latency_s, 0.1, 0, 0, {})

