"""Published integrity of the pointing: levels, limits, exclusions, and invalid configurations."""

from typing import Any

import numpy as np
import pytest

from ship_estimation.parameters.schema import ParameterError
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_msgs.msg import Integrity
from ship_testing.adapter_runs import SECOND_NS, START_NS, change_where, delay_arrivals
from ship_testing.published_levels import ProtectionLevelRun
from ship_testing.small_session import (
    BASELINE,
    BEACONS,
    SHIP,
    config,
    fault_free_run,
    new_adapter,
    run_adapter,
    session,
    stamp_of,
)

TOPIC = "theodolite/integrity"


def seconds(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def test_levels_go_out_once_a_second_and_name_their_hypotheses() -> None:
    run = fault_free_run()
    reports = run.messages(TOPIC)
    assert 5 <= len(reports) <= 8
    assert {m.header.frame_id for m in reports} == {"theodolite_main"}
    last = reports[-1]
    assert last.quantities == ["azimuth_cos_elevation", "elevation", "image_rotation"]
    assert last.hypotheses == ["beacon.alpha", "beacon.bravo", "encoder", "ship_attitude"]
    assert (last.state, last.excluded) == (Integrity.NO_LIMIT, [])
    assert np.all(np.isnan(last.alert_limit))
    assert np.all(np.array(last.protection_level) / ARCSEC > 5.0)
    assert np.all(np.array(last.statistic) < last.threshold)
    assert last.dominant in last.hypotheses


def test_integrity_is_unavailable_without_beacons() -> None:
    dark = tuple(a for a in session(10.0) if a.topic != BEACONS or (a.stamp_ns - START_NS) < 3 * SECOND_NS)
    run = run_adapter(new_adapter(), dark)
    last = run.messages(TOPIC)[-1]
    assert last.state == Integrity.UNAVAILABLE
    assert np.all(np.isnan(last.protection_level))


def test_exclusion_is_published_at_once_and_in_diagnostics() -> None:
    def move_up(message: Any) -> None:
        message.enu.z += 3.0

    wrong = change_where(
        session(10.0), lambda a: a.topic == BASELINE["alpha"] and a.stamp_ns - START_NS > 5 * SECOND_NS, move_up
    )
    run = run_adapter(new_adapter(), wrong)
    reports = [m for m in run.messages(TOPIC) if m.excluded]
    assert reports[0].excluded == ["beacon.alpha"]
    assert 4.8 < seconds(reports[0]) < 6.5
    assert reports[-1].excluded_for_s[0] == pytest.approx(seconds(reports[-1]) - seconds(reports[0]), abs=0.6)
    assert reports[-1].hypotheses == ["beacon.bravo", "encoder", "ship_attitude"]
    assert run.pointings[-1].status == Status.VALID
    since_ns = START_NS + 9 * SECOND_NS
    assert any("beacon.alpha" in text for _, text in run.diagnostics("integrity", since_ns, since_ns + 2 * SECOND_NS))


def frozen_ship() -> Any:
    """Return a session in which the ship's attitude is frozen for four seconds while she rolls."""
    frozen: list[Any] = []

    def freeze(message: Any) -> None:
        frozen.append(message)
        for name in ("orientation", "angular_velocity"):
            setattr(message, name, getattr(frozen[0], name))

    return change_where(session(12.0), lambda a: a.topic == SHIP and 4.0 <= seconds(a.message) < 8.0, freeze)


def lost_lights() -> Any:
    return tuple(a for a in session(12.0) if a.topic != BEACONS or not 4.0 <= seconds(a.message) < 8.0)


@pytest.mark.parametrize("arrivals", [frozen_ship(), lost_lights()], ids=["ship frozen", "no lights"])
def test_published_levels_cover_each_output(arrivals: Any) -> None:
    run = ProtectionLevelRun(new_adapter(), arrivals)
    assert len(run.published_and_own_levels()) > 100
    assert run.exceedances() == []


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"integrity__max_hypotheses": 4}, "integrity.max_hypotheses"),
        ({"integrity__alert_limit_arcsec": [0.0, 10.0, 10.0]}, "integrity.alert_limit_arcsec"),
        ({"integrity__alert_limit_arcsec": [-1.0, 10.0, 10.0]}, "integrity.alert_limit_arcsec"),
        ({"integrity__alert_limit_arcsec": [10.0]}, "integrity.alert_limit_arcsec"),
        ({"integrity__prior_per_h": {"encoder": 0.0}}, "integrity.prior_per_h.encoder"),
    ],
)
def test_impossible_configuration_is_refused_by_name(changes: dict[str, Any], name: str) -> None:
    with pytest.raises(ParameterError) as refused:
        config(**changes)
    assert name in str(refused.value)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_exclusion_does_not_depend_on_the_order_of_arrival(seed: int) -> None:
    """A baseline jumps by 3 m; messages of beacons and baselines are up to two seconds late."""

    def move_up(message: Any) -> None:
        message.enu.z += 3.0

    wrong = change_where(
        session(), lambda a: a.topic == BASELINE["alpha"] and a.stamp_ns - START_NS > 3 * SECOND_NS, move_up
    )
    rng = np.random.default_rng(seed)
    late = np.array([a.topic in (BEACONS, *BASELINE.values()) for a in wrong])
    shuffled = delay_arrivals(wrong, np.where(late, rng.uniform(0.0, 1.9, late.size), 0.005))
    in_order, out_of_order = run_adapter(new_adapter(), wrong), run_adapter(new_adapter(), shuffled)
    assert out_of_order.state() == in_order.state()
    one, other = (run.adapter.core.state for run in (in_order, out_of_order))
    assert set(one.fault_state.excluded) == {"beacon.alpha"}
    assert (
        one.fault_state.excluded["beacon.alpha"].since_ns == other.fault_state.excluded["beacon.alpha"].since_ns
    )
    assert one.subfilters.mean.tobytes() == other.subfilters.mean.tobytes()
    assert one.subfilters.covariances.tobytes() == other.subfilters.covariances.tobytes()
    assert one.fault_state.innovation_means.running.tobytes() == other.fault_state.innovation_means.running.tobytes()
