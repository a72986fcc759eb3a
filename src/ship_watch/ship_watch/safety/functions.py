"""Functions of a suite: heading, tilt and pointing, each with a limit of its accuracy.

A function has the safety of its worst angle. :func:`functions` returns the state of each function, the source that
causes this state, and the sources that the function depends on. The alerts and the tree in `/diagnostics` are made from
these states.
"""

import math
from dataclasses import dataclass

import numpy as np

from ship_watch.safety.limits import Limits
from ship_watch.safety.safety import OVER_THE_LIMIT
from ship_watch.suite_state import AngleState, Presence, Priority, Safety, SourceDetails, SuiteState
from ship_watch.value_texts import without_changing_figures

ATTITUDE, POINTING = "attitude", "pointing"
"""Outputs that provide the functions."""

QUANTITIES = {"heading": ("heading",), "tilt": ("pitch", "roll"), "pointing": ("azimuth", "elevation")}
"""Function, which is a quantity with its own limit → its angles."""

SHIP_SOURCES = ("ins", "star", "reference", "gnss", "weather")
THEODOLITE_SOURCES = ("encoder", "lights", "baselines", "ship_attitude")
"""Kinds of sources of the attitude, and those of the pointing in addition."""

_PRIORITY_TEXTS = {
    None: "safe",
    Priority.ALARM: "lost",
    Priority.WARNING: "over its limit",
    Priority.CAUTION: "unchecked",
}


@dataclass(frozen=True)
class FunctionState:
    """State of one function of the suite.

    Attributes:
        name: "heading", "tilt" or "pointing".
        output: :data:`ATTITUDE` or :data:`POINTING`.
        safety: the worst safety of the function's angles; None if the suite does not provide this function.
        angle: the worst of the function's angles.
        because_of: the source that causes a safety other than SAFE, or "attitude" for a pointing that is lost with the
            attitude; empty if no cause is known.
        is_output_missing: True if the output is no longer received, or was never received.
        over_limit_s: longest time for which the accuracy of one of the angles has been over the limit, s; 0 if the
            accuracies of all angles are within the limit.
        sources: the sources that the function depends on, in the order of the suite state.
    """

    name: str
    output: str
    safety: Safety | None
    angle: AngleState
    because_of: str
    is_output_missing: bool
    over_limit_s: float
    sources: tuple[SourceDetails, ...]

    @property
    def accuracy_arcsec(self) -> float:
        """Accuracy (95 %) of the worst angle, arcsec."""
        return float(np.degrees(self.angle.accuracy_95)) * 3600.0

    @property
    def limit_arcsec(self) -> float:
        """Limit of the accuracy of the worst angle, arcsec."""
        return float(np.degrees(self.angle.limit)) * 3600.0

    @property
    def is_over_limit(self) -> bool:
        """True if the accuracy is not within the limit, or the angle is UNSAFE."""
        return self.safety is Safety.UNSAFE or not self.angle.accuracy_95 <= self.angle.limit

    @property
    def priority(self) -> Priority | None:
        """Priority of the state: alarm if lost, warning if over its limit, caution if unchecked, None if SAFE."""
        if not self.safety:
            return None
        if self.safety is Safety.UNSAFE:
            return Priority.ALARM
        return Priority.WARNING if self.is_over_limit else Priority.CAUTION

    @property
    def text(self) -> str:
        """Name and state of the function; the text changes only with the situation."""
        if self.safety is None:
            return f"{self.name} off"
        if self.angle.is_recovering:
            return f"{self.name} good again"
        return f"{self.name} {_PRIORITY_TEXTS[self.priority]}"

    @property
    def reason(self) -> str:
        """Reason of the worst angle without changing figures; a hint at the budget if only its accuracy is bad."""
        return (
            "see the error budget"
            if self.angle.reason == OVER_THE_LIMIT
            else without_changing_figures(self.angle.reason)
        )


def functions(suite_state: SuiteState) -> tuple[FunctionState, ...]:
    """Return the functions of a suite; the pointing only if the suite has a theodolite."""
    angles = {angle.name: angle for angle in suite_state.angles}
    is_shown = {
        ATTITUDE: math.isfinite(angles["heading"].age_s) or not math.isfinite(angles["azimuth"].age_s)
        if "azimuth" in angles else True,
        POINTING: True,
    }
    found: list[FunctionState] = []
    for name, members in QUANTITIES.items():
        if not all(member in angles for member in members):
            continue
        output = POINTING if name == "pointing" else ATTITUDE
        worst = max((angles[member] for member in members), key=_severity)
        safety = worst.safety if is_shown[output] else None
        because_of = worst.because_of if safety else ""
        lost_before = [one for one in found if one.safety is Safety.UNSAFE]
        if output == POINTING and safety is Safety.UNSAFE and lost_before:
            # The pointing needs the attitude, so the cause of the lost attitude is also the cause of the lost pointing.
            because_of = next((one.because_of for one in lost_before if one.because_of), ATTITUDE)
        kinds = (*THEODOLITE_SOURCES, *SHIP_SOURCES) if output == POINTING else SHIP_SOURCES
        sources = tuple(one for one in suite_state.sources if one.name.partition(".")[0] in kinds)
        over_s = max(angles[member].over_limit_s for member in members)
        found.append(
            FunctionState(name, output, safety, worst, because_of, bool(safety) and worst.is_old, over_s, sources)
        )
    return tuple(found)


@dataclass(frozen=True)
class DiagnosticEntry:
    """One entry of the tree in `/diagnostics`.

    Attributes:
        path: path from the root, separated by slashes: "heading within 5″/ins".
        level: level as in diagnostic_msgs/DiagnosticStatus: 0 OK, 1 WARN, 2 ERROR, 3 STALE.
        text: one line for people.
    """

    path: str
    level: int
    text: str


def diagnostic_entries(suite_state: SuiteState, limits: Limits) -> tuple[DiagnosticEntry, ...]:
    """Return the functions with their limits, each followed by the sources that it depends on."""
    limit_arcsec = {
        "heading": limits.heading_arcsec, "tilt": limits.tilt_arcsec, "pointing": limits.pointing_arcsec
    }
    entries = []
    for function in functions(suite_state):
        path = f"{function.name} within {limit_arcsec[function.name]:g}″"
        entries.append(DiagnosticEntry(path, _diagnostic_level(function), _function_text(function)))
        configured = (source for source in function.sources if source.presence is not Presence.OFF)
        entries += [_source_entry(path, function, source) for source in configured]
    return tuple(entries)


def _source_entry(path: str, function: FunctionState, source: SourceDetails) -> DiagnosticEntry:
    if source.presence is Presence.IN:
        return DiagnosticEntry(f"{path}/{source.name}", 0, ", ".join(filter(None, ["in", source.disagreement])))
    parts = [f"out: {source.reason}", source.disagreement]
    is_cause = source.name == function.because_of and function.safety is not None
    if is_cause:
        parts.append(f"therefore {function.text}")
    level = 2 if is_cause and function.safety is Safety.UNSAFE else 1
    return DiagnosticEntry(f"{path}/{source.name}", level, ", ".join(filter(None, parts)))


def _function_text(function: FunctionState) -> str:
    if function.safety is None:
        return "not in use: only a pointing was received, no attitude"
    accuracy = f"{function.accuracy_arcsec:.1f}″ (95 %)" if math.isfinite(function.accuracy_arcsec) else "no accuracy"
    known = "never received" if math.isinf(function.angle.age_s) else f"{accuracy}, limit {function.limit_arcsec:g}″"
    if function.safety is Safety.SAFE:
        return f"safe: {known}"
    because = f"because of {function.because_of}" if function.because_of else ""
    lost = "" if function.angle.is_recovering else function.text.partition(" ")[2]
    return ", ".join(filter(None, [lost, because, function.angle.reason, known]))


def _diagnostic_level(function: FunctionState) -> int:
    if function.safety is None:
        return 0
    return 3 if function.is_output_missing else int(function.safety)


def _severity(angle: AngleState) -> tuple[int, float]:
    share = angle.accuracy_95 / angle.limit
    return int(angle.safety), math.inf if math.isnan(share) else share
