"""A repeated value is stuck only if other sources show a rotation of the ship above the resolution of the value.

A value that jumps is rejected; after a few consistent rejected values the jump is accepted.
"""

import math
from typing import Any

import numpy as np
import pytest

from ship_estimation.plausibility.predictions import JumpCheck, JumpDecision, PredictionBound, PredictionStep
from ship_estimation.plausibility.stuck_check import MotionReference, StuckCheck
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, vector_length

MS = 1_000_000


def rolled_attitude(degrees: float) -> FloatArray:
    return exp_rotation(np.array([np.deg2rad(degrees), 0.0, 0.0]))


def reference_attitudes(
    time_ms: int, degrees: float, sigma_rad: float = ARCSEC, drift: float = 0.0
) -> dict[str, MotionReference]:
    return {"other": MotionReference(time_ms * MS, rolled_attitude(degrees), sigma_rad, drift)}


def check_after(values_deg: list[float], step_ms: int = 50) -> tuple[StuckCheck, int]:
    """Return a check after values that other sources confirmed, and the time of the next value, ms."""
    check = StuckCheck()
    for n, degrees in enumerate(values_deg):
        assert not check.observe(
            n * step_ms * MS, rolled_attitude(degrees), ARCSEC, reference_attitudes(n * step_ms, degrees)
        )
    return check, len(values_deg) * step_ms


MOVING = [0.05 * n for n in range(20)]


def test_value_repeated_during_a_rotation_is_stuck_after_half_a_second() -> None:
    check, start_ms = check_after(MOVING)
    held = MOVING[-1]
    times_ms = range(start_ms, start_ms + 1000, 50)
    stuck = [
        check.observe(t * MS, rolled_attitude(held), ARCSEC, reference_attitudes(t, held + 0.001 * (t - start_ms)))
        for t in times_ms
    ]
    first = times_ms[stuck.index(True)]
    assert 450 <= first - start_ms <= 600
    assert all(stuck[stuck.index(True) :])
    assert check.is_frozen(rolled_attitude(held))
    assert not check.observe(
        start_ms * MS + 1000 * MS, rolled_attitude(held + 1.0), ARCSEC, reference_attitudes(start_ms + 1000, held + 1.0)
    )
    assert not check.is_repeated


def test_value_may_be_repeated_at_rest() -> None:
    check, start_ms = check_after(MOVING)
    assert not any(
        check.observe(
            t * MS, rolled_attitude(MOVING[-1]), ARCSEC, reference_attitudes(t, MOVING[-1] + 0.2 * ARCSEC * (t % 2))
        )
        for t in range(start_ms, start_ms + 60_000, 50)
    )


def test_resolution_is_estimated_from_the_changes_of_the_value() -> None:
    """A rotation below the resolution of a tenth of a degree changes no value."""
    check, start_ms = check_after([0.1 * (n // 4) for n in range(40)])
    # A rotation about one axis changes two rows of the matrix, each by the step.
    assert check.coarseness_rad == pytest.approx(np.deg2rad(0.1), rel=1e-3)
    held = 0.9
    times_ms = range(start_ms, start_ms + 3000, 50)
    assert not any(
        check.observe(t * MS, rolled_attitude(held), ARCSEC, reference_attitudes(t, held + 0.00003 * (t - start_ms)))
        for t in times_ms
    )


def test_source_without_repeated_values_has_no_coarseness() -> None:
    assert check_after(MOVING)[0].coarseness_rad == 0.0


@pytest.mark.parametrize(("sigma_rad", "drift"), [(np.deg2rad(0.2), 0.0), (ARCSEC, np.deg2rad(1.0))])
def test_uncertain_motion_reference_is_ignored(sigma_rad: float, drift: float) -> None:
    check, start_ms = check_after(MOVING)
    times_ms = range(start_ms, start_ms + 1000, 50)
    for t in times_ms:
        references = reference_attitudes(t, MOVING[-1] + 0.0005 * (t - start_ms), sigma_rad, drift)
        assert not check.observe(t * MS, rolled_attitude(MOVING[-1]), ARCSEC, references)


def test_earlier_attitude_of_a_motion_reference_is_ignored() -> None:
    check, start_ms = check_after(MOVING)
    times_ms = range(start_ms, start_ms + 2000, 50)
    assert not any(
        check.observe(t * MS, rolled_attitude(MOVING[-1]), ARCSEC, reference_attitudes(t % 700, 0.01 * t))
        for t in times_ms
    )


def test_frozen_value_that_returns_to_the_bit_is_still_stuck() -> None:
    check, start_ms = check_after(MOVING)
    for t in range(start_ms, start_ms + 1000, 50):
        stuck = check.observe(
            t * MS, rolled_attitude(MOVING[-1]), ARCSEC, reference_attitudes(t, MOVING[-1] + 0.001 * (t - start_ms))
        )
    assert stuck
    assert not check.observe(
        (start_ms + 1000) * MS, rolled_attitude(-30.0), ARCSEC, reference_attitudes(start_ms + 1000, 3.0)
    )
    assert check.observe(
        (start_ms + 1050) * MS, rolled_attitude(MOVING[-1]), ARCSEC, reference_attitudes(start_ms + 1050, 3.0)
    )


TAKEN, REJECTED, JUMPED = JumpDecision.ACCEPTED, JumpDecision.REJECTED, JumpDecision.JUMPED
NEXT = PredictionStep(seconds=0.01, samples=1, uncertain_rad=0.0, noise_gain=2.0, coarseness_rad=0.0)


def test_consistent_rejected_values_are_accepted_after_a_number_of_samples() -> None:
    check = JumpCheck(3)
    assert [check.check(n, False, n > 0) for n in range(4)] == [REJECTED, REJECTED, REJECTED, JUMPED]
    assert check.check(4, True, True) is TAKEN


def test_inconsistent_rejected_values_are_never_accepted() -> None:
    check = JumpCheck(3)
    assert {check.check(n, False, False) for n in range(50)} == {REJECTED}


def test_value_that_continues_the_last_accepted_one_resets_the_count() -> None:
    check = JumpCheck(2)
    cases = ((False, False), (False, True), (True, False), (False, False))
    results = [check.check(n, *case) for n, case in enumerate(cases)]
    assert results == [REJECTED, REJECTED, TAKEN, REJECTED]
    assert (check.rejected_count, check.since_ns) == (1, 3)


def bound_rad(continuation: PredictionBound, step: PredictionStep) -> float:
    return continuation.match(np.zeros(3), step).bound_rad


def learned_bound(sigma_rad: float, noise_rad: float) -> PredictionBound:
    continuation, rng = PredictionBound(sigma_rad), np.random.default_rng(3)
    for _ in range(200):
        continuation.learn(noise_rad * rng.standard_normal(3))
    return continuation


def test_bound_uses_the_larger_of_configured_and_measured_noise() -> None:
    assert bound_rad(learned_bound(ARCSEC, 0.1 * ARCSEC), NEXT) == pytest.approx((7.0 * math.sqrt(2.0) + 0.6) * ARCSEC)
    assert bound_rad(learned_bound(ARCSEC, 10.0 * ARCSEC), NEXT) == pytest.approx(
        6.0 * math.sqrt(300.0) * ARCSEC, rel=0.1
    )


def test_bound_is_wide_at_the_start() -> None:
    assert bound_rad(PredictionBound(ARCSEC), NEXT) > math.radians(0.1)


@pytest.mark.parametrize("change", [{"samples": 10}, {"uncertain_rad": ARCSEC}, {"coarseness_rad": ARCSEC}])
def test_uncertain_prediction_widens_the_bound(change: dict[str, Any]) -> None:
    continuation = learned_bound(ARCSEC, ARCSEC)
    assert bound_rad(continuation, NEXT._replace(**change)) > bound_rad(continuation, NEXT)


def test_nan_is_within_no_bound() -> None:
    far = PredictionStep(seconds=10.0, samples=1, uncertain_rad=math.radians(600.0), noise_gain=2.0, coarseness_rad=0.0)
    assert not PredictionBound(ARCSEC).match(np.array([0.0, np.nan, 0.0]), far).fits
    assert PredictionBound(ARCSEC).match(np.array([3.0, 0.0, 4.0]), far).fits
    at_the_bound = np.array([0.0, bound_rad(PredictionBound(ARCSEC), far), 0.0])
    assert PredictionBound(ARCSEC).match(at_the_bound, far).fits
    assert vector_length(np.array([3.0, 0.0, 4.0])) == 5.0
