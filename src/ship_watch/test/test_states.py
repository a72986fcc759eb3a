"""SAFE, CAUTION, UNSAFE: each row of the table of the design, and that NaN fails each gate."""

import math
from dataclasses import replace
from typing import Any

import pytest

from ship_estimation.outcome import Status
from ship_estimation.protection import IntegrityState
from ship_watch.picture import Presence, Safety, SourceStanding
from ship_watch.states import AngleClaim, HeldWord, Protection, judged

SECOND = 1_000_000_000
KNOCKED = SourceStanding("star.bow", Presence.OUT, "excluded", "right +49″", 17.0, 1, "")
FLOAT = replace(KNOCKED, name="baselines", reason="a 81 refused in a row: not fixed")
GOOD = AngleClaim(
    topic="ship/attitude",
    is_heard=True,
    is_old=False,
    value=0.6,
    accuracy_95=4.0,
    limit=5.0,
    unsafe_factor=3.0,
    status=Status.VALID,
    hint="",
    is_lessened=False,
    protection=Protection(IntegrityState.MET, 10.0, 30.0),
    guilty=None,
)


def test_valid_within_its_limit_and_protected_is_safe() -> None:
    assert judged(GOOD) == (Safety.SAFE, "")
    assert judged(replace(GOOD, accuracy_95=5.0)) == (Safety.SAFE, "")
    assert judged(replace(GOOD, protection=Protection(IntegrityState.NO_LIMIT, 10.0))) == (Safety.SAFE, "")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"accuracy_95": 5.01}, "over the limit"),
        ({"accuracy_95": 15.0}, "over the limit"),
        ({"accuracy_95": 15.0, "guilty": KNOCKED}, "star.bow excluded"),
        ({"status": Status.COASTING, "hint": "no stars for 31 s"}, "no stars for 31 s"),
        ({"status": Status.DEGRADED}, "degraded"),
        ({"status": Status.DEGRADED, "guilty": KNOCKED}, "star.bow excluded"),
        ({"protection": Protection(None)}, "integrity not told"),
        ({"protection": Protection(IntegrityState.UNAVAILABLE)}, "nothing checks it"),
        ({"protection": Protection(IntegrityState.UNAVAILABLE), "guilty": KNOCKED}, "star.bow excluded"),
        ({"protection": Protection(IntegrityState.MET, math.nan, 30.0)}, "nothing checks it"),
        ({"accuracy_95": 6.0, "guilty": FLOAT}, "baselines a refused: not fixed"),
        ({"is_lessened": True, "hint": "one of two lights"}, "one of two lights"),
    ],
)
def test_what_is_a_caution(change: dict[str, Any], reason: str) -> None:
    assert judged(replace(GOOD, **change)) == (Safety.CAUTION, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"is_heard": False, "is_old": True}, "waiting for ship/attitude"),
        ({"is_old": True}, "ship/attitude silent"),
        ({"is_old": True, "guilty": KNOCKED}, "star.bow excluded"),
        ({"status": Status.INVALID}, "invalid"),
        ({"status": None}, "invalid"),
        ({"value": math.nan}, "invalid"),
        ({"accuracy_95": 15.01}, "over 3 × the limit"),
        ({"accuracy_95": math.nan}, "accuracy unknown"),
        ({"accuracy_95": math.inf}, "accuracy unknown"),
        ({"limit": math.nan}, "over 3 × the limit"),
        ({"protection": Protection(IntegrityState.EXCEEDED, 31.0, 30.0)}, "protection level over its alert limit"),
        ({"protection": Protection(IntegrityState.EXCEEDED, math.nan, 30.0)}, "protection level over its alert limit"),
    ],
)
def test_the_rest_is_unsafe(change: dict[str, Any], reason: str) -> None:
    assert judged(replace(GOOD, **change)) == (Safety.UNSAFE, reason)


def test_a_level_that_another_angle_exceeds_does_not_colour_this_one() -> None:
    assert judged(replace(GOOD, protection=Protection(IntegrityState.EXCEEDED, 29.0, 30.0)))[0] is Safety.SAFE
    assert judged(replace(GOOD, protection=Protection(IntegrityState.EXCEEDED, 29.0)))[0] is Safety.SAFE


def test_worse_at_once_and_better_after_five_seconds() -> None:
    held = HeldWord(5.0)
    assert held.note(Safety.SAFE, "", 0)
    assert held.note(Safety.UNSAFE, "invalid", SECOND)
    assert held.word is Safety.UNSAFE
    assert not held.note(Safety.CAUTION, "over the limit", 2 * SECOND)
    assert (held.word, held.reason) == (Safety.UNSAFE, "invalid")
    assert held.note(Safety.SAFE, "", 6 * SECOND)  # 5 s after it was UNSAFE, 4 s after it was a CAUTION
    assert (held.word, held.reason, held.since_ns) == (Safety.CAUTION, "over the limit", 6 * SECOND)
    assert not held.note(Safety.SAFE, "", 7 * SECOND - 1)
    assert held.note(Safety.SAFE, "", 7 * SECOND)
    assert (held.word, held.reason) == (Safety.SAFE, "")


def test_a_word_that_flickers_changes_once() -> None:
    held, changes = HeldWord(5.0), 0
    for i in range(100):
        changes += held.note(Safety.CAUTION if i % 2 else Safety.SAFE, "over the limit", i * SECOND // 2)
    assert changes == 2  # SAFE, then CAUTION
