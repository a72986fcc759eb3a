"""Safety of an angle (SAFE, CAUTION or UNSAFE) and a short reason where it is not SAFE.

The terms are from IMO MSC.1/Circ.1575. An angle is SAFE if its output is VALID and recent, its 95 % accuracy is
within the ship's limit and its protection level within the alert limit. An angle is CAUTION if its accuracy is over the
limit, but at most ``unsafe_factor`` (default 3) times the limit. An angle is also CAUTION if no protection level is
available, or if the output is COASTING or DEGRADED or uses too few lights. In all other cases the angle is UNSAFE, also
if its value or accuracy is NaN, because NaN fails every comparison.

The safety gets worse at once and better after a hold time, with hysteresis. An accuracy that was over its limit must be
below the limit by a margin for the hold time, or below the limit for several hold times.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from ship_bags.stamps import NS_PER_S
from ship_estimation.integrity.protection_levels import IntegrityState
from ship_estimation.time_order.outcome import Status
from ship_watch import value_texts
from ship_watch.suite_state import Safety, SourceState

HYSTERESIS_MARGIN = 0.1
"""Margin, as a fraction of the limit, by which an accuracy must be below its limit for the shorter hold."""

WITHIN_MARGIN_FACTOR = 6
"""Number of hold times after which an accuracy within the limit, but not within the margin, counts as better."""

BRIEF_DIP_NS = 1_000_000_000
"""Maximum time below the limit that does not end a period over the limit, ns."""

OVER_THE_LIMIT = "over the limit"
"""Reason of a CAUTION that is caused by the accuracy alone, with no faulty source."""
COUNTDOWN = "; "
"""Separator in a reason before the time until the safety gets better."""


@dataclass(frozen=True)
class AngleProtection:
    """Protection level of one angle from an Integrity message.

    Attributes:
        state: state of the whole message; None without a message, or if the last message is too old.
        level: protection level, rad; NaN if unknown.
        alert_limit: alert limit, rad; NaN if none is configured.
    """

    state: IntegrityState | None
    level: float = math.nan
    alert_limit: float = math.nan


@dataclass(frozen=True)
class AngleInputs:
    """Data of one angle at one time from which its safety is determined.

    Attributes:
        topic: topic of the output.
        is_received: True if the output was received at least once.
        is_old: True if the last output is older than the age limit.
        value: the angle, rad.
        accuracy_95: 1.96 sigma, rad.
        limit: the ship's limit of ``accuracy_95``, rad.
        unsafe_factor: ratio of accuracy to limit above which the angle is UNSAFE.
        status: status of the output; None for an unknown status number.
        diagnosis_hint: cause of a reduced quality, from the output itself: "no stars for 31 s", "no lights".
        has_reduced_input: True if the hint alone makes the angle a CAUTION, as with one of two lights.
        protection: protection level of the angle.
        faulty_source: the source that is OUT due to a fault of its own; None if there is no such source.
        overload: text of an overloaded node that this angle depends on; empty if no such node is overloaded.
    """

    topic: str
    is_received: bool
    is_old: bool
    value: float
    accuracy_95: float
    limit: float
    unsafe_factor: float
    status: Status | None
    diagnosis_hint: str
    has_reduced_input: bool
    protection: AngleProtection
    faulty_source: SourceState | None
    overload: str = ""


def safety_and_reason(inputs: AngleInputs) -> tuple[Safety, str]:
    """Return the safety of an angle and the reason why it is not SAFE; the reason is empty if it is SAFE."""
    safety, reason = _safety_and_reason(inputs)
    return safety, (inputs.overload or reason) if safety else ""


def _safety_and_reason(inputs: AngleInputs) -> tuple[Safety, str]:
    if not inputs.is_received:
        return Safety.UNSAFE, f"waiting for {inputs.topic}"
    source = inputs.faulty_source
    fault_text = value_texts.fault_text(source.name, source.reason) if source is not None else ""
    if inputs.is_old:
        return Safety.UNSAFE, fault_text or f"no data on {inputs.topic}"
    if inputs.status is None or inputs.status is Status.INVALID or not math.isfinite(inputs.value):
        return Safety.UNSAFE, fault_text or "invalid"
    if not inputs.accuracy_95 <= inputs.unsafe_factor * inputs.limit:
        over = f"over {inputs.unsafe_factor:g} × the limit"
        return Safety.UNSAFE, fault_text or over if math.isfinite(inputs.accuracy_95) else "accuracy unknown"
    state, protection = inputs.protection.state, inputs.protection
    is_within_alert_limit = protection.level <= protection.alert_limit or math.isnan(protection.alert_limit)
    if state is IntegrityState.EXCEEDED and not is_within_alert_limit:
        return Safety.UNSAFE, fault_text or "protection level over its alert limit"
    if inputs.status is not Status.VALID:
        return Safety.CAUTION, fault_text or inputs.diagnosis_hint or inputs.status.name.lower()
    if not inputs.accuracy_95 <= inputs.limit:
        return Safety.CAUTION, fault_text or OVER_THE_LIMIT
    if state is None:
        return Safety.CAUTION, "no integrity data"
    if state is IntegrityState.UNAVAILABLE or not math.isfinite(protection.level):
        return Safety.CAUTION, fault_text or inputs.diagnosis_hint or "no independent check"
    return (Safety.CAUTION, fault_text or inputs.diagnosis_hint) if inputs.has_reduced_input else (Safety.SAFE, "")


class AngleSafety(NamedTuple):
    """Safety of an angle at one time, without hold.

    Attributes:
        safety: safety of the angle.
        reason: reason why the angle is not SAFE; empty if it is SAFE.
        by_accuracy: safety from the accuracy alone.
        by_margin: safety from the accuracy alone with the limit reduced by :data:`HYSTERESIS_MARGIN`.
    """

    safety: Safety
    reason: str
    by_accuracy: Safety = Safety.SAFE
    by_margin: Safety = Safety.SAFE


def angle_safety(inputs: AngleInputs) -> AngleSafety:
    """Return the safety of an angle, with the safety from its accuracy alone."""
    return AngleSafety(
        *safety_and_reason(inputs), *safety_by_accuracy(inputs.accuracy_95, inputs.limit, inputs.unsafe_factor)
    )


def safety_by_accuracy(accuracy_95: float, limit: float, unsafe_factor: float) -> tuple[Safety, Safety]:
    """Return the safety from an accuracy alone, with the limit and with the limit reduced by the margin.

    Args:
        accuracy_95: 1.96 sigma, rad.
        limit: limit of the accuracy, rad.
        unsafe_factor: ratio of accuracy to limit above which the angle is UNSAFE.
    """
    lower = (1.0 - HYSTERESIS_MARGIN) * limit
    return _safety_within(accuracy_95, limit, unsafe_factor), _safety_within(accuracy_95, lower, unsafe_factor)


def _safety_within(accuracy_95: float, limit: float, unsafe_factor: float) -> Safety:
    """Return the safety from an accuracy alone; UNSAFE for NaN."""
    if not accuracy_95 <= unsafe_factor * limit:
        return Safety.UNSAFE
    return Safety.SAFE if accuracy_95 <= limit else Safety.CAUTION


class DisplayedSafety(NamedTuple):
    """Safety of an angle as displayed, with hold.

    Attributes:
        safety: the worst safety within the hold time.
        cause: last reason for a safety at least as bad.
        next_safety: the safety that follows if nothing changes; None if there is no hold.
        next_in_ns: time until ``next_safety``, ns.
    """

    safety: Safety
    cause: str
    next_safety: Safety | None = None
    next_in_ns: int = 0

    def reason(self, now: AngleSafety, limit: float) -> str:
        """Return the current reason, with the time until the safety gets better.

        Args:
            now: current safety of the angle, without hold.
            limit: limit of the accuracy, rad.
        """
        if self.next_safety is None:
            return now.reason
        text = f"within {value_texts.limit_text(limit)} again" if self.cause.startswith("over ") else "good again"
        return f"{now.reason or text}{COUNTDOWN}{self.next_safety.name} in {-(-self.next_in_ns // NS_PER_S)} s"


class SafetyHysteresis:
    """Hysteresis of the displayed safety of one angle: worse at once, better after a hold time.

    Args:
        hold_s: hold time, s.

    Attributes:
        safety: last displayed safety; None before the first update.
        since_ns: time of the last change of ``safety``, caller's time, ns.
    """

    def __init__(self, hold_s: float) -> None:
        self._hold_ns = round(hold_s * 1e9)
        self._holds: dict[Safety, _Hold] = {}
        self.safety: Safety | None = None
        self.since_ns = 0

    def update(self, now: AngleSafety, now_ns: int) -> bool:
        """Update with the current safety; return True if the displayed safety changed."""
        for level in (Safety.CAUTION, Safety.UNSAFE):
            hold = self._holds.get(level)
            if now.safety >= level:
                was_over = now.by_accuracy >= level or (hold is not None and hold.was_over)
                self._holds[level] = _Hold(now_ns, now_ns, was_over, now.reason)
            elif hold is not None and now_ns >= self._hold_end_ns(level, now, now_ns):
                del self._holds[level]
            elif hold is not None and now.by_margin >= level:
                self._holds[level] = hold._replace(last_near_ns=now_ns)
        displayed = self.displayed_safety(now, now_ns).safety
        changed = displayed is not self.safety
        if changed:
            self.safety, self.since_ns = displayed, now_ns
        return changed

    def displayed_safety(self, now: AngleSafety, now_ns: int) -> DisplayedSafety:
        """Return the displayed safety: the worst safety within the hold time, including the current safety."""
        for level in (Safety.UNSAFE, Safety.CAUTION):
            if now.safety >= level:
                return DisplayedSafety(now.safety, now.reason)
            end_ns = self._hold_end_ns(level, now, now_ns)
            if now_ns < end_ns:
                is_caution_next = level is Safety.UNSAFE and end_ns < self._hold_end_ns(Safety.CAUTION, now, now_ns)
                better = Safety.CAUTION if is_caution_next or now.safety >= Safety.CAUTION else Safety.SAFE
                return DisplayedSafety(level, self._holds[level].cause, better, end_ns - now_ns)
        return DisplayedSafety(Safety.SAFE, "")

    def _hold_end_ns(self, level: Safety, now: AngleSafety, now_ns: int) -> int:
        """Return the time at which the hold of a level ends if nothing changes; ``now_ns`` if there is no hold."""
        hold = self._holds.get(level)
        if hold is None:
            return now_ns
        if not hold.was_over:
            return hold.last_ns + self._hold_ns
        latest_ns = hold.last_ns + WITHIN_MARGIN_FACTOR * self._hold_ns
        return latest_ns if now.by_margin >= level else min(hold.last_near_ns + self._hold_ns, latest_ns)


class _Hold(NamedTuple):
    """Hold of one safety level.

    Attributes:
        last_ns: last time at which the safety was this bad.
        last_near_ns: last time at which the safety was this bad, or the accuracy was not within the margin.
        was_over: True if the accuracy alone was this bad during the hold.
        cause: last reason for a safety this bad.
    """

    last_ns: int
    last_near_ns: int
    was_over: bool
    cause: str


class TimeOverLimit:
    """Duration for which an accuracy has been over its limit; less than a second below the limit is ignored."""

    def __init__(self) -> None:
        self._first_ns = self._last_ns = -BRIEF_DIP_NS

    def update(self, inputs: AngleInputs, now_ns: int) -> None:
        """Update with the current accuracy and limit."""
        if not inputs.accuracy_95 <= inputs.limit:
            if now_ns - self._last_ns >= BRIEF_DIP_NS:
                self._first_ns = now_ns
            self._last_ns = now_ns

    def duration_s(self, now_ns: int) -> float:
        """Return the time from the first to the last sample over the limit, s; 0 after a second below the limit."""
        return (self._last_ns - self._first_ns) * 1e-9 if now_ns - self._last_ns < BRIEF_DIP_NS else 0.0
