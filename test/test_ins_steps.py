"""``ship_attitude`` with a step of the INS: DEGRADED from the step until stars confirm the INS, errors fit the sigma.

Former results of the same runs are in brackets: the largest error in sigmas while VALID after the step.
"""

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_simulation.run import SimulatedRun
from ship_testing import ship_faults
from ship_testing.ship_faults import AttitudeError, turn_ins

STEP_S, END_S = 18.0, 21.0
"""Both star sensors expose at the time of the step: this exposure is compared with the INS attitude before the step."""


def voyage(rate_hz: float, **ins: float) -> SimulatedRun:
    return ship_faults.voyage(END_S, rate_hz, **ins)


def run_with_step(
    run: SimulatedRun, arcsec_n: tuple[float, float, float], until_s: float = np.inf
) -> list[AttitudeError]:
    """Return the outputs after a step of the INS about North, Up and East at STEP_S, and back at ``until_s``."""
    found = ship_faults.run_core(turn_ins(run, ARCSEC * np.array(arcsec_n), STEP_S, until_s), from_s=17.0)
    return [claim for claim in found.attitudes if claim.time_s >= STEP_S - 1e-9]


@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 200.0])
@pytest.mark.parametrize(
    "arcsec_n",
    [
        (14.0, 0.0, 0.0),  # [11.0, 11.3, 11.1 at 20, 100, 200 Hz]
        (0.0, 14.0, 0.0),  # [7.5, 7.6, 8.7]
        (0.0, 30.0, 0.0),
        (0.0, 0.0, 100.0),
        (60.0, 300.0, 60.0),
    ],
)
def test_a_step_of_fourteen_sigma_is_degraded_from_the_first_attitude_on(rate_hz, arcsec_n):
    found = run_with_step(voyage(rate_hz), arcsec_n)
    assert found[0].status is Status.DEGRADED
    assert found[0].time_s <= STEP_S + 6.0 / rate_hz
    assert max(claim.sigmas for claim in found) < 5.0
    degraded = [claim for claim in found if claim.status is Status.DEGRADED]
    assert found[: len(degraded)] == degraded
    assert degraded[-1].time_s < STEP_S + 1.0
    assert {claim.status for claim in found[len(degraded) :]} == {Status.VALID}


@pytest.mark.parametrize(("rate_hz", "arcsec"), [(50.0, 8.0), (100.0, 7.0), (200.0, 6.0)])
def test_a_smaller_step_increases_the_covariance_from_its_time_on(rate_hz, arcsec):
    """Some attitudes are VALID before the innovation means show the step; stars since the step are compared again."""
    for axis in range(3):
        found = run_with_step(voyage(rate_hz), tuple(arcsec * np.eye(3)[axis]))
        degraded_s = next(claim.time_s for claim in found if claim.status is Status.DEGRADED)
        assert degraded_s < STEP_S + 0.25
        assert max(claim.sigmas for claim in found) < 6.0
        assert max(claim.sigmas for claim in found if claim.time_s >= degraded_s) < 5.0
        assert found[-1].status is Status.VALID


def test_a_step_that_goes_back_within_some_samples_changes_nothing():
    found = run_with_step(voyage(100.0), (0.0, 100.0, 0.0), until_s=STEP_S + 0.035)
    assert {claim.status for claim in found} == {Status.VALID}
    assert found[0].time_s >= STEP_S + 0.035
    assert max(claim.sigmas for claim in found) < 5.0


def test_the_rates_noise_of_a_scenario_is_configured_in_the_estimator():
    found = run_with_step(
        voyage(100.0, rate_sigma_arcsec_per_s=60.0, rate_bias_sigma_arcsec_per_s=10.0), (0.0, 30.0, 0.0)
    )
    assert found[0].status is Status.DEGRADED
    assert max(claim.sigmas for claim in found) < 5.0
