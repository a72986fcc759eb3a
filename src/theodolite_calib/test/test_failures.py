"""Software failures on one message: they are reported, and all other outputs are unchanged."""

from collections.abc import Callable
from typing import Any

import pytest

from ship_estimation.rejection_rules import Reason
from ship_testing.adapter_runs import AdapterRun, index_at, stamp_of, without
from ship_testing.small_session import BEACONS, ENCODER, fault_free_run, new_adapter, run_adapter, session
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.output import PointingOutput

FAILURE_S = 2.6


def failing_where(bad: Callable[..., bool], function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that raises if ``bad`` is true for the arguments, and otherwise calls the given function."""

    def call(*arguments: Any) -> Any:
        if bad(*arguments):
            raise ArithmeticError("a defect")
        return function(*arguments)

    return call


def assert_reported(run: AdapterRun, source: str, time_ns: int) -> None:
    (innovation,) = run.innovations(Reason.FAILED)
    assert (innovation.source, stamp_of(innovation), innovation.accepted) == (source, time_ns, False)
    assert innovation.reason_text.startswith("ArithmeticError: a defect (")
    (text,) = run.adapter.health.take_failures()
    assert text.endswith(innovation.reason_text)


def test_exposure_on_which_the_filter_raises_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    index = index_at(session(), BEACONS, FAILURE_S)
    bad_ns = session()[index].stamp_ns
    with monkeypatch.context() as patch:
        bad = failing_where(lambda _, state, sighting, *rest: sighting.time_ns == bad_ns, SightingStep.__call__)
        patch.setattr(SightingStep, "__call__", bad)
        run = run_adapter(new_adapter(), session())
    expected = run_adapter(new_adapter(), without(session(), index))
    assert run.results() == expected.results()
    assert run.state() == expected.state()
    assert run.reasons(BEACONS) == {"failed": 1}
    assert_reported(run, "lights", bad_ns)


def test_failed_pointing_is_the_only_one_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    clean, bad_ns = fault_free_run(), session()[index_at(session(), ENCODER, FAILURE_S)].stamp_ns
    bad = failing_where(
        lambda _, readings: bad_ns in [reading.sample.time_ns for reading in readings], PointingOutput.series
    )
    monkeypatch.setattr(PointingOutput, "series", bad)
    run = run_adapter(new_adapter(), session())
    expected = [stamp_of(m) for m in clean.pointings if stamp_of(m) != bad_ns]
    assert [stamp_of(m) for m in run.pointings] == expected
    assert run.state() == clean.state()
    assert_reported(run, "theodolite/pointing", bad_ns)


def test_exact_values_pass_the_gate_as_others() -> None:
    """All sigmas are 0: axes, deformation, ship's attitude, air, antenna, encoders and focal length.

    Sightings are at most gated or in conflict, and no pointing is missing.
    """
    zero = [f"axes__{name}_sigma_arcsec" for name in ("g", "h", "c", "I", "beta_x", "beta_y")]
    zero += ["deformation__sigma_arcsec", "ship__white_sigma_arcsec", "air__sigma", "air__light_sigma"]
    zero += ["ship_antenna__sigma_m", "encoder__sigma_arcsec", "telescope__focal_length_sigma_m"]
    run = run_adapter(new_adapter(**dict.fromkeys(zero, 0.0)), session())
    assert set(run.reasons(BEACONS)) <= {"gate", "attitude_conflict", "light_conflict"}
    assert len(run.pointings) == len(fault_free_run().pointings)
