"""SAFE, CAUTION, UNSAFE: each row of the design's table; NaN fails each comparison."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.integrity.protection_levels import IntegrityState
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_watch.safety.safety import (
    AngleInputs,
    AngleProtection,
    AngleSafety,
    DisplayedSafety,
    SafetyHysteresis,
    angle_safety,
    safety_and_reason,
)
from ship_watch.suite_state import Presence, Safety, SourceState

SECOND = 1_000_000_000
EXCLUDED = SourceState("star.bow", Presence.OUT, "excluded", "reads 49″ high", 17.0, 1, "")
FLOAT = replace(EXCLUDED, name="baselines", reason="a: 81 rejected in a row: not fixed")
GOOD = AngleInputs(
    topic="ship/attitude",
    is_received=True,
    is_old=False,
    value=0.6,
    accuracy_95=4.0,
    limit=5.0,
    unsafe_factor=3.0,
    status=Status.VALID,
    diagnosis_hint="",
    has_reduced_input=False,
    protection=AngleProtection(IntegrityState.MET, 10.0, 30.0),
    faulty_source=None,
)


def test_valid_protected_angle_within_its_limit_is_safe() -> None:
    assert safety_and_reason(GOOD) == (Safety.SAFE, "")
    assert safety_and_reason(replace(GOOD, accuracy_95=5.0)) == (Safety.SAFE, "")
    assert safety_and_reason(replace(GOOD, protection=AngleProtection(IntegrityState.NO_LIMIT, 10.0))) == (
        Safety.SAFE,
        "",
    )


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"accuracy_95": 5.01}, "over the limit"),
        ({"accuracy_95": 15.0}, "over the limit"),
        ({"accuracy_95": 15.0, "faulty_source": EXCLUDED}, "star.bow excluded"),
        ({"status": Status.COASTING, "diagnosis_hint": "no stars for 31 s"}, "no stars for 31 s"),
        ({"status": Status.DEGRADED}, "degraded"),
        ({"status": Status.DEGRADED, "faulty_source": EXCLUDED}, "star.bow excluded"),
        ({"protection": AngleProtection(None)}, "no integrity data"),
        ({"protection": AngleProtection(IntegrityState.UNAVAILABLE)}, "no independent check"),
        ({"protection": AngleProtection(IntegrityState.UNAVAILABLE), "faulty_source": EXCLUDED}, "star.bow excluded"),
        ({"protection": AngleProtection(IntegrityState.MET, math.nan, 30.0)}, "no independent check"),
        ({"accuracy_95": 6.0, "faulty_source": FLOAT}, "a (baselines) rejected: not fixed"),
        ({"has_reduced_input": True, "diagnosis_hint": "one of two lights used"}, "one of two lights used"),
    ],
)
def test_cautions(change: dict[str, Any], reason: str) -> None:
    assert safety_and_reason(replace(GOOD, **change)) == (Safety.CAUTION, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"is_received": False, "is_old": True}, "waiting for ship/attitude"),
        ({"is_old": True}, "no data on ship/attitude"),
        ({"is_old": True, "faulty_source": EXCLUDED}, "star.bow excluded"),
        ({"status": Status.INVALID}, "invalid"),
        ({"status": None}, "invalid"),
        ({"value": math.nan}, "invalid"),
        ({"accuracy_95": 15.01}, "over 3 × the limit"),
        ({"accuracy_95": math.nan}, "accuracy unknown"),
        ({"accuracy_95": math.inf}, "accuracy unknown"),
        ({"limit": math.nan}, "over 3 × the limit"),
        ({"protection": AngleProtection(IntegrityState.EXCEEDED, 31.0, 30.0)}, "protection level over its alert limit"),
        (
            {"protection": AngleProtection(IntegrityState.EXCEEDED, math.nan, 30.0)},
            "protection level over its alert limit",
        ),
    ],
)
def test_other_cases_are_unsafe(change: dict[str, Any], reason: str) -> None:
    assert safety_and_reason(replace(GOOD, **change)) == (Safety.UNSAFE, reason)


def test_exceeded_level_of_another_angle_is_ignored() -> None:
    assert (
        safety_and_reason(replace(GOOD, protection=AngleProtection(IntegrityState.EXCEEDED, 29.0, 30.0)))[0]
        is Safety.SAFE
    )
    assert safety_and_reason(replace(GOOD, protection=AngleProtection(IntegrityState.EXCEEDED, 29.0)))[0] is Safety.SAFE


def over_limit(accuracy: float) -> AngleSafety:
    """Return the safety of an angle with this accuracy, limit 5 and no other fault."""
    return angle_safety(replace(GOOD, accuracy_95=accuracy))


SAFE = AngleSafety(Safety.SAFE, "")
NO_DATA = AngleSafety(Safety.CAUTION, "no data from star.bow")


def test_safety_gets_worse_at_once_and_better_after_five_seconds() -> None:
    held = SafetyHysteresis(5.0)
    assert held.update(SAFE, 0)
    assert held.update(AngleSafety(Safety.UNSAFE, "invalid"), SECOND)
    assert held.safety is Safety.UNSAFE
    assert not held.update(NO_DATA, 2 * SECOND)
    assert held.displayed_safety(NO_DATA, 2 * SECOND)[:2] == (Safety.UNSAFE, "invalid")
    assert held.update(SAFE, 6 * SECOND)  # 5 s after UNSAFE, 4 s after CAUTION
    assert (held.safety, held.since_ns) == (Safety.CAUTION, 6 * SECOND)
    assert held.displayed_safety(SAFE, 6 * SECOND)[:2] == (Safety.CAUTION, "no data from star.bow")
    assert not held.update(SAFE, 7 * SECOND - 1)
    assert held.update(SAFE, 7 * SECOND)
    assert held.displayed_safety(SAFE, 7 * SECOND) == DisplayedSafety(Safety.SAFE, "")


def test_flickering_safety_changes_once() -> None:
    held, changes = SafetyHysteresis(5.0), 0
    for i in range(100):
        changes += held.update(NO_DATA if i % 2 else SAFE, i * SECOND // 2)
    assert changes == 2  # SAFE, then CAUTION


def changes_of(accuracies: Iterable[float]) -> list[Safety | None]:
    """Return the sequence of displayed safeties for one accuracy each tenth of a second."""
    hysteresis = SafetyHysteresis(5.0)
    at_each = [
        (hysteresis.update(over_limit(accuracy), i * SECOND // 10), hysteresis.safety)
        for i, accuracy in enumerate(accuracies)
    ]
    return [safety for changed, safety in at_each if changed]


@pytest.mark.parametrize("period_s", [2.0, 12.0, 40.0])
def test_accuracy_near_its_limit_changes_the_safety_once(period_s: float) -> None:
    """The accuracy varies by ±2 % around its limit, and is within the limit for up to 20 s."""
    accuracies = 5.0 * (1.0 + 0.02 * np.sin(2.0 * np.pi * np.arange(6000) / (10.0 * period_s)))
    assert changes_of(accuracies) == [Safety.SAFE, Safety.CAUTION]


def test_accuracy_near_three_times_its_limit_changes_the_safety_once() -> None:
    accuracies = 15.0 * (1.0 + 0.02 * np.sin(np.arange(6000) / 20.0))
    assert changes_of(accuracies) == [Safety.CAUTION, Safety.UNSAFE]


def safe_after_s(*accuracies: tuple[float, float]) -> float:
    """Return the time to SAFE after an accuracy over its limit of 5, s, for pairs of start time, s, and accuracy."""
    hysteresis = SafetyHysteresis(5.0)
    hysteresis.update(over_limit(6.0), 0)
    for tenth in range(1, 1000):
        accuracy = [value for start_s, value in accuracies if tenth >= start_s * 10][-1]
        hysteresis.update(over_limit(accuracy), tenth * SECOND // 10)
        if hysteresis.safety is Safety.SAFE:
            return tenth / 10.0
    return math.inf


def test_hold_ends_after_five_seconds_below_the_margin_or_thirty_below_the_limit() -> None:
    assert safe_after_s((0.0, 4.4)) == 5.0
    assert safe_after_s((0.0, 4.9)) == 30.0
    assert safe_after_s((0.0, 4.9), (10.0, 4.4)) == pytest.approx(14.9)
    assert safe_after_s((0.0, 4.4), (3.0, 4.9), (4.0, 4.4)) == pytest.approx(8.9)
    assert safe_after_s((0.0, 5.1)) == math.inf
    assert safe_after_s((0.0, math.nan)) == math.inf


def test_margin_applies_only_to_an_accuracy_that_was_over_its_limit() -> None:
    """A source without data gives a CAUTION with a hold of 5 s, also if the accuracy is 2 % below its limit."""
    held = SafetyHysteresis(5.0)
    for tenth in range(100):
        now = over_limit(4.9)
        caution = now._replace(safety=Safety.CAUTION, reason="no data from star.bow")
        held.update(caution if tenth < 10 else now, tenth * SECOND // 10)
        assert (held.safety is Safety.SAFE) == (tenth >= 59)


def test_margin_no_longer_applies_after_the_hold() -> None:
    held = SafetyHysteresis(5.0)
    held.update(over_limit(6.0), 0)
    held.update(over_limit(4.0), 5 * SECOND)
    assert held.safety is Safety.SAFE
    held.update(over_limit(4.9), 6 * SECOND)
    assert held.safety is Safety.SAFE


@pytest.mark.parametrize(
    ("before", "now", "at_s", "word", "reason"),
    [
        (over_limit(6.0), over_limit(6.0), 1.0, Safety.CAUTION, "over the limit"),
        (over_limit(6.0), over_limit(4.0), 1.0, Safety.CAUTION, "within 5″ again; SAFE in 4 s"),
        (over_limit(6.0), over_limit(4.0), 1.5, Safety.CAUTION, "within 5″ again; SAFE in 4 s"),
        (over_limit(6.0), over_limit(4.9), 1.0, Safety.CAUTION, "within 5″ again; SAFE in 29 s"),
        (over_limit(16.0), over_limit(4.0), 1.0, Safety.UNSAFE, "within 5″ again; SAFE in 4 s"),
        (over_limit(16.0), over_limit(6.0), 1.0, Safety.UNSAFE, "over the limit; CAUTION in 4 s"),
        (over_limit(16.0), over_limit(4.9), 1.0, Safety.UNSAFE, "within 5″ again; CAUTION in 4 s"),
        (AngleSafety(Safety.UNSAFE, "invalid"), SAFE, 2.0, Safety.UNSAFE, "good again; SAFE in 3 s"),
        (AngleSafety(Safety.UNSAFE, "invalid"), NO_DATA, 2.0, Safety.UNSAFE, "no data from star.bow; CAUTION in 3 s"),
        (NO_DATA, SAFE, 4.9, Safety.CAUTION, "good again; SAFE in 1 s"),
        (NO_DATA, SAFE, 5.0, Safety.SAFE, ""),
    ],
)
def test_reason_is_the_current_one(
    before: AngleSafety, now: AngleSafety, at_s: float, word: Safety, reason: str
) -> None:
    held = SafetyHysteresis(5.0)
    held.update(before, 0)
    shown = held.displayed_safety(now, round(at_s * SECOND))
    assert (shown.safety, shown.reason(now, 5.0 * ARCSEC)) == (word, reason)
