"""``optical_axis`` at a common step of all clocks aboard: the calibration is kept, and the pointing continues."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, changed_copy, hand_over, stamp_of
from ship_testing.small_session import ENCODER, Run, new_adapter, run_adapter, session
from theodolite_calib.optical_axis.calibration import calibration_from_state

AT_S, DURATION_S = 10.0, 20.0


def step_clocks(step_s: float, *topics: str) -> tuple[Arrival, ...]:
    """Return the session with a clock step from AT_S on in the stamps of these topics; of all topics if none is
    given."""

    def change(message: Any) -> None:
        ns = stamp_of(message) + round(step_s * SECOND_NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, SECOND_NS)

    since_ns = START_NS + round(AT_S * SECOND_NS)
    return tuple(
        changed_copy(a, change) if a.stamp_ns >= since_ns and (not topics or a.topic in topics) else a
        for a in session(DURATION_S)
    )


def run_session(step_s: float, *topics: str, node_follows: bool = True) -> Run:
    run, since_ns = Run(new_adapter()), START_NS + round(AT_S * SECOND_NS)
    off_ns = round(step_s * SECOND_NS) if node_follows else 0
    hand_over(run, step_clocks(step_s, *topics), node_ns=lambda ns: ns + (off_ns if ns >= since_ns else 0))
    return run


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-900.0, -300.0, -1.0, 900.0])
def test_all_clocks_step_and_the_pointing_is_valid_within_two_seconds(step_s: float) -> None:
    run, calm = run_session(step_s), run_adapter(new_adapter(), session(DURATION_S))
    since_ns = START_NS + round(AT_S * SECOND_NS)
    after = [m for ns, topic, m in run.published if topic == "theodolite/pointing" and ns >= since_ns + 2 * SECOND_NS]
    assert {m.status for m in after} == {Status.VALID}
    assert all(stamp_of(one) < stamp_of(other) for one, other in pairwise(after))
    assert stamp_of(after[-1]) == stamp_of(calm.pointings[-1]) + round(step_s * SECOND_NS)
    cores = run.adapter.core, calm.adapter.core
    one, other = (calibration_from_state(core.filter, core.config, core.state) for core in cores)
    assert one.names == other.names
    sigma = np.sqrt(np.diagonal(other.covariance))
    assert np.all(np.abs(one.values - other.values) < sigma)
    assert np.sqrt(np.diagonal(one.covariance)) == pytest.approx(sigma, rel=0.2)
    # The sighting count continues.
    assert one.sighting_count >= other.sighting_count - 3
    assert [text for text in run.adapter.notices if text.startswith("time base stepped")] == [
        f"time base stepped by {step_s:+.3f} s: reset, mountings and calibration kept"
    ]


@pytest.mark.slow
def test_the_encoders_clock_alone_is_no_step_of_the_time_base() -> None:
    run = run_session(-300.0, ENCODER, node_follows=False)
    assert not run.adapter.time_base.steps
    assert run.reasons(ENCODER)["late"] > 100
