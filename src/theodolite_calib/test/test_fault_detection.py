"""Reinstatement timers restart after a gap without measurements."""

from dataclasses import replace

import pytest

from ship_estimation.fault_detection.exclusion import UnresolvedFault
from ship_geometry.earth.time_scales import SECOND_NS
from ship_testing.simulated_session import config
from theodolite_calib.filter.fault_detection import (
    AxisExclusion,
    AxisFaultDetector,
    AxisFaultState,
    initial_fault_state,
)
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.subfilters import ENCODER

SETTINGS = config()
SUBFILTERS = CalibrationFilter(SETTINGS).subfilters
DETECTOR = AxisFaultDetector(SUBFILTERS, SETTINGS.gate, SETTINGS.integrity)
FIRST, SECOND = SUBFILTERS.sources[:2]
AGREED_NS, LAST_NS = 10 * SECOND_NS, 40 * SECOND_NS


def consistent_state(received_ns: dict[str, int]) -> AxisFaultState:
    """Return a state with exclusions of FIRST and the encoders and an unresolved fault, all consistent since AGREED_NS.

    ``received_ns`` is the time of the last measurement of each beacon.
    """
    state = initial_fault_state(SUBFILTERS)
    seen_ns = state.innovation_means.last_measured_ns.copy()
    for name, time_ns in received_ns.items():
        seen_ns[SUBFILTERS.indices[name]] = time_ns
    left_out = {name: AxisExclusion(0, consistent_since_ns=AGREED_NS, reason="") for name in (FIRST, ENCODER)}
    conflict = UnresolvedFault(
        "", 0.0 * state.innovation_means.running[0, 0, :, :3], consistent_since_ns=AGREED_NS
    )
    return replace(
        state,
        innovation_means=replace(state.innovation_means, last_measured_ns=seen_ns),
        excluded=left_out,
        unresolved_fault=conflict,
    )


def consistent_since_ns(fault_state: AxisFaultState) -> list[int | None]:
    assert fault_state.unresolved_fault is not None
    exclusions = [fault_state.excluded[name] for name in (FIRST, ENCODER)]
    return [
        *(exclusion.consistent_since_ns for exclusion in exclusions),
        fault_state.unresolved_fault.consistent_since_ns,
    ]


@pytest.mark.parametrize(
    ("gap_s", "names", "expected"),
    [
        (9, (FIRST, SECOND), [AGREED_NS, AGREED_NS, AGREED_NS]),
        (11, (FIRST, SECOND), [None, LAST_NS + 11 * SECOND_NS, None]),
        (11, (SECOND,), [AGREED_NS, LAST_NS + 11 * SECOND_NS, None]),
    ],
)
def test_reinstatement_timers_restart_after_a_gap_of_all_beacons(gap_s, names, expected) -> None:
    state = consistent_state({FIRST: LAST_NS, SECOND: LAST_NS})
    assert consistent_since_ns(DETECTOR.restart_timers(state, names, LAST_NS + gap_s * SECOND_NS)) == expected


def test_gap_of_one_beacon_restarts_its_timer_only() -> None:
    state = consistent_state({FIRST: LAST_NS - 20 * SECOND_NS, SECOND: LAST_NS})
    later_ns = LAST_NS + SECOND_NS
    assert consistent_since_ns(DETECTOR.restart_timers(state, (FIRST, SECOND), later_ns)) == [
        None,
        AGREED_NS,
        AGREED_NS,
    ]


def test_encoder_is_reinstated_a_minute_after_the_gap() -> None:
    state, back_ns = consistent_state({FIRST: LAST_NS, SECOND: LAST_NS}), LAST_NS + 100 * SECOND_NS
    returned = []
    for time_ns in range(back_ns, back_ns + 62 * SECOND_NS, SECOND_NS):
        state = DETECTOR.restart_timers(state, (SECOND,), time_ns)
        measured_ns = state.innovation_means.last_measured_ns.copy()
        measured_ns[SUBFILTERS.indices[SECOND]] = time_ns
        state = replace(state, innovation_means=replace(state.innovation_means, last_measured_ns=measured_ns))
        if ENCODER in state.excluded:
            state = DETECTOR.monitor_prediction(state, ENCODER, True, time_ns)
            returned += [] if ENCODER in state.excluded else [(time_ns - back_ns) / SECOND_NS]
    assert returned == [SETTINGS.integrity.return_after_s]
