"""After a fault of a theodolite's devices the pointing is VALID again, and no correct source is excluded."""

import pytest

from ship_estimation.time_order.outcome import Status
from ship_testing.pointing_faults import (
    FAULT_S,
    duplicate_encoder_readings,
    fault_free_session,
    freeze_encoders,
    offset_encoders,
    run_core,
    shift_beacon_stamps,
    shift_encoder_stamps,
    shift_telescope,
)

LASTS_S, SESSION_S = 30.0, 200.0
END_S = FAULT_S + LASTS_S
RETURNS_S = 62.0
"""Time after a fault within which the pointing must be VALID, s.

Lights must first be consistent for a minute (``integrity.return_after_s``).
"""

DEGREE_ARCSEC, TURN_ARCSEC = 3600.0, 360.0 * 3600.0

FAULTS = {
    "encoders stand": lambda run: freeze_encoders(run, END_S),
    "encoders 30 degrees off": lambda run: offset_encoders(run, 30.0 * DEGREE_ARCSEC, 0.0, END_S),
    "two readings of one stamp": lambda run: duplicate_encoder_readings(run, 20.0, END_S),
    "encoders stamped early": lambda run: shift_encoder_stamps(run, -0.1, END_S),
    "lights stamped early": lambda run: shift_beacon_stamps(run, -0.1, END_S),
    "telescope knocked by a degree": lambda run: shift_telescope(run, DEGREE_ARCSEC, 0.0, END_S),
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_that_ends_leaves_no_source_excluded(fault, seed):
    clean = fault_free_session(seed, duration_s=SESSION_S)
    found = run_core(FAULTS[fault](clean), stamps_of=clean)
    not_valid_s = found.time_s[found.status != Status.VALID]
    assert not_valid_s[-1] < END_S + RETURNS_S
    assert found.worst(Status.VALID) < 5.0
    assert not found.core.state.fault_state.excluded
    assert "ship_attitude" not in found.excluded_sources


@pytest.mark.slow
@pytest.mark.parametrize("turns", [-2, 1, 5])
def test_encoders_that_count_turns_are_taken_modulo_a_turn(turns):
    clean = fault_free_session(1)
    found = run_core(offset_encoders(clean, turns * TURN_ARCSEC, 0.0, 60.0))
    assert set(found.status[found.time_s > 5.0]) == {Status.VALID}
    assert found.worst(Status.VALID) < 4.0
