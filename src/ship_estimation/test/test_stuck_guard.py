"""A value that stands still is stuck only where others say that the ship has turned by more than it can resolve."""

import numpy as np
import pytest

from ship_estimation.stuck_guard import StuckGuard, Witness
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation

MS = 1_000_000


def rolled(degrees: float) -> FloatArray:
    return exp_rotation(np.array([np.deg2rad(degrees), 0.0, 0.0]))


def told(time_ms: int, degrees: float, sigma_rad: float = ARCSEC, drift: float = 0.0) -> dict[str, Witness]:
    return {"other": Witness(time_ms * MS, rolled(degrees), sigma_rad, drift)}


def after(values_deg: list[float], step_ms: int = 50) -> tuple[StuckGuard, int]:
    """A guard that has seen values which others confirmed, and the time of the next."""
    guard = StuckGuard(ARCSEC)
    for n, degrees in enumerate(values_deg):
        assert not guard.observe(n * step_ms * MS, rolled(degrees), told(n * step_ms, degrees))
    return guard, len(values_deg) * step_ms


MOVING = [0.05 * n for n in range(20)]


def test_mend_03_a_value_that_stands_while_another_source_turns_is_told_after_half_a_second() -> None:
    guard, start_ms = after(MOVING)
    held = MOVING[-1]
    times_ms = range(start_ms, start_ms + 1000, 50)
    stuck = [guard.observe(t * MS, rolled(held), told(t, held + 0.001 * (t - start_ms))) for t in times_ms]
    first = times_ms[stuck.index(True)]
    assert 450 <= first - start_ms <= 600
    assert all(stuck[stuck.index(True) :])
    assert guard.is_frozen(rolled(held))
    assert not guard.observe(start_ms * MS + 1000 * MS, rolled(held + 1.0), told(start_ms + 1000, held + 1.0))
    assert not guard.stands


def test_mend_03_at_rest_a_value_may_stand_for_ever() -> None:
    guard, start_ms = after(MOVING)
    assert not any(
        guard.observe(t * MS, rolled(MOVING[-1]), told(t, MOVING[-1] + 0.2 * ARCSEC * (t % 2)))
        for t in range(start_ms, start_ms + 60_000, 50)
    )


def test_mend_03_the_resolution_is_learnt_from_the_steps_of_the_value() -> None:
    """Printed to a tenth of a degree: a turn of less than that says nothing."""
    guard, start_ms = after([0.1 * (n // 4) for n in range(40)])
    # About one axis two rows of the matrix turn, by the step each.
    assert guard.coarseness_rad == pytest.approx(np.deg2rad(0.1), rel=1e-3)
    held = 0.9
    times_ms = range(start_ms, start_ms + 3000, 50)
    assert not any(guard.observe(t * MS, rolled(held), told(t, held + 0.00003 * (t - start_ms))) for t in times_ms)


def test_mend_03_every_value_new_is_no_coarseness() -> None:
    assert after(MOVING)[0].coarseness_rad == 0.0


@pytest.mark.parametrize(("sigma_rad", "drift"), [(np.deg2rad(0.2), 0.0), (ARCSEC, np.deg2rad(1.0))])
def test_mend_03_a_witness_as_uncertain_as_its_turn_says_nothing(sigma_rad: float, drift: float) -> None:
    guard, start_ms = after(MOVING)
    times_ms = range(start_ms, start_ms + 1000, 50)
    assert not any(
        guard.observe(t * MS, rolled(MOVING[-1]), told(t, MOVING[-1] + 0.0005 * (t - start_ms), sigma_rad, drift))
        for t in times_ms
    )


def test_mend_03_what_a_witness_said_before_the_value_stood_says_nothing() -> None:
    guard, start_ms = after(MOVING)
    times_ms = range(start_ms, start_ms + 2000, 50)
    assert not any(guard.observe(t * MS, rolled(MOVING[-1]), told(t % 700, 0.01 * t)) for t in times_ms)


def test_mend_03_a_frozen_value_that_returns_to_the_bit_never_was_gone() -> None:
    guard, start_ms = after(MOVING)
    for t in range(start_ms, start_ms + 1000, 50):
        stuck = guard.observe(t * MS, rolled(MOVING[-1]), told(t, MOVING[-1] + 0.001 * (t - start_ms)))
    assert stuck
    assert not guard.observe((start_ms + 1000) * MS, rolled(-30.0), told(start_ms + 1000, 3.0))
    assert guard.observe((start_ms + 1050) * MS, rolled(MOVING[-1]), told(start_ms + 1050, 3.0))
