"""How far a value may be from where the one before leads, and after how many refusals a jump is believed."""

import math
from typing import Any

import numpy as np
import pytest

from ship_estimation.jump_guard import Continuation, JumpGuard, JumpVerdict, Step, far_bound_rad, size, within
from ship_geometry.rotations import ARCSEC

TAKEN, REFUSED, JUMPED = JumpVerdict.TAKEN, JumpVerdict.REFUSED, JumpVerdict.JUMPED
NEXT = Step(seconds=0.01, samples=1, uncertain_rad=0.0, noise_gain=2.0, coarseness_rad=0.0)


def test_mend_10_refused_ones_that_agree_are_believed_after_so_many() -> None:
    guard = JumpGuard(3)
    assert [guard.judge(False, n > 0) for n in range(4)] == [REFUSED, REFUSED, REFUSED, JUMPED]
    assert guard.judge(True, True) is TAKEN


def test_mend_10_refused_ones_that_differ_among_themselves_are_never_believed() -> None:
    guard = JumpGuard(3)
    assert {guard.judge(False, False) for _ in range(50)} == {REFUSED}


def test_mend_10_one_that_continues_the_last_taken_ends_the_count() -> None:
    guard = JumpGuard(2)
    judged = [guard.judge(*case) for case in ((False, False), (False, True), (True, False), (False, False))]
    assert judged == [REFUSED, REFUSED, TAKEN, REFUSED]
    assert guard.refused == 1


def learnt(sigma_rad: float, noise_rad: float) -> Continuation:
    continuation, rng = Continuation(sigma_rad), np.random.default_rng(3)
    for _ in range(200):
        continuation.learn(noise_rad * rng.standard_normal(3))
    return continuation


def test_mend_10_the_bound_is_the_configured_noise_or_what_was_met() -> None:
    assert learnt(ARCSEC, 0.1 * ARCSEC).bound_rad(NEXT) == pytest.approx((7.0 * math.sqrt(2.0) + 0.6) * ARCSEC)
    assert learnt(ARCSEC, 10.0 * ARCSEC).bound_rad(NEXT) == pytest.approx(6.0 * math.sqrt(300.0) * ARCSEC, rel=0.1)


def test_mend_10_before_enough_was_met_the_bound_is_wide() -> None:
    assert Continuation(ARCSEC).bound_rad(NEXT) > math.radians(0.1)


@pytest.mark.parametrize("change", [{"samples": 10}, {"uncertain_rad": ARCSEC}, {"coarseness_rad": ARCSEC}])
def test_mend_10_what_is_known_less_of_the_way_widens_the_bound(change: dict[str, Any]) -> None:
    continuation = learnt(ARCSEC, ARCSEC)
    assert continuation.bound_rad(NEXT._replace(**change)) > continuation.bound_rad(NEXT)


def test_mend_08_nan_is_within_no_bound() -> None:
    assert not within(np.array([0.0, np.nan, 0.0]), far_bound_rad(10.0))
    assert within(np.array([3.0, 0.0, 4.0]), 5.0)
    assert size(np.array([3.0, 0.0, 4.0])) == 5.0
