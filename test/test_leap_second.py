"""A leap second inside a voyage: 2016-12-31T23:59:60, a second that clocks which count seconds since 1970 tell twice.

The ship and the sky go on; the stamps and the clock of the node step back by a second at midnight. Nothing tells the
two seconds of the same stamps apart, so that every source contradicts itself in the second.
"""

import copy
import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ship_simulation.stars.sky as simulated_sky
from ship_estimation.outcome import Status
from ship_estimation.refusals import Reason
from ship_geometry.earth_orientation import earth_orientation_table
from ship_testing.adapter_runs import SECOND_NS, AdapterRun, Arrival, hand_over, stamp_of
from ship_testing.every_input import Voyage, scenario, sigmas, voyage_of

MIDNIGHT_NS = 1_483_228_800 * SECOND_NS
BEFORE_S, DURATION_S = 8.0, 24.0
SIGMAS = 5.0


@functools.cache
def across(node: str) -> tuple[Voyage, AdapterRun]:
    """The voyage as it is stamped, and the run of a node."""
    table = earth_orientation_table()
    kept = table.leap_seconds.starts_ns < MIDNIGHT_NS
    leaps = replace(
        table.leap_seconds,
        starts_ns=table.leap_seconds.starts_ns[kept],
        tai_minus_utc_s=table.leap_seconds.tai_minus_utc_s[kept],
    )
    start_utc = "2016-12-31T23:59:52Z"
    with pytest.MonkeyPatch.context() as patch:
        # The Earth knows nothing of leap seconds.
        patch.setattr(simulated_sky, "earth_orientation_table", lambda: replace(table, leap_seconds=leaps))
        given = scenario(node, start_utc=start_utc, duration_s=DURATION_S)
        # At Greenwich it is night.
        known = voyage_of(node, replace(given, position=replace(given.position, longitude_deg=0.0)))
    arrivals = tuple(Arrival(a.topic, stepped(a.message), a.receive_ns) for a in known.arrivals)
    told = Voyage(known.new_adapter, arrivals, {})
    for true in known.truth.values():
        message = stepped(true)
        told.truth.setdefault(stamp_of(message), message)
    run = AdapterRun(told.new_adapter())
    hand_over(run, told.arrivals, node_ns=node_ns)
    return told, run


def node_ns(waiting_ns: int) -> int:
    return waiting_ns - SECOND_NS if waiting_ns >= MIDNIGHT_NS else waiting_ns


def stepped(message: Any) -> Any:
    """The message as stamped by a clock that steps back at midnight."""
    changed = copy.deepcopy(message)
    ns = node_ns(stamp_of(message))
    changed.header.stamp.sec, changed.header.stamp.nanosec = divmod(ns, SECOND_NS)
    return changed


@pytest.mark.slow
@pytest.mark.parametrize("node", ["ship_attitude", "star_attitude", "optical_axis"])
def test_the_step_is_there(node: str) -> None:
    topic = "theodolite/encoder" if node == "optical_axis" else "ins/imu"
    stamps = np.array([a.stamp_ns for a in across(node)[0].arrivals if a.topic == topic])
    assert np.min(np.diff(stamps)) < -0.9 * SECOND_NS
    assert stamps[0] < MIDNIGHT_NS - 7 * SECOND_NS < MIDNIGHT_NS + 14 * SECOND_NS < stamps[-1]


@pytest.mark.parametrize(
    ("node", "topic"), [("ship_attitude", "ship/attitude"), ("optical_axis", "theodolite/pointing")]
)
def test_what_is_claimed_is_honest_and_in_doubt_for_ten_seconds(node: str, topic: str) -> None:
    known, run = across(node)
    attitudes = [message for message in run.messages(topic) if message.status != Status.INVALID]
    since_s = np.array([(stamp_of(message) - MIDNIGHT_NS) / SECOND_NS for message in attitudes])
    status = np.array([message.status for message in attitudes])
    assert np.all(np.diff(since_s) > 0.0)
    wrong = [
        (stamp_of(message) - MIDNIGHT_NS) / SECOND_NS
        for message in attitudes
        if message.status in (Status.VALID, Status.COASTING) and not sigmas(known, message) < SIGMAS
    ]
    assert not wrong
    assert set(status[(since_s > 0.3) & (since_s < 9.5)]) == {Status.DEGRADED}
    assert status[-1] == Status.VALID
    assert run.innovations(Reason.CONFLICT)


def test_stars_are_not_solved_in_doubt_and_right_afterwards() -> None:
    _, run = across("star_attitude")
    solutions = run.messages("star/starboard/solution")
    since_s = np.array([(stamp_of(message) - MIDNIGHT_NS) / SECOND_NS for message in solutions])
    status = np.array([message.status for message in solutions])
    assert set(status[since_s < -1.1]) == {0}
    assert set(status[(since_s > 0.3) & (since_s < 9.5)]) == {3}
    assert status[-1] == 0


def test_lights_are_not_used_in_doubt_and_nobody_is_excluded() -> None:
    _, run = across("optical_axis")
    lights = [message for message in run.messages("theodolite/innovation") if message.source == "lights"]
    since_s = {
        used: np.array([(stamp_of(m) - MIDNIGHT_NS) / SECOND_NS for m in lights if m.accepted is used])
        for used in (True, False)
    }
    assert not np.any((since_s[True] > 0.3) & (since_s[True] < 9.5))
    assert np.count_nonzero((since_s[False] > 0.3) & (since_s[False] < 9.5)) > 40
    assert np.count_nonzero(since_s[True] > 11.0) > 10
    assert not {source for told in run.messages("theodolite/integrity") for source in told.excluded}
    assert run.messages("theodolite/pointing")[-1].light_count == 2
