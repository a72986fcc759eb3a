"""A leap second in a voyage: 2016-12-31T23:59:60, a second that clocks of seconds since 1970 repeat.

Ship and sky continue; the stamps and the clock of the node step back by a second at midnight. All inputs show the
step: the nodes continue with their states, and use no star whose stamp is wrong by a second.
"""

import copy
import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ship_simulation.stars.sky as simulated_sky
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_testing.adapter_runs import FACTORY, SECOND_NS, AdapterRun, Arrival, hand_over, sort_by_arrival, stamp_of
from ship_testing.every_input import Voyage, error_in_sigmas, scenario, voyage_of

MIDNIGHT_NS = 1_483_228_800 * SECOND_NS
BEFORE_S, DURATION_S = 8.0, 24.0
SIGMAS = 5.0


@functools.cache
def voyage_and_run(node: str) -> tuple[Voyage, AdapterRun]:
    """Return the voyage with the stamps of the stepping clock, and the run of a node."""
    table = earth_orientation_table()
    kept = table.leap_seconds.starts_ns < MIDNIGHT_NS
    leaps = replace(
        table.leap_seconds,
        starts_ns=table.leap_seconds.starts_ns[kept],
        tai_minus_utc_s=table.leap_seconds.tai_minus_utc_s[kept],
    )
    start_utc = "2016-12-31T23:59:52Z"
    with pytest.MonkeyPatch.context() as patch:
        # The voyage is simulated on a continuous time scale, so the simulated sky must not have this leap second.
        patch.setattr(simulated_sky, "earth_orientation_table", lambda: replace(table, leap_seconds=leaps))
        given = scenario(node, start_utc=start_utc, duration_s=DURATION_S)
        # At Greenwich it is night.
        known = voyage_of(node, replace(given, position=replace(given.position, longitude_deg=0.0)))
    arrivals = tuple(Arrival(a.topic, with_clock_step(a.message), a.receive_ns) for a in known.arrivals)
    run = AdapterRun(known.new_adapter())
    hand_over(run, arrivals, node_ns=node_ns)
    return replace(known, arrivals=arrivals), run


def node_ns(waiting_ns: int) -> int:
    return waiting_ns - SECOND_NS if waiting_ns >= MIDNIGHT_NS else waiting_ns


def with_clock_step(message: Any) -> Any:
    """Return the message as stamped by a clock that steps back at midnight."""
    changed = copy.deepcopy(message)
    ns = node_ns(stamp_of(message))
    changed.header.stamp.sec, changed.header.stamp.nanosec = divmod(ns, SECOND_NS)
    return changed


@pytest.mark.slow
@pytest.mark.parametrize("node", ["ship_attitude", "star_attitude", "optical_axis"])
def test_the_stamps_have_the_step(node: str) -> None:
    topic = "theodolite/encoder" if node == "optical_axis" else "ins/imu"
    stamps = np.array([a.stamp_ns for a in voyage_and_run(node)[0].arrivals if a.topic == topic])
    assert np.min(np.diff(stamps)) < -0.9 * SECOND_NS
    assert stamps[0] < MIDNIGHT_NS - 7 * SECOND_NS < MIDNIGHT_NS + 14 * SECOND_NS < stamps[-1]


@pytest.mark.parametrize(
    ("node", "topic"), [("ship_attitude", "ship/attitude"), ("optical_axis", "theodolite/pointing")]
)
def test_outputs_are_right_and_valid_throughout(node: str, topic: str) -> None:
    known, run = voyage_and_run(node)
    outputs = [(ns, m) for ns, name, m in run.published if name == topic and ns >= MIDNIGHT_NS - 5 * SECOND_NS]
    assert {message.status for _, message in outputs} == {Status.VALID}
    before = [message for ns, message in outputs if ns < MIDNIGHT_NS]
    after = [message for ns, message in outputs if ns >= MIDNIGHT_NS]
    stamps = np.array([*map(stamp_of, before), *(stamp_of(message) + SECOND_NS for message in after)])
    assert np.all(np.diff(stamps) > 0)
    assert np.max(np.diff(stamps)) < 0.5 * SECOND_NS
    as_stamped = replace(known, truth={true_ns - SECOND_NS: true for true_ns, true in known.truth.items()})
    assert [message for message in before if not error_in_sigmas(known, message) < SIGMAS] == []
    assert [message for message in after if not error_in_sigmas(as_stamped, message) < SIGMAS] == []
    assert run.adapter.notices == ["time base stepped by -1.000 s: reset, mountings and calibration kept"]
    assert not {source for report in run.messages(run.adapter.integrity_topic) for source in report.excluded}


def test_stars_of_the_repeated_second_are_not_used() -> None:
    """Five exposures are rejected: those of the repeated second, and those before the step with ambiguous stamps."""
    _, run = voyage_and_run("star_attitude")
    solutions = [(ns, m) for ns, name, m in run.published if name == "star/starboard/solution"]
    since_s = np.array([(ns - MIDNIGHT_NS) / SECOND_NS for ns, _ in solutions])
    assert {message.status for _, message in solutions} == {0}
    assert not np.any((since_s > 0.2) & (since_s < 1.0))
    assert np.min(since_s[since_s > 1.0]) < 1.5
    rejected = [m for m in run.messages("star/innovation") if m.reason == Reason.CLOCK]
    assert {"a leap second is inserted" in m.reason_text for m in rejected} == {True}
    assert len(rejected) == 5


def test_the_attitude_by_solutions_of_star_attitude_is_valid_within_two_seconds() -> None:
    """``ship_attitude`` has its stars from ``star_attitude``, which has no solution for a second."""
    known, _ = voyage_and_run("ship_attitude")
    config = known.new_adapter().config
    starboard = replace(config.star_sensors["starboard"], input="solution")
    adapter = ShipAttitudeAdapter(replace(config, star_sensors={"starboard": starboard}, references={}), FACTORY)
    topic = "star/starboard/solution"
    _, solved = voyage_and_run("star_attitude")
    stars = [Arrival(topic, m, ns) for ns, name, m in solved.published if name == topic]
    others = [arrival for arrival in known.arrivals if not arrival.topic.startswith(("star/", "reference/"))]
    run = AdapterRun(adapter)
    hand_over(run, sort_by_arrival([*others, *stars]), node_ns=node_ns)
    since_s = [(ns - MIDNIGHT_NS) / SECOND_NS for ns, name, m in run.published if name == "ship/attitude" and m.status]
    assert not [s for s in since_s if -5.0 < s < 0.0 or s > 2.0]
    assert run.adapter.time_base.steps == 1


def test_lights_are_used_after_the_step_and_no_source_is_excluded() -> None:
    _, run = voyage_and_run("optical_axis")
    lights = [(ns, m) for ns, topic, m in run.published if topic == "theodolite/innovation" and m.source == "lights"]
    used_s = [(ns - MIDNIGHT_NS) / SECOND_NS for ns, m in lights if m.accepted and ns >= MIDNIGHT_NS]
    assert used_s[0] < 2.0
    assert len(used_s) > 50
    assert run.messages("theodolite/pointing")[-1].light_count == 2
