"""What a suite is there for, as functions: the heading, the tilt, the pointing, each within its limit.

A function is as good as the worst of its angles. :func:`functions` says of each how it does, which source takes it away
and how the sources do that it rests on: the tree of `/diagnostics`, and what the alerts are made of.
"""

import math
import re
from dataclasses import dataclass

import numpy as np

from ship_watch.limits import Limits
from ship_watch.picture import AngleShown, Picture, Presence, Priority, Safety, SourceShown
from ship_watch.states import OVER_THE_LIMIT

ATTITUDE, POINTING = "attitude", "pointing"
"""The outputs that functions come by."""

_ANGLES = {"heading": ("heading",), "tilt": ("pitch", "roll"), "pointing": ("azimuth", "elevation")}
_SHIP = ("ins", "star", "reference", "gnss", "weather")
_THEODOLITE = ("encoder", "lights", "baselines", "ship_attitude")

_WORDS = {None: "safe", Priority.ALARM: "lost", Priority.WARNING: "over its limit", Priority.CAUTION: "unchecked"}

_RUNNING = re.compile(r" for \d+ s\b|\b\d+ (?=refused|accepted)|\b[\d.]+ s (?=behind)|, load \d+")


@dataclass(frozen=True)
class FunctionShown:
    """One function of the suite.

    Attributes:
        name: "heading", "tilt" or "pointing".
        output: :data:`ATTITUDE` or :data:`POINTING`.
        safety: the worst word of its angles; None where the suite was never asked for it.
        angle: the worst of its angles.
        because_of: the source that is to blame where it is not SAFE, or "attitude" for a pointing that is lost with the
            attitude; empty where nobody is known.
        is_silent: whether its output does not come any more, or never came.
        over_s: for how long the accuracy of one of its angles has been over its limit; 0 where none is.
        sources: those that it rests on, as in the picture.
    """

    name: str
    output: str
    safety: Safety | None
    angle: AngleShown
    because_of: str
    is_silent: bool
    over_s: float
    sources: tuple[SourceShown, ...]

    @property
    def accuracy_arcsec(self) -> float:
        """95 % of the worst angle, arcsec."""
        return float(np.degrees(self.angle.accuracy_95)) * 3600.0

    @property
    def limit_arcsec(self) -> float:
        """Limit of that, arcsec."""
        return float(np.degrees(self.angle.limit)) * 3600.0

    @property
    def is_over(self) -> bool:
        """Whether the accuracy is not within the limit, or there is no angle at all."""
        return self.safety is Safety.UNSAFE or not self.angle.accuracy_95 <= self.angle.limit

    @property
    def priority(self) -> Priority | None:
        """How urgent its state is: lost is an alarm, over its limit a warning, unchecked a caution; None for SAFE."""
        if not self.safety:
            return None
        if self.safety is Safety.UNSAFE:
            return Priority.ALARM
        return Priority.WARNING if self.is_over else Priority.CAUTION

    @property
    def text(self) -> str:
        """What it has lost, in words that stay the same as long as the situation does."""
        if self.safety is None:
            return f"{self.name} off"
        if self.angle.is_good_again:
            return f"{self.name} good again"
        return f"{self.name} {_WORDS[self.priority]}"

    @property
    def reason(self) -> str:
        """Why, without figures that run; where only the accuracy is to blame, where to look for its causes."""
        return "see its error budget" if self.angle.reason == OVER_THE_LIMIT else still(self.angle.reason)


def still(text: str) -> str:
    """A text without the figures that change at every look: "81 refused in a row" is "refused in a row"."""
    return _RUNNING.sub("", text).replace("accepted again", "refused in a row")


def functions(picture: Picture) -> tuple[FunctionShown, ...]:
    """The functions of a suite; the pointing only where the suite has a theodolite."""
    angles = {angle.name: angle for angle in picture.angles}
    is_asked = {
        ATTITUDE: math.isfinite(angles["heading"].age_s) or not math.isfinite(angles["azimuth"].age_s)
        if "azimuth" in angles else True,
        POINTING: True,
    }
    found: list[FunctionShown] = []
    for name, members in _ANGLES.items():
        if not all(member in angles for member in members):
            continue
        output = POINTING if name == "pointing" else ATTITUDE
        worst = max((angles[member] for member in members), key=_badness)
        safety = worst.safety if is_asked[output] else None
        because_of = worst.because_of if safety else ""
        lost_before = [one for one in found if one.safety is Safety.UNSAFE]
        if output == POINTING and safety is Safety.UNSAFE and lost_before:
            # Without the attitude there is no pointing, whatever else is out.
            because_of = next((one.because_of for one in lost_before if one.because_of), ATTITUDE)
        words = (*_THEODOLITE, *_SHIP) if output == POINTING else _SHIP
        sources = tuple(one for one in picture.sources if one.name.partition(".")[0] in words)
        over_s = max(angles[member].over_s for member in members)
        found.append(
            FunctionShown(name, output, safety, worst, because_of, bool(safety) and worst.is_old, over_s, sources)
        )
    return tuple(found)


@dataclass(frozen=True)
class Branch:
    """One entry of the tree in `/diagnostics`.

    Attributes:
        path: from the root, parts between slashes: "heading within 5″/ins".
        level: as in diagnostic_msgs/DiagnosticStatus: 0 OK, 1 WARN, 2 ERROR, 3 STALE.
        text: one line for people.
    """

    path: str
    level: int
    text: str


def tree(picture: Picture, limits: Limits) -> tuple[Branch, ...]:
    """The functions with their limits, and under each the sources that it rests on."""
    limit_arcsec = {
        "heading": limits.heading_arcsec, "tilt": limits.tilt_arcsec, "pointing": limits.pointing_arcsec
    }
    branches = []
    for function in functions(picture):
        path = f"{function.name} within {limit_arcsec[function.name]:g}″"
        branches.append(Branch(path, _level(function), _line(function)))
        configured = (source for source in function.sources if source.presence is not Presence.OFF)
        branches += [_source_branch(path, function, source) for source in configured]
    return tuple(branches)


def _source_branch(path: str, function: FunctionShown, source: SourceShown) -> Branch:
    if source.presence is Presence.IN:
        return Branch(f"{path}/{source.name}", 0, ", ".join(filter(None, ["in", source.disagreement])))
    parts = [f"out: {source.reason}", source.disagreement]
    is_cause = source.name == function.because_of and function.safety is not None
    if is_cause:
        parts.append(f"for this {function.text}")
    level = 2 if is_cause and function.safety is Safety.UNSAFE else 1
    return Branch(f"{path}/{source.name}", level, ", ".join(filter(None, parts)))


def _line(function: FunctionShown) -> str:
    if function.safety is None:
        return "not asked for: no attitude was ever heard, a pointing was"
    accuracy = f"{function.accuracy_arcsec:.1f}″" if math.isfinite(function.accuracy_arcsec) else "no accuracy"
    known = "never heard" if math.isinf(function.angle.age_s) else f"{accuracy} of {function.limit_arcsec:g}″ (95 %)"
    if function.safety is Safety.SAFE:
        return f"safe: {known}"
    because = f"because of {function.because_of}" if function.because_of else ""
    lost = "" if function.angle.is_good_again else function.text.partition(" ")[2]
    return ", ".join(filter(None, [lost, because, function.angle.reason, known]))


def _level(function: FunctionShown) -> int:
    if function.safety is None:
        return 0
    return 3 if function.is_silent else int(function.safety)


def _badness(angle: AngleShown) -> tuple[int, float]:
    share = angle.accuracy_95 / angle.limit
    return int(angle.safety), math.inf if math.isnan(share) else share
