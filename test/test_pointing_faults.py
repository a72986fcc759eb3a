"""Devices of the theodolite that lie: never VALID with an error far beyond the covariance, and back when they agree.

Before, in brackets: the worst error in sigmas while VALID, measured with the same sessions.
"""

import pytest

from ship_estimation.outcome import Status
from ship_testing.pointing_faults import FAULT_S, claims, clean_session, ship_turned

SEEDS = (1, 2)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("arcsec_n", "until_s"),
    [
        ((0.0, 30.0, 0.0), 1e9),  # 6.9
        ((0.0, 50.0, 0.0), 1e9),  # 10.5
        ((0.0, 100.0, 0.0), 1e9),  # 20.7, then DEGRADED at 19 to the end
        ((0.0, 300.0, 0.0), 1e9),  # 61.3
        ((100.0, 0.0, 0.0), 1e9),  # 27.6
        ((0.0, 100.0, 0.0), 70.0),  # 20.7
    ],
)
def test_mend_11_a_ship_attitude_that_steps_is_seen_by_its_own_rates(seed, arcsec_n, until_s):
    """At 20 Hz with white noise of 1" its rates tell steps of 20" and more at the sample."""
    found = claims(ship_turned(clean_session(seed), arcsec_n, until_s))
    assert found.worst(Status.VALID) < 4.0
    assert found.worst(Status.DEGRADED) < 4.0
    # DEGRADED until lights agree: a step a time, the pointing goes on.
    assert 0.1 < found.seconds(Status.DEGRADED) < 2.0
    assert found.status[-1] == Status.VALID


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_refused_where_nothing_lies(seed):
    found = claims(clean_session(seed))
    assert found.refused == 0
    assert set(found.status[found.time_s > 5.0]) == {Status.VALID}
    assert found.worst(Status.VALID, from_s=0.0) < 4.0
    assert found.time_s[-1] > FAULT_S
