"""Bad parameters are refused with a reason, at the start and live; accepted live changes act at once."""

import math
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_testing.adapter_runs import change_where, index_at, replace_message
from ship_testing.small_voyage import (
    FORE,
    INS,
    Run,
    config,
    fault_free_run,
    new_adapter,
    quaternion_message,
    run_adapter,
    voyage,
)

HALF = len(voyage()) // 2

REFUSED_AT_START = [
    ({"lag": 2.0}, "'lag' is unknown"),
    ({"star_sensors__fore__azimut_deg": 1.0}, "'star_sensors.fore.azimut_deg' is unknown"),
    ({"star_sensors__aft": {"azimuth_deg": 0.0}}, "'star_sensors.aft.elevation_deg'"),
    ({"lag_s": -1.0}, "'lag_s' = -1.0 s is out of its range [0.0, 600.0] s"),
    ({"lag_s": math.nan}, "'lag_s' must be finite"),
    ({"ins__white_sigma_arcsec": math.inf}, "'ins.white_sigma_arcsec' must be finite"),
    ({"ins__white_sigma_arcsec": "small"}, "must be of type float"),
    ({"gate__conflict_after": 0}, "'gate.conflict_after' = 0 is out of its range"),
    ({"gate__probability": 1.0}, "'gate.probability'"),
    ({"ins__convention": "nwu"}, "must be one of enu_flu, ned_frd"),
    ({"star_sensors": [1, 2]}, "'star_sensors' must be a group"),
]


@pytest.mark.parametrize(("changes", "text"), REFUSED_AT_START, ids=[text for _, text in REFUSED_AT_START])
def test_a_bad_configuration_does_not_start(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ParameterError) as caught:
        config(**changes)
    assert text in str(caught.value)


REFUSED_LIVE = [
    ({"gate.probabilty": 0.9}, "'gate.probabilty' is unknown"),
    ({"gate.probability": 0.1}, "out of its range"),
    ({"gate.probability": math.nan}, "must be finite"),
    ({"ins.white_sigma_arcsec": -1.0}, "out of its range"),
    ({"star_sensors.fore.sigma_up_arcsec": math.inf}, "must be finite"),
    ({"star_sensors.fore.azimuth_deg": 3.0}, "cannot be changed while the node runs"),
    ({"lag_s": 3.0}, "cannot be changed while the node runs"),
    ({"gate.conflict_after": 2.5}, "must be of type int"),
    # If one value is bad, all values of the change are refused.
    ({"ins.white_sigma_arcsec": 5.0, "gate.conflict_after": 0}, "'gate.conflict_after'"),
]


@pytest.mark.parametrize(("changes", "text"), REFUSED_LIVE, ids=[text for _, text in REFUSED_LIVE])
def test_a_bad_live_change_is_refused_and_the_node_continues(changes: dict[str, Any], text: str) -> None:
    run = run_adapter(new_adapter(), voyage()[:HALF])
    before = run.adapter.core.config
    with pytest.raises(ParameterError) as caught:
        run.adapter.set_parameters(changes)
    assert text in str(caught.value)
    assert run.adapter.core.config == before


def test_refused_changes_leave_the_attitude_to_the_bit() -> None:
    adapter = run_adapter(new_adapter(), voyage()[:HALF]).adapter
    for changes, _ in REFUSED_LIVE:
        with pytest.raises(ParameterError):
            adapter.set_parameters(changes)
    assert run_adapter(adapter, voyage()[HALF:]).state() == fault_free_run().state()


def test_setting_what_is_set_changes_nothing() -> None:
    adapter = run_adapter(new_adapter(), voyage()[:HALF]).adapter
    adapter.set_parameters({"gate.probability": 0.9999, "ins.white_sigma_arcsec": 1.0})
    assert run_adapter(adapter, voyage()[HALF:]).state() == fault_free_run().state()


def test_a_narrower_gate_acts_at_once() -> None:
    adapter = run_adapter(new_adapter(), voyage()[:HALF]).adapter
    adapter.set_parameters({"gate.probability": 0.5})
    rest = run_adapter(adapter, voyage()[HALF:])
    evaluated = [m for m in rest.messages("ship/innovation") if m.source.startswith("star")]
    # Chi-square of three degrees of freedom exceeds its median half of the time: at least 4 times in 24 draws.
    assert len(evaluated) >= 24
    assert len(rest.innovations(Reason.GATE)) >= 4
    assert {round(m.gate, 3) for m in evaluated} == {2.366}


def last_sigma(run: Run) -> np.ndarray:
    return np.sqrt(np.reshape(run.messages("ship/attitude")[-1].rotation_covariance, (3, 3)).diagonal())


def test_more_noise_of_the_ins_shows_at_once() -> None:
    adapter = run_adapter(new_adapter(), voyage()[:HALF]).adapter
    adapter.set_parameters({"ins.white_sigma_arcsec": 20.0})
    rest = run_adapter(adapter, voyage()[HALF : HALF + 2])
    assert np.all(last_sigma(rest) > np.deg2rad(20.0 / 3600.0))


def test_a_changed_sigma_applies_to_stars_without_covariance_from_then_on() -> None:
    def unknown(message: Any) -> None:
        message.rotation_covariance[:] = 0.0

    arrivals = change_where(voyage(), lambda a: a.topic == FORE, unknown)
    adapter = run_adapter(new_adapter(), arrivals[:HALF]).adapter
    adapter.set_parameters({f"star_sensors.fore.sigma_{axis}_arcsec": 3000.0 for axis in ("forward", "up", "right")})
    rest = run_adapter(adapter, arrivals[HALF:])
    sigmas = [m.sigma[1] for m in rest.messages("ship/innovation") if m.source == "star.fore"]
    assert sigmas[-1] == pytest.approx(np.deg2rad(3000.0 / 3600.0), rel=1e-3)


def test_the_wait_before_coasting_can_be_changed() -> None:
    arrivals = [a for a in voyage() if a.topic == INS or a.stamp_ns < voyage()[0].stamp_ns + 2 * 10**9]
    adapter = run_adapter(new_adapter(), arrivals[:HALF]).adapter
    adapter.set_parameters({"coasting_after_s": 10.0})
    assert {m.status for m in run_adapter(adapter, arrivals[HALF:]).messages("ship/attitude")} == {Status.VALID}
    assert run_adapter(new_adapter(), arrivals).messages("ship/attitude")[-1].status == Status.COASTING


def test_a_reset_keeps_the_live_changes() -> None:
    adapter = run_adapter(new_adapter(), voyage()[:HALF]).adapter
    adapter.set_parameters({"ins.heading_sigma_arcsec": 500.0})
    assert adapter.service("reset", voyage()[HALF].receive_ns).success
    alignment = current_alignment(adapter.core.filter, adapter.core.config, adapter.core.state)
    up = alignment.names.index("ins.up")
    assert np.sqrt(alignment.covariance[up, up]) == pytest.approx(np.deg2rad(500.0 / 3600.0))


def test_changed_ins_noise_reaches_the_ins_check() -> None:
    """One sample is off by 60″: outside the gate with the smaller noise, and within the gate with the larger one."""

    def rotate_up(message: Any) -> None:
        rotation_nd = rotation_from_quaternion(np.array([getattr(message.orientation, axis) for axis in "xyzw"]))
        message.orientation = quaternion_message(exp_rotation(np.array([0.0, 60.0, 0.0]) * ARCSEC) @ rotation_nd)

    changed = replace_message(voyage(), index_at(voyage(), INS, 4.0), rotate_up)
    for white_arcsec, reasons in ((1.0, {"gate": 1}), (20.0, {})):
        adapter = run_adapter(new_adapter(), changed[:HALF]).adapter
        adapter.set_parameters({"ins.white_sigma_arcsec": white_arcsec})
        assert run_adapter(adapter, changed[HALF:]).reasons(INS) == reasons
