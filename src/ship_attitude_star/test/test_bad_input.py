"""Unusable messages: reason, report, and no effect on the ship attitude."""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
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
from ship_testing.small_voyage import FORE, INS, Run, fault_free_run, new_adapter, run_adapter, voyage

CHANGE_S = 2.5
SOURCE = {INS: "ins", FORE: "star.fore"}
ONE_SIGMA = 3.0 * ARCSEC

Change = Callable[[Any], None]


def set_field(path: str, value: float) -> Change:
    """Return a change of a field (``orientation.x``), one element of an array (``covariance.4``) or a whole array."""
    *parents, leaf = path.split(".")

    def change(message: Any) -> None:
        holder = functools.reduce(getattr, parents, message)
        if leaf.isdigit():
            holder[int(leaf)] = value
        elif isinstance(getattr(holder, leaf), np.ndarray):
            getattr(holder, leaf)[:] = value
        else:
            setattr(holder, leaf, value)

    return change


def scale_quaternion(factor: float) -> Change:
    def change(message: Any) -> None:
        for axis in "xyzw":
            setattr(message.orientation, axis, factor * getattr(message.orientation, axis))

    return change


def stamp_ahead(seconds: float) -> Change:
    """Return a change that advances the stamp; the message arrives 5 ms (INS) or 120 ms (star) after its true stamp."""

    def change(message: Any) -> None:
        later_ns = stamp_of(message) + round(seconds * SECOND_NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(later_ns, SECOND_NS)

    return change


def stamp_zero(message: Any) -> None:
    message.header.stamp.sec = message.header.stamp.nanosec = 0


def covariance(field: str, *rows: tuple[float, float, float]) -> Change:
    def change(message: Any) -> None:
        getattr(message, field)[:] = np.array(rows).ravel() * ONE_SIGMA**2

    return change


NEGATIVE = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)
ASYMMETRIC = (1.0, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
CORRELATED_BEYOND_1 = (1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0)
# Each correlation is below 1, the three together are not possible: eigenvalue 1 - 2 * 0.9 = -0.8.
NOT_PSD = (1.0, -0.9, -0.9), (-0.9, 1.0, -0.9), (-0.9, -0.9, 1.0)

DROPPED = [
    ("ins quaternion NaN", INS, set_field("orientation.x", np.nan), "non_finite", "orientation"),
    ("ins quaternion infinite", INS, set_field("orientation.w", -np.inf), "non_finite", "orientation"),
    ("ins rate NaN", INS, set_field("angular_velocity.y", np.nan), "non_finite", "angular_velocity"),
    ("ins covariance NaN", INS, set_field("orientation_covariance.4", np.nan), "non_finite", "orientation_covariance"),
    (
        "ins orientation not given",
        INS,
        set_field("orientation_covariance.0", -1.0),
        "not_given",
        "accept_unset_covariance",
    ),
    ("ins quaternion zero", INS, scale_quaternion(0.0), "bad_quaternion", "no orientation"),
    ("ins quaternion 2 % long", INS, scale_quaternion(1.02), "bad_quaternion", "1.02"),
    ("ins quaternion overflows", INS, set_field("orientation.x", 1e300), "bad_quaternion", "1e+300"),
    ("ins variance negative", INS, covariance("orientation_covariance", *NEGATIVE), "bad_covariance", "negative"),
    ("ins covariance asymmetric", INS, covariance("orientation_covariance", *ASYMMETRIC), "bad_covariance", "symm"),
    ("ins covariance not PSD", INS, covariance("orientation_covariance", *NOT_PSD), "bad_covariance", "definite"),
    ("ins rate no ship can have", INS, set_field("angular_velocity.x", 1e200), "units", "rad/s"),
    ("ins stamp zero", INS, stamp_zero, "bad_stamp", "0 ns"),
    ("ins stamp negative", INS, set_field("header.stamp.sec", -5), "bad_stamp", "POSIX time"),
    (
        "ins stamp nanoseconds beyond a second",
        INS,
        set_field("header.stamp.nanosec", 4_000_000_000),
        "bad_stamp",
        "nanosec",
    ),
    ("ins from the future", INS, stamp_ahead(0.06), "future", "0.055 s ahead"),
    ("ins from 2038", INS, set_field("header.stamp.sec", 2**31 - 1), "future", "ahead"),
    ("ins frame", INS, set_field("header.frame_id", "imu_link"), "frame", "'imu_link': expected 'ins'"),
    ("star azimuth NaN", FORE, set_field("azimuth", np.nan), "non_finite", "azimuth"),
    ("star roll infinite", FORE, set_field("roll", np.inf), "non_finite", "roll"),
    ("star covariance NaN", FORE, set_field("rotation_covariance.8", np.nan), "non_finite", "rotation_covariance"),
    ("star noise NaN", FORE, set_field("noise_covariance.1", np.nan), "non_finite", "noise_covariance"),
    ("star variance negative", FORE, covariance("rotation_covariance", *NEGATIVE), "bad_covariance", "negative"),
    ("star asymmetric", FORE, covariance("rotation_covariance", *ASYMMETRIC), "bad_covariance", "symmetric"),
    ("star correlation", FORE, covariance("rotation_covariance", *CORRELATED_BEYOND_1), "bad_covariance", "exceeds 1"),
    ("star not PSD", FORE, covariance("rotation_covariance", *NOT_PSD), "bad_covariance", "definite"),
    ("star noise exceeds total", FORE, set_field("noise_covariance.0", 1.0), "bad_covariance", "larger than the total"),
    (
        "star variance beyond a full turn",
        FORE,
        set_field("rotation_covariance.0", 1e300),
        "bad_covariance",
        "full turn",
    ),
    ("star stamp zero", FORE, stamp_zero, "bad_stamp", "0 ns"),
    ("star from the future", FORE, stamp_ahead(0.18), "future", "0.060 s ahead"),
    ("star frame", FORE, set_field("header.frame_id", "star_aft"), "frame", "'star_aft': expected 'star_fore'"),
    ("star elevation in degrees", FORE, set_field("elevation", 45.0), "units", "degrees"),
    ("star azimuth in degrees", FORE, set_field("azimuth", 34.4), "units", "degrees"),
    ("star invalid by itself", FORE, set_field("status", 3), "too_few_stars", "INVALID"),
]


@functools.cache
def run_without(topic: str, change_s: float = CHANGE_S) -> Run:
    return run_adapter(new_adapter(), without(voyage(), index_at(voyage(), topic, change_s)))


@pytest.mark.slow
@pytest.mark.parametrize(("topic", "change", "reason", "text"), [c[1:] for c in DROPPED], ids=[c[0] for c in DROPPED])
def test_a_bad_message_is_reported_and_changes_nothing(topic: str, change: Change, reason: str, text: str) -> None:
    index = index_at(voyage(), topic, CHANGE_S)
    run = run_adapter(new_adapter(), replace_message(voyage(), index, change))

    assert run.results() == run_without(topic).results()
    assert run.state() == run_without(topic).state()
    assert_reported_once(run, topic, reason, text, voyage()[index].receive_ns)


def assert_reported_once(run: Run, topic: str, reason: str, text: str, receive_ns: int) -> None:
    """Assert that the rejection is counted once, is in one innovation message, and is in the diagnostics within 1.1 s.
    """
    health = run.health(topic)
    assert run.reasons(topic) == {reason: 1}
    assert (health.rejected, health.received) == (1, health.accepted + 1)
    (innovation,) = run.innovations(Reason[reason.upper()])
    assert innovation.source == SOURCE[topic]
    assert not innovation.accepted
    assert text in innovation.reason_text
    reports = run.diagnostics(f"input {topic}", receive_ns, receive_ns + 1_100_000_000)
    assert any(level == 1 and reason in reported and text in reported for level, reported in reports)


def test_without_faults_nothing_is_rejected() -> None:
    assert {m.reason for m in fault_free_run().messages("ship/innovation")} == {Reason.NONE}
    assert run_without(INS).results() != fault_free_run().results()  # the comparisons above would see a difference
    assert run_without(FORE).state() != fault_free_run().state()


def test_a_quaternion_a_little_long_is_renormalised() -> None:
    run = run_adapter(new_adapter(), change_where(voyage(), lambda a: a.topic == INS, scale_quaternion(1.005)))
    assert run.reasons(INS) == {}
    clean = fault_free_run()
    for one, other in zip(run.messages("ship/attitude"), clean.messages("ship/attitude"), strict=True):
        # Scaling and normalising rounds the quaternion by a few 1e-16.
        assert np.allclose([one.heading, one.pitch, one.roll], [other.heading, other.pitch, other.roll], atol=1e-14)


def test_angles_counted_past_a_turn_are_the_same_attitude() -> None:
    def add_turns(message: Any) -> None:
        message.azimuth += 2.0 * np.pi
        message.roll -= 4.0 * np.pi

    run = run_adapter(new_adapter(), change_where(voyage(), lambda a: a.topic == FORE, add_turns))
    assert run.reasons(FORE) == {}
    clean = fault_free_run()
    for one, other in zip(run.messages("ship/attitude"), clean.messages("ship/attitude"), strict=True):
        # The sine of an angle of some turns is right to 1e-15.
        assert np.allclose([one.heading, one.pitch, one.roll], [other.heading, other.pitch, other.roll], atol=1e-13)


def test_a_quaternion_with_all_signs_changed_is_the_same_attitude() -> None:
    run = run_adapter(new_adapter(), change_where(voyage(), lambda a: a.topic == INS, scale_quaternion(-1.0)))
    assert run.results() == fault_free_run().results()
    assert run.state() == fault_free_run().state()


@pytest.mark.parametrize("unknown", [set_field("rotation_covariance", 0.0), set_field("rotation_covariance.0", -1.0)])
def test_a_star_without_covariance_gets_the_configured_sigma(unknown: Change) -> None:
    """The voyage's stars state 100", 3", 3", which is what the configuration has by default."""
    run = run_adapter(new_adapter(), change_where(voyage(), lambda a: a.topic == FORE, unknown))
    count = sum(a.topic == FORE for a in voyage())
    assert run.reasons(FORE) == {"covariance_unknown": count}
    assert run.health(FORE).rejected == 0
    state, stated = run.adapter.core.state, fault_free_run().adapter.core.state
    assert np.allclose(state.mean, stated.mean, atol=1e-6 * ARCSEC)
    assert np.allclose(state.covariance, stated.covariance, rtol=1e-6, atol=1e-20)


def test_an_exact_axis_without_other_uncertainty_is_rejected_and_does_not_block() -> None:
    """All sigmas of INS and installation are zero. Only the star's own covariance is left, and it is singular."""
    exact = {"ins__time_offset_sigma_s": 0.0}
    exact |= {f"ins__{name}_sigma_arcsec": 0.0 for name in ("tilt", "heading", "white")}
    for axis in ("forward", "up", "right"):
        exact |= {f"star_sensors__{sensor}__installation_sigma_{axis}_arcsec": 0.0 for sensor in ("fore", "starboard")}
    perfect_axis = covariance("rotation_covariance", (900.0, 0.0, 0.0), (0.0, 900.0, 0.0), (0.0, 0.0, 0.0))
    arrivals = change_where(voyage(), lambda a: a.topic == FORE, perfect_axis)
    run = run_adapter(new_adapter(**exact), arrivals)
    # A small interpolation error or rounding may make the innovation covariance invertible. Then the gate rejects the
    # measurement.
    assert run.reasons(FORE).keys() <= {"bad_covariance", "gate", "attitude_conflict"}
    assert run.health(FORE).accepted == 0
    assert len([m for m in run.messages("ship/innovation") if m.source == "star.starboard"]) > 20


def test_a_configured_sigma_is_used_if_the_message_gives_none() -> None:
    """The stars have almost no weight for the heading with 3000″ about all axes instead of 100″, 3″, 3″."""
    arrivals = change_where(voyage(), lambda a: a.topic.startswith("star"), set_field("rotation_covariance", 0.0))
    coarse = {
        f"star_sensors__{sensor}__sigma_{axis}_arcsec": 3000.0
        for sensor in ("fore", "starboard")
        for axis in ("forward", "up", "right")
    }
    sigma = [
        np.sqrt(np.diagonal(run_adapter(new_adapter(**changes), arrivals).adapter.core.state.covariance))[1]
        for changes in ({}, coarse)
    ]
    assert sigma[1] > 10.0 * sigma[0]


@pytest.mark.parametrize(
    ("unknown", "accepted"),
    [(set_field("orientation_covariance", 0.0), False), (set_field("orientation_covariance.0", -1.0), True)],
)
def test_an_ins_without_covariance_is_used_as_configured(unknown: Change, accepted: bool) -> None:
    adapter = new_adapter(ins__accept_unset_covariance=accepted)
    run = run_adapter(adapter, change_where(voyage(), lambda a: a.topic == INS, unknown))
    assert run.reasons(INS) == {"covariance_unknown": sum(a.topic == INS for a in voyage())}
    assert run.results() == fault_free_run().results()


@pytest.mark.parametrize("accepted", [False, True])
def test_a_reference_without_an_orientation_is_rejected_unless_configured(accepted: bool) -> None:
    """The reference sends an INS message whose first element of ``orientation_covariance`` is −1."""
    topic, index = "reference/gyro/imu", index_at(voyage(), INS, CHANGE_S)
    arrival = changed_copy(voyage()[index], set_field("orientation_covariance.0", -1.0))
    unset = replace(arrival, topic=topic, receive_ns=arrival.receive_ns + 1)
    adapter = new_adapter(references={"gyro": {"accept_unset_covariance": accepted}})
    run = run_adapter(adapter, sort_by_arrival((*voyage(), unset)))
    assert run.reasons(topic) == {"covariance_unknown" if accepted else "not_given": 1}
    assert (run.health(topic).accepted, run.health(topic).rejected) == ((1, 0) if accepted else (0, 1))
    if not accepted:
        (innovation,) = run.innovations(Reason.NOT_GIVEN)
        assert (innovation.source, innovation.accepted) == ("reference.gyro", False)
        without_it = run_adapter(new_adapter(references={"gyro": {}}), voyage())
        assert (run.results(), run.state()) == (without_it.results(), without_it.state())


def test_an_ins_without_rates_is_used_without_them() -> None:
    """A rate covariance that starts with −1 marks the rate as not measured (sensor_msgs/Imu), whatever its value."""

    def no_rate(message: Any) -> None:
        message.angular_velocity_covariance[0] = -1.0
        message.angular_velocity.x = np.nan

    run = run_adapter(new_adapter(), change_where(voyage(), lambda a: a.topic == INS, no_rate))
    assert run.reasons(INS) == {}
    assert run.health(FORE).rejected == 0


@pytest.mark.parametrize("topic", [INS, FORE])
def test_the_same_message_again_is_a_duplicate(topic: str) -> None:
    index = index_at(voyage(), topic, CHANGE_S)
    again_ns = voyage()[index].receive_ns + SECOND_NS
    run = run_adapter(new_adapter(), add_copy(voyage(), index, lambda message: None, again_ns))
    assert run.results() == fault_free_run().results()
    assert run.state() == fault_free_run().state()
    assert_reported_once(run, topic, "duplicate", "again", again_ns)


@pytest.mark.parametrize("topic", [INS, FORE])
@pytest.mark.parametrize("delay_s", [0.001, 1.0])
def test_of_two_messages_with_one_stamp_the_same_one_is_kept_in_either_order(topic: str, delay_s: float) -> None:
    def other(message: Any) -> None:
        if topic == INS:
            message.angular_velocity.x += 1e-4
        else:
            message.azimuth += 5.0 * ARCSEC

    arrivals = voyage()
    index = index_at(arrivals, topic, 2.6)  # for the INS 2.600 s, just before the star exposure of 2.613 s
    one, another = arrivals[index], changed_copy(arrivals[index], other)
    second_ns = one.receive_ns + round(delay_s * SECOND_NS)
    one_first, another_first = (
        run_adapter(
            new_adapter(), sort_by_arrival((*without(arrivals, index), first, replace(second, receive_ns=second_ns)))
        )
        for first, second in ((one, another), (another, one))
    )
    alone = fault_free_run(), run_adapter(new_adapter(), replace_message(arrivals, index, other))
    assert alone[0].state() != alone[1].state()
    assert one_first.state() == another_first.state()
    assert one_first.state() in (alone[0].state(), alone[1].state())
    for run in (one_first, another_first):
        assert_reported_once(run, topic, "conflict", "sort first", second_ns)
    # If the first one is kept, the second one has changed only the status.
    kept = [attitudes(run) == attitudes(only) for run, only in zip((one_first, another_first), alone, strict=True)]
    assert sorted(kept) == [False, True]
    for run in (one_first, another_first):
        assert {message.status for message in run.messages("ship/attitude")[-10:]} == {Status.DEGRADED}
        text = f"{SOURCE[topic]} sent conflicting data with one stamp"
        assert run.diagnostics("attitude", second_ns, run.now_ns)[-1] == (1, f"DEGRADED: {text}")


def attitudes(run: Run) -> list[Any]:
    """Return all attitudes to the last bit, without their status."""
    published = run.messages("ship/attitude")
    return [
        exact_value([m.header.stamp.sec, m.header.stamp.nanosec, m.heading, m.pitch, m.roll, *m.covariance])
        for m in published
    ]


@pytest.mark.parametrize("topic", [INS, FORE])
def test_a_source_with_conflicting_messages_is_not_valid_for_ten_seconds(
    topic: str,
) -> None:
    """Two messages with one stamp differ by 20″: outputs based on either of them are not VALID."""
    arrivals = voyage(16.0)
    index = index_at(arrivals, topic, 3.0)
    run = run_adapter(new_adapter(), add_copy(arrivals, index, turn_heading(20.0), arrivals[index].receive_ns + 1))
    # The second message of the INS also contradicts its rates: the reason is then 'gate', and the conflict of stamps is
    # recorded all the same.
    assert run.reasons(topic) == {"gate" if topic == INS else "conflict": 1}
    until_ns = arrivals[index].stamp_ns + 10 * SECOND_NS
    status = {stamp_of(m): m.status for m in run.messages("ship/attitude") if stamp_of(m) > START_NS + 3.3 * SECOND_NS}
    assert {value for ns, value in status.items() if ns <= until_ns} == {Status.DEGRADED}
    assert {value for ns, value in status.items() if ns > until_ns} == {Status.VALID}


def turn_heading(arcsec: float) -> Change:
    """Return a change of the heading by an angle."""

    def change(message: Any) -> None:
        if hasattr(message, "azimuth"):
            message.azimuth += arcsec * ARCSEC
            return
        q, half = message.orientation, 0.5 * arcsec * ARCSEC
        q.x, q.y, q.z, q.w = q.x - half * q.y, q.y + half * q.x, q.z + half * q.w, q.w - half * q.z

    return change


def test_a_rejected_star_sensor_with_conflicting_messages_does_not_affect_the_others() -> None:
    """Two publishers on one topic are 400″ and 450″ off: neither is used, and the attitude is VALID."""
    arrivals = voyage(8.0)
    since_ns = START_NS + 3 * SECOND_NS
    wrong = change_where(arrivals, lambda a: a.topic == FORE and a.stamp_ns > since_ns, turn_heading(400.0))
    doubled = [a for a in wrong if a.topic == FORE and a.stamp_ns > since_ns]
    twice = [replace(changed_copy(a, turn_heading(50.0)), receive_ns=a.receive_ns + 1) for a in doubled]
    run = run_adapter(new_adapter(), sort_by_arrival((*wrong, *twice)))
    assert run.reasons(FORE)["conflict"] == len(twice)
    last = run.messages("ship/attitude")[-1]
    assert last.status == Status.VALID
    assert list(last.sources) == ["ins", "star.starboard"]


@pytest.mark.parametrize("topic", [INS, FORE])
def test_a_message_older_than_the_lag_is_dropped(topic: str) -> None:
    """``lag_s`` is 2 s, and the message arrives 2.2 s after its stamp."""
    index = index_at(voyage(), topic, 1.5)
    arrives_ns = voyage()[index].stamp_ns + 2_200_000_000
    run = run_adapter(new_adapter(), replace_message(voyage(), index, lambda message: None, arrives_ns))
    assert run.results() == run_without(topic, 1.5).results()
    assert run.state() == run_without(topic, 1.5).state()
    assert_reported_once(run, topic, "late", "more than lag_s = 2", arrives_ns)
    (values,) = {
        tuple((v.key, v.value) for v in status.values if v.key.startswith("late "))
        for status in run.messages("/diagnostics")[-1].status
        if status.name == f"ship_attitude: input {topic}"
    }
    assert values == (("late up to 5 s", "1"),)


def test_ten_messages_in_a_row_from_the_future_are_a_clock_offset() -> None:
    from_ns = voyage()[index_at(voyage(), INS, CHANGE_S)].receive_ns
    ahead = change_where(voyage(), lambda a: a.topic == INS and a.receive_ns >= from_ns, stamp_ahead(0.2))
    run = run_adapter(new_adapter(), ahead)
    tenth_ns = from_ns + 9 * 40_000_000
    before = run.diagnostics(f"input {INS}", from_ns, tenth_ns)
    after = run.diagnostics(f"input {INS}", tenth_ns, tenth_ns + 1_100_000_000)
    assert all(level < 2 for level, _ in before)
    assert any(level == 2 and "clock offset" in text for level, text in after)
    # The node does not correct the stamps, so no later output is based on the INS.
    assert max(stamp_of(m) for m in run.messages("ship/attitude") if "ins" in m.sources) < from_ns


def test_a_star_far_off_once_is_gated_and_changes_nothing() -> None:
    """The azimuth is 1.4° off; the sigma about Up of a sensor that looks up by 45° is 100" sin 45°."""
    run = run_adapter(
        new_adapter(), replace_message(voyage(), index_at(voyage(), FORE, CHANGE_S), set_field("azimuth", 0.7))
    )
    assert run.results() == run_without(FORE).results()
    assert run.state() == run_without(FORE).state()
    assert run.reasons(FORE) == {"gate": 1}
    (innovation,) = run.innovations(Reason.GATE)
    assert innovation.nis > innovation.gate
    assert list(innovation.components) == ["forward", "up", "right"]
    assert np.all(np.isfinite(innovation.residual))
    assert np.all(np.array(innovation.sigma) > 0.0)


def test_rates_in_degrees_are_detected_and_rejected_until_corrected() -> None:
    def degrees(message: Any) -> None:
        for axis in "xyz":
            setattr(message.angular_velocity, axis, np.rad2deg(getattr(message.angular_velocity, axis)))

    arrivals = voyage(17.0)
    wrong_until_ns = arrivals[0].receive_ns + 8 * SECOND_NS
    run = run_adapter(
        new_adapter(), change_where(arrivals, lambda a: a.topic == INS and a.receive_ns < wrong_until_ns, degrees)
    )
    rejected = run.innovations(Reason.UNITS)
    first_s = (stamp_of(rejected[0]) - arrivals[0].stamp_ns) * 1e-9
    assert 5.0 <= first_s <= 5.7
    assert "rad/s" in rejected[0].reason_text
    assert "57" in rejected[0].reason_text
    detected_ns = round(first_s * SECOND_NS) + arrivals[0].receive_ns
    reports = run.diagnostics(f"input {INS}", detected_ns, detected_ns + 1_100_000_000)
    assert any(level >= 1 and "units" in text for level, text in reports)
    # Within six seconds of correct rates the effect of the wrong ones is gone.
    assert run.messages("ship/attitude")[-1].status == 0
    assert stamp_of(rejected[-1]) < wrong_until_ns + 6 * SECOND_NS


def test_a_frozen_ins_is_reported_at_once_and_its_first_new_value_is_used() -> None:
    arrivals = voyage(8.0)
    frozen = arrivals[index_at(arrivals, INS, 3.0)].message.orientation
    from_ns, until_ns = arrivals[0].stamp_ns + 3 * SECOND_NS, arrivals[0].stamp_ns + 6 * SECOND_NS

    def freeze(message: Any) -> None:
        message.orientation = frozen

    run = run_adapter(
        new_adapter(), change_where(arrivals, lambda a: a.topic == INS and from_ns <= a.stamp_ns < until_ns, freeze)
    )
    # Of 75 samples in three seconds, the first is true. The rates of the INS contradict the next 12 (gate); after half
    # a second the value counts as stuck.
    assert run.reasons(INS) == {"gate": 12, "stuck": 62}
    stamps = [stamp_of(m) for m in run.innovations(Reason.STUCK)]
    assert stamps[0] == from_ns + 13 * 40_000_000
    assert stamps[-1] == until_ns - 40_000_000
    assert until_ns in {stamp_of(m) for m in run.messages("ship/attitude")}
    reports = run.diagnostics(f"input {INS}", stamps[0], stamps[0] + 1_100_000_000)
    assert any(level >= 1 and "stuck" in text for level, text in reports)
    assert run.messages("ship/attitude")[-1].status == 0


@pytest.mark.parametrize("motion_reference", [INS, "other star sensor"])
def test_a_frozen_star_sensor_is_reported_within_a_second_and_recovers_at_once(motion_reference: str) -> None:
    """The motion reference is the INS or, during an INS timeout, the other star sensor."""
    arrivals = voyage(16.0)
    frozen = arrivals[index_at(arrivals, FORE, 3.0)].message
    from_ns, until_ns = arrivals[0].stamp_ns + 3 * SECOND_NS, arrivals[0].stamp_ns + 10 * SECOND_NS
    if motion_reference != INS:
        arrivals = tuple(a for a in arrivals if a.topic != INS or not from_ns <= a.stamp_ns < until_ns)

    def freeze(message: Any) -> None:
        message.azimuth, message.elevation, message.roll = frozen.azimuth, frozen.elevation, frozen.roll

    def is_frozen(arrival: Arrival) -> bool:
        return arrival.topic == FORE and from_ns <= arrival.stamp_ns < until_ns

    run = run_adapter(new_adapter(), change_where(arrivals, is_frozen, freeze))
    stuck = [stamp_of(m) for m in run.innovations(Reason.STUCK)]
    # Seven seconds at 5 Hz give 35 equal exposures. The first is true, and the next two come too early to count as
    # stuck.
    assert len(stuck) == run.reasons(FORE)["stuck"] == 35 - 3
    assert min(stuck) == stamp_of(frozen) + 3 * 200_000_000
    assert max(stuck) == stamp_of(frozen) + 34 * 200_000_000
    used = {stamp_of(m) for m in run.innovations(Reason.NONE) if m.source == "star.fore"}
    assert max(stuck) + 200_000_000 in used


def test_a_ship_at_rest_is_not_stuck() -> None:
    """The INS repeats one value in dock, and the stars vary by their noise of 100" about the boresight."""
    first = {topic: voyage()[index_at(voyage(), topic, 0.0)].message for topic in (INS, FORE)}
    rng = np.random.default_rng(7)

    def set_at_rest(message: Any) -> None:
        if hasattr(message, "orientation"):
            message.orientation = first[INS].orientation
            message.angular_velocity = first[INS].linear_acceleration  # zero
        else:
            message.azimuth, message.elevation = first[FORE].azimuth, first[FORE].elevation
            message.roll = first[FORE].roll + 100.0 * ARCSEC * rng.standard_normal()

    run = run_adapter(
        new_adapter(), change_where([a for a in voyage() if a.topic in first], lambda a: True, set_at_rest)
    )
    assert run.reasons(INS) == {}
