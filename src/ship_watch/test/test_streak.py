"""Refused in a row: when a source is out, when it is in again, and in which direction it is off."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ship_estimation.refusals import Reason
from ship_geometry.rotations import ARCSEC
from ship_watch.streak import Streak, angle_text

SECOND = 1_000_000_000
PERIOD = SECOND // 5


def innovation(accepted: bool, reason: Reason = Reason.GATE, arcsec: Any = (), names: Any = ()) -> SimpleNamespace:
    return SimpleNamespace(
        accepted=accepted,
        reason=int(Reason.NONE if accepted else reason),
        components=list(names),
        residual=np.array(arcsec) * ARCSEC,
        sigma=np.full(len(arcsec), 3.0 * ARCSEC),
        nis=math.nan if not len(arcsec) else float(np.sum((np.array(arcsec) / 3.0) ** 2)),
        gate=21.1 if len(arcsec) else math.nan,
    )


def run(streak: Streak, verdicts: str, start: int = 0, period_ns: float = PERIOD) -> int:
    """Give a streak its verdicts: + accepted, - refused; the answer is the number of the next."""
    for i, verdict in enumerate(verdicts, start):
        stamp = 100 * SECOND + i * PERIOD
        streak.note(stamp, innovation(verdict == "+"), stamp, period_ns)
    return start + len(verdicts)


def test_five_refused_in_a_row_are_out_and_ten_accepted_are_in() -> None:
    streak = Streak(5, 10)
    n = run(streak, "+++----")
    assert not streak.is_out
    n = run(streak, "-", n)
    assert streak.is_out
    assert streak.refused == 5
    assert streak.out_since_ns == 100 * SECOND + 3 * PERIOD
    n = run(streak, "-" * 76, n)
    assert streak.refused == 81
    assert streak.out_since_ns == 100 * SECOND + 3 * PERIOD
    n = run(streak, "+++++++++", n)
    assert streak.is_out
    n = run(streak, "-++++++++++", n)
    assert not streak.is_out
    assert streak.refused == 0


def test_refused_now_and_then_is_in() -> None:
    streak = Streak(5, 10)
    run(streak, "+---+" * 50)
    assert not streak.is_out


def test_parts_of_a_measurement_that_was_used_are_no_refusal_of_it() -> None:
    streak = Streak(5, 10)
    for i in range(20):
        stamp = 100 * SECOND + i * PERIOD
        for _ in range(3):
            streak.note(stamp, innovation(False, Reason.MISIDENTIFIED), stamp, PERIOD)
        assert streak.refused <= 1
        streak.note(stamp, innovation(True), stamp, PERIOD)
    assert not streak.is_out
    assert streak.refused == 0


def test_revised_verdicts_count_in_the_place_of_the_first() -> None:
    streak = Streak(5, 10)
    run(streak, "+----")
    revised = innovation(True)
    revised.reason = int(Reason.REVISED)
    streak.note(100 * SECOND + 3 * PERIOD, revised, 106 * SECOND, PERIOD)
    assert streak.refused == 1
    run(streak, "-", 5)
    assert not streak.is_out


def test_of_a_source_whose_use_is_not_told_refusals_far_apart_are_not_in_a_row() -> None:
    streak = Streak(5, 10)
    for i in range(50):  # one sample of the INS in ten
        stamp = 100 * SECOND + i * SECOND // 10
        streak.note(stamp, innovation(False), stamp, SECOND / 100)
    assert not streak.is_out
    assert streak.refused == 1


def test_a_source_whose_use_is_not_told_comes_in_when_it_was_used_for_a_while() -> None:
    streak = Streak(5, 10)
    run(streak, "-----")
    last = 100 * SECOND + 4 * PERIOD
    streak.used_silently(last + 3 * SECOND, PERIOD, 9)  # nine used, and time enough
    assert streak.is_out
    streak.used_silently(last + SECOND, SECOND / 100, 100)  # a hundred used, and too early for people to see
    assert streak.is_out
    streak.used_silently(last + 2 * SECOND, PERIOD, 10)
    assert not streak.is_out
    assert streak.refused == 0


def test_how_a_device_is_off_is_told_by_the_component_that_is_furthest_off() -> None:
    streak = Streak(5, 10)
    for i in range(5):
        stamp = 100 * SECOND + i * PERIOD
        told = innovation(False, arcsec=(-2.0, 1.0, 47.0 + i), names=("forward", "up", "right"))
        streak.note(stamp, told, stamp, PERIOD)
    assert streak.disagreement.text == "right +49″"
    assert streak.disagreement.sigmas == pytest.approx(49.0 / 3.0)
    # Excluded and learnt anew it agrees; how it was off stays until it is in again.
    told = innovation(False, Reason.EXCLUDED, arcsec=(0.0, 1.0, 0.0), names=("forward", "up", "right"))
    streak.note(102 * SECOND, told, 102 * SECOND, PERIOD)
    assert streak.disagreement.text == "right +49″"


def test_stars_that_are_all_off_alike_are_one_turn_of_the_sensor() -> None:
    streak = Streak(5, 10)
    names = [f"HIP {n} {axis}" for n in (1, 2, 3) for axis in ("up", "right")]
    streak.note(SECOND, innovation(False, arcsec=(20.0, 1.0, 21.0, -1.0, 22.0, 0.0), names=names), SECOND, PERIOD)
    assert streak.disagreement.text == "up +21″"


def test_one_star_that_is_off_is_named() -> None:
    streak = Streak(5, 10)
    names = [f"HIP {n} {axis}" for n in (1, 2, 3, 4, 5) for axis in ("up", "right")]
    streak.note(SECOND, innovation(False, arcsec=(0.0, 0.0, 0.0, -90.0) + (0.0,) * 6, names=names), SECOND, PERIOD)
    assert streak.disagreement.text == "HIP 2 right −90″"


def test_angles_for_people() -> None:
    assert [angle_text(value * ARCSEC) for value in (48.6, -120.0, 7200.0)] == ["+49″", "−120″", "+2.0°"]


def test_stamps_from_the_future_do_not_keep_a_source_out_when_its_clock_is_right_again() -> None:
    streak = Streak(5, 10)
    n = run(streak, "+" * 10)
    for i in range(n, n + 10):
        told = innovation(False, Reason.FUTURE)
        streak.note((3700 + i) * SECOND, told, 100 * SECOND + i * PERIOD, PERIOD)
    assert streak.is_out
    run(streak, "+" * 10, n + 10)
    assert not streak.is_out


def test_what_arrives_out_of_order_is_counted_as_it_comes() -> None:
    streak = Streak(5, 10)
    run(streak, "+", -1)
    for i in (0, 2, 1, 4, 3, 6, 5):
        stamp = 100 * SECOND + i * PERIOD
        streak.note(stamp, innovation(False), stamp, PERIOD)
    assert streak.refused == 7
    assert streak.is_out
