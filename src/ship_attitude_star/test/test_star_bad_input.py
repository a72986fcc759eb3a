"""Bad input of star_attitude: the reason of the rejection, where it is published, and unchanged other outputs."""

import functools
import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.frames import rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_stars.attitude_from_stars.solution import SolutionStatus
from ship_testing.adapter_runs import (
    SECOND_NS,
    START_NS,
    Arrival,
    add_copy,
    change_where,
    changed_copy,
    exact_value,
    index_at,
    replace_message,
    sort_by_arrival,
    stamp_of,
    without,
)
from ship_testing.small_voyage import INS, Run, quaternion_message, run_adapter
from ship_testing.small_voyage import voyage as small_voyage
from ship_testing.star_bad_input import (
    FORE_SOLUTION,
    REJECTED_MESSAGES,
    REJECTED_STARS,
    SOURCE,
    Change,
    remove_star,
    set_field,
    set_star_fields,
    stamp_ahead,
)
from ship_testing.star_voyage import (
    EXACT_OPTICS,
    FIX,
    FORE,
    HUMIDITY,
    PRESSURE,
    SIGMA_PX,
    STARBOARD,
    STARS,
    TEMPERATURE,
    fault_free_run,
    new_adapter,
    published_bytes,
    run_new_adapter,
    solution_rotation,
    true_sensor,
    voyage,
    with_topics,
    without_topics,
)

CHANGE_S = 1.5
DAY_NS = 86_400 * SECOND_NS


@functools.cache
def run_without(topic: str) -> Run:
    return run_new_adapter(without(voyage(), index_at(voyage(), topic, CHANGE_S)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topic", "change", "reason", "text"), [c[1:] for c in REJECTED_MESSAGES], ids=[c[0] for c in REJECTED_MESSAGES]
)
def test_a_bad_message_is_reported_and_changes_nothing(topic: str, change: Change, reason: str, text: str) -> None:
    index = index_at(voyage(), topic, CHANGE_S)
    run = run_new_adapter(replace_message(voyage(), index, change))

    assert published_bytes(run) == published_bytes(run_without(topic))
    assert_reported_once(run, topic, reason, text, voyage()[index].receive_ns)


def assert_reported_once(run: Run, topic: str, reason: str, text: str, receive_ns: int) -> None:
    """Assert that a rejection is counted, is in one innovation, and is in the diagnostics within 1.1 s."""
    health = run.health(topic)
    assert run.reasons(topic) == {reason: 1}
    assert (health.rejected, health.received) == (1, health.accepted + 1)
    (innovation,) = innovations(run, Reason[reason.upper()])
    assert innovation.source == SOURCE[topic]
    assert text in innovation.reason_text
    levels = [
        (entry.level, entry.message)
        for ns, name, report in run.published
        if name == "/diagnostics" and receive_ns <= ns <= receive_ns + 1.1 * SECOND_NS
        for entry in report.status
        if entry.name == f"star_attitude: input {topic}"
    ]
    assert any(level == 1 and text in reported for level, reported in levels)


def innovations(run: Run, reason: Reason) -> list[Any]:
    return [message for message in run.messages("star/innovation") if message.reason == reason]


# -- single stars ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "reason", "text"), [s[1:] for s in REJECTED_STARS], ids=[s[0] for s in REJECTED_STARS]
)
def test_a_bad_star_alone_is_rejected(change: Change, reason: Reason, text: str) -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    run, expected = (
        run_new_adapter(replace_message(voyage(), index, change)),
        run_new_adapter(replace_message(voyage(), index, remove_star(3))),
    )

    for message in run.messages(FORE_SOLUTION):
        # The two runs differ only in the number of rejected stars.
        message.rejected_count -= stamp_of(message) == voyage()[index].stamp_ns
    assert published_bytes(run) == published_bytes(expected)
    assert run.reasons(FORE) == {reason.name.lower(): 1}
    assert run.health(FORE).rejected == 0
    (innovation,) = innovations(run, reason)
    assert (innovation.source, stamp_of(innovation)) == ("star.fore", voyage()[index].stamp_ns)
    assert text in innovation.reason_text


def solution_at(run: Run, index: int) -> Any:
    return next(m for m in run.messages(FORE_SOLUTION) if stamp_of(m) == voyage()[index].stamp_ns)


@pytest.mark.parametrize("ins", [True, False])
def test_a_false_star_is_named_with_its_angle(ins: bool) -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    u, v = (getattr(voyage()[index].message.stars[2], name) for name in "uv")
    # 3 px right and 4 px down: 5 px of 82.5″, less off axis.
    arrivals = replace_message(voyage(), index, set_star_fields(2, u=u + 3.0, v=v + 4.0))
    run = run_new_adapter(arrivals if ins else without_topics(arrivals, INS), **EXACT_OPTICS)
    (innovation,) = innovations(run, Reason.MISIDENTIFIED)
    hip = voyage()[index].message.stars[2].catalogue_id
    assert innovation.reason_text.startswith(f"HIP {hip}: ")
    assert list(innovation.components) == ["up", "right"]
    up, right = np.array(innovation.residual) / ARCSEC
    assert (up, right) == pytest.approx((-4 * 82.5, 3 * 82.5), abs=15.0)
    assert innovation.sigma[0] / ARCSEC == pytest.approx(82.5 * SIGMA_PX, rel=0.05)
    assert innovation.nis == pytest.approx((5 / SIGMA_PX) ** 2, rel=0.15)
    solution = solution_at(run, index)
    assert (solution.status, solution.star_count, solution.rejected_count) == (SolutionStatus.VALID, STARS - 1, 1)
    since_ns = stamp_of(solution) - START_NS
    assert np.linalg.norm(log_rotation(true_sensor(FORE, since_ns) @ solution_rotation(solution).T)) < 1e-3 * ARCSEC
    assert run.reasons(FORE) == {"misidentified": 1}


def test_two_stars_with_exchanged_names_are_both_rejected() -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    first, second = (voyage()[index].message.stars[row].catalogue_id for row in (0, 5))

    def swap(message: Any) -> None:
        message.stars[0].catalogue_id, message.stars[5].catalogue_id = second, first

    run = run_new_adapter(replace_message(voyage(), index, swap))
    named = {message.reason_text.split(":")[0] for message in innovations(run, Reason.MISIDENTIFIED)}
    assert named == {f"HIP {first}", f"HIP {second}"}
    assert solution_at(run, index).star_count == STARS - 2


def test_a_star_seen_twice_counts_once() -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    run = run_new_adapter(replace_message(voyage(), index, lambda message: message.stars.append(message.stars[0])))
    assert solution_at(run, index).star_count == STARS
    assert run.reasons(FORE) == {"duplicate": 1}
    expected, given = solution_at(fault_free_run(), index), solution_at(run, index)
    assert exact_value(given.rotation_covariance) == exact_value(expected.rotation_covariance)


# -- the same again, late, standing still ---------------------------------------------------------------------


def test_the_same_exposure_again_is_dropped() -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    run = run_new_adapter(add_copy(voyage(), index, lambda message: None, voyage()[index].receive_ns + 20_000_000))
    assert published_bytes(run) == published_bytes(fault_free_run())
    assert run.reasons(FORE) == {"duplicate": 1}


@pytest.mark.parametrize("delay_ns", [20_000_000, 200_000_000], ids=["joint solution open", "joint solution out"])
def test_of_two_exposures_of_one_stamp_neither_holds_nor_do_those_after_them(delay_ns: int) -> None:
    """A sensor with conflicting exposures gives no attitude until it has been consistent for ten seconds."""
    index = index_at(voyage(), FORE, CHANGE_S)
    mine = voyage()[index]
    pair = mine, changed_copy(mine, set_star_fields(0, u=17.0))
    runs = []
    for first, second in itertools.permutations(pair):
        second = replace(second, receive_ns=mine.receive_ns + delay_ns)
        runs.append(run_new_adapter(sort_by_arrival((*without(voyage(), index), first, second))))
    for run in runs:
        conflict, *after = innovations(run, Reason.CONFLICT)
        assert conflict.reason_text == "the same stamp with different content: do two sensors publish on one topic?"
        known_ns = mine.receive_ns + delay_ns
        of_sensor = [a for a in voyage() if a.topic == FORE]
        exposures = [a for a in of_sensor if a.stamp_ns == mine.stamp_ns or a.receive_ns > known_ns]
        assert [stamp_of(message) for message in after] == [a.stamp_ns for a in exposures]
        assert "used again after 10 s without a contradiction" in after[-1].reason_text
        # The last solution of a stamp holds.
        held = {stamp_of(message): message.status for message in run.messages(FORE_SOLUTION)}
        assert held == {a.stamp_ns: 3 * (a in exposures) for a in of_sensor}
        assert run.messages("star/starboard/solution")[-1].status == 0
        assert run.messages("star/joint/solution")[-1].status == 0
    joint = [[exact_value(message) for message in run.messages("star/joint/solution")] for run in runs]
    assert (joint[0] == joint[1]) == (delay_ns < 64_000_000)
    late = [run.reasons(FORE).get("late", 0) for run in runs]
    assert late == ([0, 0] if delay_ns < 64_000_000 else [1, 1])


def test_a_fix_with_the_same_stamp_and_another_position_is_reported() -> None:
    index = index_at(voyage(), FIX, 0.5)
    run = run_new_adapter(add_copy(voyage(), index, set_field("latitude", 32.0), voyage()[index].receive_ns + 1))
    assert run.reasons(FIX) == {"conflict": 1}


def test_an_exposure_beyond_the_lag_is_dropped() -> None:
    index = index_at(voyage(), FORE, 0.2)
    late = replace(voyage()[index], receive_ns=voyage()[index].receive_ns + round(2.5 * SECOND_NS))
    run = run_new_adapter(sort_by_arrival([*without(voyage(), index), late]))
    assert published_bytes(run) == published_bytes(run_new_adapter(without(voyage(), index)))
    assert run.reasons(FORE) == {"late": 1}
    assert "more than lag_s = 2" in innovations(run, Reason.LATE)[0].reason_text


def test_a_frozen_camera_is_found_while_the_ship_moves() -> None:
    stars = with_topics(voyage(5.0), FORE)[2].message.stars
    frozen = change_where(
        voyage(5.0),
        lambda a: a.topic == FORE and a.stamp_ns > START_NS + SECOND_NS // 2,
        lambda m: setattr(m, "stars", stars),
    )
    run = run_new_adapter(frozen)
    # Frozen exposures have stamps from 0.613 s to 4.813 s; those of the first half second are not rejected.
    assert run.reasons(FORE)["stuck"] == 19
    assert "do not move on the detector" in innovations(run, Reason.STUCK)[0].reason_text
    assert run.reasons(STARBOARD) == {}


def test_the_ins_in_degrees_per_second_is_left_out() -> None:
    def degrees(message: Any) -> None:
        for axis in "xyz":
            setattr(message.angular_velocity, axis, float(np.rad2deg(getattr(message.angular_velocity, axis))))

    ins = change_where(ins_only(8.0), lambda arrival: True, degrees)
    run = run_adapter(new_adapter(), ins)
    assert set(run.reasons(INS)) == {"units"}
    assert "degrees instead of radians" in innovations(run, Reason.UNITS)[0].reason_text


def ins_only(duration_s: float) -> tuple[Arrival, ...]:
    return with_topics(small_voyage(duration_s), INS)


# -- no place, no air, no Earth orientation -------------------------------------------------------------------


def assert_rejected_without_attitude(run: Run, reason: Reason, text: str) -> None:
    exposures = len(with_topics(voyage(), FORE))
    for name in (FORE_SOLUTION, "star/starboard/solution", "star/joint/solution"):
        assert {message.status for message in run.messages(name)} == {SolutionStatus.INVALID}
    assert len(run.messages(FORE_SOLUTION)) == exposures
    assert run.reasons(FORE) == {reason.name.lower(): exposures}
    assert run.health(FORE).rejected == exposures
    assert all(text in message.reason_text for message in innovations(run, reason))


def test_without_a_fix_there_is_no_attitude() -> None:
    assert_rejected_without_attitude(
        run_new_adapter(without_topics(voyage(), FIX)), Reason.NO_FIX, "no position fix received yet"
    )


def test_a_fix_older_than_a_minute_is_none() -> None:
    def old(seconds: float) -> tuple[Arrival, ...]:
        return sort_by_arrival(
            replace(changed_copy(a, stamp_ahead(-seconds)), receive_ns=a.receive_ns - round(seconds * SECOND_NS))
            if a.topic == FIX
            else a
            for a in voyage()
        )

    assert_rejected_without_attitude(run_new_adapter(old(64.0)), Reason.NO_FIX, "older: more than fix_max_age_s = 60")
    young = run_new_adapter(old(50.0))
    assert {message.status for message in young.messages(FORE_SOLUTION)} == {SolutionStatus.VALID}
    # Fixes over 4 s are extrapolated by 50 s. The ship may have turned: ½ · 0.1 m/s² · 48 s · 52 s = 125 m = 4.0″.
    about_east = [run.messages(FORE_SOLUTION)[0].rotation_covariance[0] for run in (young, fault_free_run())]
    assert np.sqrt(about_east[0] - about_east[1]) / ARCSEC == pytest.approx(4.04, abs=0.05)


def test_beyond_the_table_of_earth_orientation_there_is_no_attitude() -> None:
    shift_ns = earth_orientation_table().last_ns + 40 * DAY_NS - START_NS
    later = tuple(
        replace(changed_copy(a, stamp_ahead(shift_ns / SECOND_NS)), receive_ns=a.receive_ns + shift_ns)
        for a in voyage()
    )
    assert_rejected_without_attitude(run_new_adapter(later), Reason.NO_EARTH_ORIENTATION, "")


@pytest.mark.slow
def test_without_weather_the_refraction_error_is_larger_and_reported() -> None:
    run = run_new_adapter(without_topics(voyage(), PRESSURE, TEMPERATURE, HUMIDITY))
    message, clean = run.messages(FORE_SOLUTION)[0], fault_free_run().messages(FORE_SOLUTION)[0]
    assert message.status == SolutionStatus.VALID
    # At 45° the sigmas without weather, 10 K and 15 hPa, are 2″ and 0.9″ of elevation; 1 K and 0.5 hPa are 0.2″.
    more = np.sqrt(message.covariance[4] - clean.covariance[4]) / ARCSEC
    assert more == pytest.approx(2.2, abs=0.3)
    report = [m for _, topic, m in run.published if topic == "/diagnostics"][-1]
    (status,) = [entry for entry in report.status if entry.name == "star_attitude: sky"]
    assert status.message.startswith("no weather: pressure, temperature, humidity from parameters")


def test_exposures_without_stars_are_no_fault() -> None:
    def remove_stars(message: Any) -> None:
        message.stars = []

    run = run_new_adapter(change_where(voyage(), lambda a: a.topic == FORE, remove_stars))
    assert {message.status for message in run.messages(FORE_SOLUTION)} == {SolutionStatus.INVALID}
    assert {message.star_count for message in run.messages("star/joint/solution")} == {STARS}
    assert run.health(FORE).rejected == 0


def test_another_noise_of_the_ins_reaches_its_check() -> None:
    """One INS sample is off by 60", as in the test of ship_attitude."""

    def rotate_up(message: Any) -> None:
        rotation_nd = rotation_from_quaternion(np.array([getattr(message.orientation, axis) for axis in "xyzw"]))
        message.orientation = quaternion_message(exp_rotation(np.array([0.0, 60.0, 0.0]) * ARCSEC) @ rotation_nd)

    changed = replace_message(ins_only(5.0), index_at(ins_only(5.0), INS, 4.0), rotate_up)
    for white_arcsec, reasons in ((1.0, {"gate": 1}), (20.0, {})):
        adapter = run_adapter(new_adapter(), changed[:50]).adapter
        adapter.set_parameters({"ins.white_sigma_arcsec": white_arcsec})
        assert run_adapter(adapter, changed[50:]).reasons(INS) == reasons
