"""Decisions in a row: when a source is OUT and IN again, and the direction in which it is off."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC
from ship_watch.sources.source_history import DecisionHistory, angle_text

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


def record_decisions(history: DecisionHistory, decisions: str, start: int = 0, period_ns: float = PERIOD) -> int:
    """Record decisions, + accepted and - rejected; return the number of the next decision."""
    for i, decision in enumerate(decisions, start):
        stamp = 100 * SECOND + i * PERIOD
        history.record(stamp, innovation(decision == "+"), stamp, period_ns)
    return start + len(decisions)


def test_out_after_five_rejections_and_in_after_ten_acceptances() -> None:
    streak = DecisionHistory(5, 10)
    n = record_decisions(streak, "+++----")
    assert not streak.is_out
    n = record_decisions(streak, "-", n)
    assert streak.is_out
    assert streak.rejected_in_a_row == 5
    assert streak.out_since_ns == 100 * SECOND + 3 * PERIOD
    n = record_decisions(streak, "-" * 76, n)
    assert streak.rejected_in_a_row == 81
    assert streak.out_since_ns == 100 * SECOND + 3 * PERIOD
    n = record_decisions(streak, "+++++++++", n)
    assert streak.is_out
    n = record_decisions(streak, "-++++++++++", n)
    assert not streak.is_out
    assert streak.rejected_in_a_row == 0


def test_occasional_rejections_keep_a_source_in() -> None:
    streak = DecisionHistory(5, 10)
    record_decisions(streak, "+---+" * 50)
    assert not streak.is_out


def test_rejected_stars_of_an_accepted_measurement_are_no_rejection() -> None:
    streak = DecisionHistory(5, 10)
    for i in range(20):
        stamp = 100 * SECOND + i * PERIOD
        for _ in range(3):
            streak.record(stamp, innovation(False, Reason.MISIDENTIFIED), stamp, PERIOD)
        assert streak.rejected_in_a_row <= 1
        streak.record(stamp, innovation(True), stamp, PERIOD)
    assert not streak.is_out
    assert streak.rejected_in_a_row == 0


def test_revised_decision_replaces_the_first() -> None:
    streak = DecisionHistory(5, 10)
    record_decisions(streak, "+----")
    revised = innovation(True)
    revised.reason = int(Reason.REVISED)
    streak.record(100 * SECOND + 3 * PERIOD, revised, 106 * SECOND, PERIOD)
    assert streak.rejected_in_a_row == 1
    record_decisions(streak, "-", 5)
    assert not streak.is_out


def test_distant_rejections_are_no_run_if_acceptances_are_not_reported() -> None:
    streak = DecisionHistory(5, 10)
    for i in range(50):  # every tenth INS sample is rejected
        stamp = 100 * SECOND + i * SECOND // 10
        streak.record(stamp, innovation(False), stamp, SECOND / 100)
    assert not streak.is_out
    assert streak.rejected_in_a_row == 1


def test_use_without_reports_reinstates_a_source() -> None:
    streak = DecisionHistory(5, 10)
    record_decisions(streak, "-----")
    last = 100 * SECOND + 4 * PERIOD
    streak.reinstate_if_used(last + 3 * SECOND, PERIOD, 9)  # only nine used
    assert streak.is_out
    streak.reinstate_if_used(last + SECOND, SECOND / 100, 100)  # enough used, but too early
    assert streak.is_out
    streak.reinstate_if_used(last + 2 * SECOND, PERIOD, 10)
    assert not streak.is_out
    assert streak.rejected_in_a_row == 0


def test_disagreement_is_the_component_furthest_off() -> None:
    streak = DecisionHistory(5, 10)
    for i in range(5):
        stamp = 100 * SECOND + i * PERIOD
        message = innovation(False, arcsec=(-2.0, 1.0, 47.0 + i), names=("forward", "up", "right"))
        streak.record(stamp, message, stamp, PERIOD)
    assert streak.disagreement.text == "reads 49″ high"
    assert streak.disagreement.sigmas == pytest.approx(49.0 / 3.0)
    # The estimate adapts to an excluded source, so the residuals are small; the reported disagreement stays.
    message = innovation(False, Reason.EXCLUDED, arcsec=(0.0, 1.0, 0.0), names=("forward", "up", "right"))
    streak.record(102 * SECOND, message, 102 * SECOND, PERIOD)
    assert streak.disagreement.text == "reads 49″ high"


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("axis", "pointer", "effect", "words"),
    [
        ("right", "forward", "up", ("high", "low")),  # the device's forward axis rises
        ("up", "forward", "right", ("to the right", "to the left")),
        ("forward", "up", "right", ("clockwise", "counterclockwise")),  # looking forward, the top moves to the right
    ],
)
def test_sense_of_a_rotation_is_that_of_the_right_hand_rule(axis, pointer, effect, words, sign) -> None:
    """The expected sense comes from scipy: where a rotation about one axis moves another axis of the device."""
    axes = dict(zip(("forward", "up", "right"), np.eye(3), strict=True))
    moved = Rotation.from_rotvec(sign * 0.1 * axes[axis]).apply(axes[pointer])
    streak = DecisionHistory(5, 10)
    streak.record(SECOND, innovation(False, arcsec=(sign * 49.0,), names=(axis,)), SECOND, PERIOD)
    assert streak.disagreement.text == f"reads 49″ {words[0] if moved @ axes[effect] > 0.0 else words[1]}"


@pytest.mark.parametrize(
    ("axis", "arcsec", "sense"),
    [
        # The image is inverted: a light with x > 0 is to the left, a light with z > 0 is low (BeaconSighting.msg).
        ("x", 30.0, "to the left"), ("x", -30.0, "to the right"), ("z", 30.0, "low"), ("z", -30.0, "high"),
        ("up", 30.0, "high"), ("up", -30.0, "low"), ("right", 30.0, "to the right"), ("right", -30.0, "to the left"),
    ],
)  # fmt: skip
def test_sense_of_a_light_or_star_is_that_on_the_sky(axis: str, arcsec: float, sense: str) -> None:
    streak = DecisionHistory(5, 10)
    streak.record(SECOND, innovation(False, arcsec=(arcsec,), names=(f"a {axis}",)), SECOND, PERIOD)
    assert streak.disagreement.text == f"a reads 30″ {sense}"


def test_equal_residuals_of_all_stars_are_a_rotation_of_the_sensor() -> None:
    streak = DecisionHistory(5, 10)
    names = [f"HIP {n} {axis}" for n in (1, 2, 3) for axis in ("up", "right")]
    streak.record(SECOND, innovation(False, arcsec=(20.0, 1.0, 21.0, -1.0, 22.0, 0.0), names=names), SECOND, PERIOD)
    assert streak.disagreement.text == "stars read 21″ high"


def test_single_wrong_star_is_named() -> None:
    streak = DecisionHistory(5, 10)
    names = [f"HIP {n} {axis}" for n in (1, 2, 3, 4, 5) for axis in ("up", "right")]
    streak.record(SECOND, innovation(False, arcsec=(0.0, 0.0, 0.0, -90.0) + (0.0,) * 6, names=names), SECOND, PERIOD)
    assert streak.disagreement.text == "HIP 2 reads 90″ to the left"


def test_angle_texts() -> None:
    assert [angle_text(value * ARCSEC) for value in (48.6, -120.0, 7200.0)] == ["49″", "120″", "2.0°"]


def test_source_is_in_again_after_stamps_from_the_future() -> None:
    streak = DecisionHistory(5, 10)
    n = record_decisions(streak, "+" * 10)
    for i in range(n, n + 10):
        message = innovation(False, Reason.FUTURE)
        streak.record((3700 + i) * SECOND, message, 100 * SECOND + i * PERIOD, PERIOD)
    assert streak.is_out
    record_decisions(streak, "+" * 10, n + 10)
    assert not streak.is_out


def test_decisions_are_counted_in_the_order_of_arrival() -> None:
    streak = DecisionHistory(5, 10)
    record_decisions(streak, "+", -1)
    for i in (0, 2, 1, 4, 3, 6, 5):
        stamp = 100 * SECOND + i * PERIOD
        streak.record(stamp, innovation(False), stamp, PERIOD)
    assert streak.rejected_in_a_row == 7
    assert streak.is_out
