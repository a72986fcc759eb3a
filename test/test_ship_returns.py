"""After a fault of INS or stars the ship's attitude is VALID again, and was never VALID far beyond its sigma.

Former results of the same runs are in brackets: the time from the fault's end to a VALID attitude; "never" is 300 s.
"""

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_testing.every_case import check_every_case
from ship_testing.ship_faults import (
    AttitudeErrors,
    delay_ins_stamps,
    round_ins,
    run_core,
    turn_ins,
    turn_stars,
    up,
    voyage,
)

FROM_S, RATE_HZ = 15.0, 20.0
RETURNS_S = 75.0
"""Time after a fault within which the attitude must be VALID, s.

An excluded source must first be consistent for a minute (``integrity.return_after_s``).
"""


def assert_returned(found: AttitudeErrors, end_s: float) -> None:
    assert found.not_valid_until_s < end_s + RETURNS_S
    assert not found.core.state.excluded
    assert found.worst_in_sigmas() < 5.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arcsec", "lasts_s"),
    [
        (300.0, 30.0),  # [never]
        (3600.0, 30.0),  # [never]
        (3600.0, 20.0),  # [never]
        (3600.0, 10.0),
        (120.0, 60.0),
        (60.0, 30.0),
    ],
)
def test_all_stars_turned_about_up_for_a_while(arcsec, lasts_s):
    end_s = FROM_S + lasts_s
    found = run_core(turn_stars(voyage(end_s + 80.0, RATE_HZ), up(arcsec), FROM_S, end_s))
    assert found.statuses(FROM_S + 2.0, end_s) == {Status.DEGRADED}
    assert_returned(found, end_s)


def test_the_cables_of_two_star_sensors_exchanged_for_a_while():
    end_s = FROM_S + 30.0
    found = run_core(voyage(end_s + 80.0, RATE_HZ), exchanged_s=(FROM_S, end_s))
    assert found.statuses(FROM_S + 2.0, end_s) == {Status.DEGRADED}
    assert_returned(found, end_s)


@pytest.mark.slow
def test_an_ins_whose_heading_flips_by_about_half_a_turn_and_back():
    """Before, for 3 of 6 durations: DEGRADED with an error of 648 000" and a sigma as large, or VALID with NEES 54."""
    run = voyage(FROM_S + 12.0, RATE_HZ)

    def check(degrees: float, lasts_s: float) -> None:
        end_s = FROM_S + lasts_s
        found = run_core(turn_ins(run, up(3600.0 * degrees), FROM_S, end_s))
        assert found.worst_in_sigmas() < 5.0
        assert found.statuses(end_s + 2.0) == {Status.VALID}

    degrees = np.linspace(179.9, 180.1, 21)
    check_every_case(
        ((size, lasts_s) for size in degrees.round(2).tolist() for lasts_s in (1.3, 2.7, 4.0, 4.35, 5.1, 6.7)), check
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("from_s", [0.0, 12.3, 15.0, 16.7, 18.1])
@pytest.mark.parametrize("most_ms", [4.0, 12.0])
def test_stamps_of_an_ins_that_are_late_at_random(most_ms, from_s, seed):
    """Delays last 60 s, from the start or later.

    [0 to 12 ms from the start: VALID 4 s with NEES 65, then never again]
    """
    end_s = from_s + 60.0
    found = run_core(delay_ins_stamps(voyage(end_s + 20.0, RATE_HZ, seed), 1e-3 * most_ms, from_s, end_s, seed))
    assert found.worst_in_sigmas(from_s + 2.5) < 5.0
    assert found.statuses(from_s + 4.0) == {Status.VALID}
    assert found.core.ins.ins_check.comparison.excess_text == ""


@pytest.mark.slow
@pytest.mark.parametrize("from_s", [0.0, 12.3, 15.0])
def test_quaternions_of_an_ins_with_four_decimals(from_s):
    """[From the start: VALID 3 s with 14 sigma, then never again]"""
    end_s = from_s + 60.0
    found = run_core(round_ins(voyage(end_s + 20.0, RATE_HZ), 4, from_s, end_s))
    assert found.worst_in_sigmas(from_s + 2.5) < 5.0
    assert found.statuses(from_s + 4.0) == {Status.VALID}
    assert found.core.ins.ins_check.comparison.excess_text == ""


def test_more_noise_than_stated_is_named_with_its_kind_and_size():
    run = voyage(40.0, RATE_HZ)
    jitter = run_core(delay_ins_stamps(run, 0.012, FROM_S), from_s=39.0).core.ins.ins_check.comparison.excess_text
    coarse = run_core(round_ins(run, 4, FROM_S), from_s=39.0).core.ins.ins_check.comparison.excess_text
    # The jitter is uniform from 0 to 12 ms. A step of 1e-4 in a component of a quaternion rotates by 2e-4 rad; the
    # rounding error is uniform over one step.
    assert 12.0 / 12.0**0.5 * 0.8 < float(jitter.split("jitter by ")[1].split(" ms")[0]) < 12.0 / 12.0**0.5 * 1.25
    assert 41.3 / 12.0**0.5 * 0.8 < float(coarse.split("noise is ")[1].split("″")[0]) < 41.3 / 12.0**0.5 * 1.3
    assert "stated 1.0″" in jitter
    assert "stated 1.0″" in coarse
    assert run_core(run, from_s=39.0).core.ins.ins_check.comparison.excess_text == ""
