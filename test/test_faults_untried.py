"""Another attitude system, a star tracker, and the theodolite with one light, under faults: outputs are consistent.

Faults are those of the simulation, last from 6 s to 9 s of a voyage of 12 s, and affect every message of one topic.
"""

from typing import Any

import pytest

from ship_estimation.time_order.outcome import Status
from ship_simulation.scenario.fault import Fault
from ship_testing.adapter_runs import stamp_of
from ship_testing.every_input import error_in_sigmas, scenario, voyage_of, worst_error_in_sigmas
from theodolite_calib.samples.samples import Mode

DURATION_S, BEGIN_S, END_S = 12.0, 6.0, 9.0
SIGMAS = 5.0

OF_FORM: dict[str, dict[str, Any]] = {
    "delay": {"delay_s": 1.5},
    "conflict": {},
    "flood": {"times": 10},
    "freeze": {},
    "nan": {},
    "clock_step": {"step_s": -0.3},
}
"""Kinds of fault that apply to every topic, with their sizes."""

TURNED = {
    "reference/gyro/imu": {"bias": {"up_arcsec": 200.0, "north_arcsec": 100.0}, "axes": {"axes": "ned_frd"}},
    "star/aft/inertial_attitude": {"knock": {"up_arcsec": 50.0}, "drift": {"right_arcsec_per_min": 300.0}},
}
ONE_LIGHT = {
    "ship/attitude": {"bias": {"up_arcsec": 100.0}},
    "theodolite/encoder": {"slip": {"azimuth_arcsec": 100.0}, "angles_in_degrees": {}},
    "theodolite/beacons": {"knock": {"up_arcsec": 100.0}, "wrong_id": {}},
    "beacon/b/baseline": {"wrong_fix": {"east_m": 0.5}, "units": {}},
    "beacon/b/imu": {"bias": {"up_arcsec": 20_000.0}},
}


def cases(own: dict[str, dict[str, dict[str, Any]]]) -> list[tuple[str, str, dict[str, Any]]]:
    return [(topic, kind, sizes) for topic in own for kind, sizes in {**OF_FORM, **own[topic]}.items()]


def fault(topic: str, kind: str, sizes: dict[str, Any]) -> Fault:
    return Fault(topic=topic, kind=kind, start_s=BEGIN_S, end_s=END_S, **sizes)


@pytest.mark.slow
@pytest.mark.parametrize(("topic", "kind", "sizes"), cases(TURNED))
def test_a_reference_and_a_star_tracker_under_faults(topic: str, kind: str, sizes: dict[str, Any]) -> None:
    faults = {"one": fault(topic, kind, sizes)}
    known = voyage_of("ship_attitude", scenario("ship_attitude", duration_s=DURATION_S, faults=faults))
    run = known.run()
    assert worst_error_in_sigmas(known, run) < SIGMAS
    claimed = [message for message in run.messages("ship/attitude") if message.status != Status.INVALID]
    # After conflicting messages of the star tracker, the output remains DEGRADED for ten more seconds.
    assert claimed[-1].status == (Status.DEGRADED if kind == "conflict" and "reference" not in topic else Status.VALID)


@pytest.mark.slow
@pytest.mark.parametrize(("topic", "kind", "sizes"), cases(ONE_LIGHT))
def test_the_theodolite_with_one_light_under_faults(topic: str, kind: str, sizes: dict[str, Any]) -> None:
    """The light of drone a is hidden from the beginning."""
    hidden = Fault(topic="theodolite/beacons", kind="hide", start_s=0.0)
    faults = {"a hidden": hidden, "one": fault(topic, kind, sizes)}
    known = voyage_of("optical_axis", scenario("optical_axis", duration_s=DURATION_S, faults=faults))
    run = known.run()
    pointings = run.messages("theodolite/pointing")
    assert {message.mode for message in pointings[100:200]} == {Mode.ONE_LIGHT}
    claimed = [m for m in pointings if m.status in (Status.VALID, Status.COASTING)]
    assert not [stamp_of(message) for message in claimed if not error_in_sigmas(known, message) < SIGMAS]
