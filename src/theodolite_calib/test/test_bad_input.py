"""Unusable messages: the reason, its place of publication, and the pointing without them."""

import copy
import functools
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import LONGEST_TEXT, Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_testing.adapter_runs import (
    SECOND_NS,
    Arrival,
    add_copy,
    change_where,
    changed_copy,
    index_at,
    replace_message,
    sort_by_arrival,
    stamp_of,
    without,
)
from ship_testing.small_session import (
    BASELINE,
    BEACONS,
    ENCODER,
    IMU,
    SHIP,
    Run,
    error_in_sigmas,
    fault_free_run,
    new_adapter,
    run_adapter,
    session,
)
from theodolite_calib.messages.input_messages import MAX_BEACONS
from theodolite_calib.samples.samples import Mode

CHANGE_S = 3.0
ALPHA = BASELINE["alpha"]
SOURCE = {ENCODER: "encoder", SHIP: "ship", BEACONS: "lights", ALPHA: "baseline.alpha", IMU["alpha"]: "drone.alpha"}

Change = Callable[[Any], None]


def set_field(path: str, value: Any) -> Change:
    """Return a change that sets a field (``orientation.x``), or all elements of an array field."""
    *parents, leaf = path.split(".")

    def change(message: Any) -> None:
        holder = functools.reduce(getattr, parents, message)
        if isinstance(getattr(holder, leaf), np.ndarray):
            getattr(holder, leaf)[:] = value
        else:
            setattr(holder, leaf, value)

    return change


def shift_stamp(seconds: float) -> Change:
    def change(message: Any) -> None:
        moved_ns = stamp_of(message) + round(seconds * SECOND_NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(moved_ns, SECOND_NS)

    return change


NEGATIVE = np.diag([1.0, -1.0, 1.0]).ravel()
def stamp_zero(message: Any) -> None:
    message.header.stamp.sec = message.header.stamp.nanosec = 0


def bad_covariance_and_rate(message: Any) -> None:
    for path, value in (("rotation_covariance", 0.0), ("covariance", NEGATIVE), ("angular_velocity.x", np.nan)):
        set_field(path, value)(message)


LARGE = 1e4 * np.eye(3).ravel()
NOT_SYMMETRIC = np.array([1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])

DROPPED = [
    ("encoder NaN", ENCODER, set_field("azimuth", np.nan), "non_finite", "azimuth"),
    ("encoder infinite", ENCODER, set_field("elevation", np.inf), "non_finite", "elevation"),
    ("encoder sigma infinite", ENCODER, set_field("sigma", np.inf), "non_finite", "sigma"),
    ("encoder sigma negative", ENCODER, set_field("sigma", -1.0), "bad_covariance", "positive"),
    ("encoder reports a fault", ENCODER, set_field("status", 1), "gap", "reports a fault"),
    ("encoder in degrees", ENCODER, set_field("elevation", 40.0), "units", "expected radians"),
    ("encoder elevation in degrees", ENCODER, set_field("elevation", 30.0), "units", "degrees?"),
    ("encoder frame", ENCODER, set_field("header.frame_id", "mount"), "frame", "'mount': expected 'theodolite_base'"),
    ("encoder stamp zero", ENCODER, stamp_zero, "bad_stamp", "0 ns"),
    ("encoder from the future", ENCODER, shift_stamp(0.06), "future", "ahead"),
    ("ship NaN", SHIP, set_field("orientation.x", np.nan), "non_finite", "orientation"),
    ("ship quaternion zero", SHIP, set_field("orientation.w", 10.0), "bad_quaternion", "expected 1"),
    ("ship INVALID", SHIP, set_field("status", 3), "gap", "INVALID"),
    ("ship status unknown", SHIP, set_field("status", 9), "units", "status 9"),
    ("ship variance negative", SHIP, set_field("rotation_covariance", NEGATIVE), "bad_covariance", "negative"),
    ("ship not symmetric", SHIP, set_field("rotation_covariance", NOT_SYMMETRIC), "bad_covariance", "symmetric"),
    ("ship variance of turns", SHIP, set_field("rotation_covariance", LARGE), "bad_covariance", "full turn"),
    ("ship variance and rate", SHIP, bad_covariance_and_rate, "bad_covariance", "negative"),
    ("ship frame", SHIP, set_field("header.frame_id", "mast"), "frame", "'mast': expected 'deck'"),
    ("baseline NaN", ALPHA, set_field("enu.x", np.nan), "non_finite", "enu"),
    ("baseline variance negative", ALPHA, set_field("covariance", NEGATIVE), "bad_covariance", "negative"),
    ("baseline from the future", ALPHA, shift_stamp(1.0), "future", "ahead"),
    ("drone quaternion", IMU["alpha"], set_field("orientation.w", 10.0), "bad_quaternion", "expected 1"),
    (
        "drone orientation not given",
        IMU["alpha"],
        set_field("orientation_covariance", -1.0),
        "not_given",
        "no orientation",
    ),
    ("image of another telescope", BEACONS, set_field("telescope_id", "finder"), "unknown_sensor", "expected 'main'"),
    ("image frame", BEACONS, set_field("header.frame_id", "main"), "frame", "'main': expected 'telescope'"),
    ("image of negative length", BEACONS, set_field("exposure_s", -0.01), "units", "exposure_s is -0.01"),
    ("image exposed for milliseconds", BEACONS, set_field("exposure_s", 20.0), "units", "expected seconds, 10 at most"),
    ("image exposed for ever", BEACONS, set_field("exposure_s", np.inf), "non_finite", "exposure_s"),
]


def has_reason(run: Run, reason: Reason) -> list[tuple[str, str]]:
    return [(message.source, message.reason_text) for message in run.innovations(reason)]


def is_within_covariance(run: Run) -> bool:
    """True if all errors of VALID and COASTING pointings are below six standard deviations."""
    claimed = [m for m in run.pointings if m.status in (Status.VALID, Status.COASTING)]
    return max(error_in_sigmas(message) for message in claimed) < 6.0


def make_sighting(message: Any, name: str) -> Any:
    """Return the sighting of a beacon in an image message."""
    return next(sighting for sighting in message.beacons if sighting.beacon_id == name)


def test_the_clean_session_is_right_across_the_wrap_of_the_azimuth() -> None:
    run = fault_free_run()
    azimuths = np.array([a.message.azimuth for a in session() if a.topic == ENCODER])
    assert np.min(np.diff(azimuths)) < -6.0
    assert max(error_in_sigmas(message) for message in run.pointings) < 4.0
    assert {m.status for m in run.pointings[20:]} == {Status.VALID}
    assert {m.mode for m in run.pointings[20:]} == {Mode.TWO_LIGHTS}
    assert all(m.accepted for m in run.messages("theodolite/innovation"))


@pytest.mark.slow
@pytest.mark.parametrize(("topic", "change", "reason", "text"), [c[1:] for c in DROPPED], ids=[c[0] for c in DROPPED])
def test_a_dropped_message_leaves_everything_as_without_it(topic: str, change: Change, reason: str, text: str) -> None:
    index = index_at(session(), topic, CHANGE_S)
    bad = run_adapter(new_adapter(), replace_message(session(), index, change))
    without_it = run_adapter(new_adapter(), without(session(), index))
    assert bad.reasons(topic) == {reason: 1}
    assert bad.health(topic).rejected == 1
    ((source, reason_text),) = has_reason(bad, Reason[reason.upper()])
    assert source == SOURCE[topic]
    assert text in reason_text
    assert bad.results() == without_it.results()
    assert bad.state() == without_it.state()


@pytest.mark.parametrize("topic", [ENCODER, SHIP, ALPHA, IMU["alpha"], BEACONS])
def test_the_same_message_again_changes_nothing(topic: str) -> None:
    index = index_at(session(), topic, CHANGE_S)
    again_ns = session()[index].receive_ns + 5_000_000
    run = run_adapter(new_adapter(), add_copy(session(), index, lambda message: None, again_ns))
    assert run.reasons(topic) == {"duplicate": 1}
    assert run.results() == fault_free_run().results()


OTHER = [
    (ENCODER, set_field("elevation", 0.5274)),
    (SHIP, set_field("status", 1)),
    (ALPHA, set_field("enu.x", 1.0)),
    (IMU["alpha"], set_field("orientation", session()[index_at(session(), IMU["alpha"], 1.0)].message.orientation)),
    (BEACONS, lambda message: set_field("x", 0.001)(message.beacons[0])),
]


@pytest.mark.parametrize(("topic", "change"), OTHER)
def test_of_two_contents_of_one_stamp_the_order_of_arrival_does_not_choose(topic: str, change: Change) -> None:
    index = index_at(session(), topic, CHANGE_S)
    arrival = session()[index]
    after_ns, before_ns = arrival.receive_ns + 1, arrival.receive_ns - 1
    second = run_adapter(new_adapter(), add_copy(session(), index, change, after_ns))
    first = run_adapter(new_adapter(), add_copy(session(), index, change, before_ns))
    assert second.state() == first.state()
    assert second.reasons(topic)["conflict"] == first.reasons(topic)["conflict"] == 1


@pytest.mark.parametrize(("topic", "change"), OTHER)
def test_a_source_with_conflicting_messages_is_not_valid_until_ten_consistent_seconds_later(
    topic: str, change: Change
) -> None:
    arrivals = session(15.0)
    index = index_at(arrivals, topic, CHANGE_S)
    run = run_adapter(new_adapter(), add_copy(arrivals, index, change, arrivals[index].receive_ns + 1))
    source, until_s = NAMED[topic], CHANGE_S + 10.0
    report = run.diagnostics("pointing", arrivals[index].receive_ns + SECOND_NS, run.now_ns)[0]
    assert report == (1, f"DEGRADED: {source} sent conflicting data with one stamp")
    statuses = [m.status for m in run.pointings if CHANGE_S + 0.2 < seconds(m) < until_s]
    assert set(statuses) == {Status.DEGRADED}
    assert {m.status for m in run.pointings if seconds(m) > until_s + 0.2} == {Status.VALID}


NAMED = {
    ENCODER: "encoder",
    SHIP: "ship/attitude",
    ALPHA: "baseline.alpha",
    IMU["alpha"]: "drone.alpha",
    BEACONS: "beacons",
}


def test_two_attitudes_of_the_ship_at_every_stamp_are_never_called_valid() -> None:
    """Two publishers, 20″ apart in heading: the right one cannot be determined."""
    turned = [
        replace(changed_copy(a, turn_heading(20.0)), receive_ns=a.receive_ns + order)
        for a, order in zip([a for a in session() if a.topic == SHIP], itertools.cycle([-1, 1, 2]))
    ]
    run = run_adapter(new_adapter(), sort_by_arrival((*session(), *turned)))
    assert {m.status for m in run.pointings} == {Status.DEGRADED}
    assert max(error_in_sigmas(m) for m in run.pointings) < 5.0


def turn_heading(arcsec: float) -> Change:
    """Return a change of the heading."""

    def change(message: Any) -> None:
        q, half = message.orientation, 0.5 * arcsec * ARCSEC
        q.x, q.y, q.z, q.w = q.x - half * q.y, q.y + half * q.x, q.z + half * q.w, q.w - half * q.z

    return change


def test_beacons_without_exposure_length_are_points():
    """The session's lights do not move on the detector, so that its exposures have no streaks either."""
    not_given = change_where(session(), lambda a: a.topic == BEACONS, set_field("exposure_s", np.nan))
    zero = change_where(session(), lambda a: a.topic == BEACONS, set_field("exposure_s", 0.0))
    points = run_adapter(new_adapter(), not_given)
    assert points.results() == run_adapter(new_adapter(), zero).results()
    assert points.reasons(BEACONS) == {}
    streaks, as_points = (run.messages("theodolite/pointing")[-1] for run in (fault_free_run(), points))
    assert abs(streaks.azimuth - as_points.azimuth) * np.cos(streaks.elevation) < 0.3 * ARCSEC
    assert abs(streaks.elevation - as_points.elevation) < 0.3 * ARCSEC
    longer = run_adapter(
        new_adapter(), change_where(session(), lambda a: a.topic == BEACONS, set_field("exposure_s", 0.1))
    )
    assert longer.reasons(BEACONS) == {}
    assert is_within_covariance(longer)


def test_exchanged_names_are_corrected_and_reported() -> None:
    def exchange(message: Any) -> None:
        alpha, bravo = make_sighting(message, "alpha"), make_sighting(message, "bravo")
        alpha.beacon_id, bravo.beacon_id = "bravo", "alpha"

    run = run_adapter(new_adapter(), replace_message(session(), index_at(session(), BEACONS, CHANGE_S), exchange))
    (message,) = run.innovations(Reason.LIGHT_CONFLICT)
    assert message.accepted
    assert "bravo is alpha, alpha is bravo" in message.reason_text
    assert run.reasons(BEACONS) == {"light_conflict": 1}
    assert run.results() == fault_free_run().results()


def test_wrong_beacon_is_rejected_by_angle() -> None:
    index = index_at(session(), BEACONS, CHANGE_S)

    def shift(message: Any) -> None:
        make_sighting(message, "bravo").x += 0.1 * np.deg2rad(100.0 / 3600.0)

    run = run_adapter(new_adapter(), replace_message(session(), index, shift))
    (message,) = run.innovations(Reason.LIGHT_CONFLICT)
    assert not message.accepted
    assert "angle between alpha and bravo: residual" in message.reason_text
    assert run.reasons(BEACONS) == {"light_conflict": 1}
    assert run.state() == run_adapter(new_adapter(), without(session(), index)).state()
    assert is_within_covariance(run)


def test_common_offset_of_beacons_is_a_telescope_fault() -> None:
    def shift(message: Any) -> None:
        for sighting in message.beacons:
            sighting.x += 0.1 * np.deg2rad(200.0 / 3600.0)

    index = index_at(session(), BEACONS, 4.0)
    run = run_adapter(new_adapter(), replace_message(session(), index, shift))
    assert run.reasons(BEACONS) == {"gate": 1}
    assert run.state()[:3] == run_adapter(new_adapter(), without(session(), index)).state()[:3]
    # A pointing that disagrees with the lights must not be VALID until the two agree again.
    after = [m for m in run.pointings if 4.0 < seconds(m) < 4.6]
    assert {m.status for m in after} >= {Status.DEGRADED}
    assert run.pointings[-1].status == Status.VALID


def seconds(message: Any) -> float:
    return (stamp_of(message) - session()[0].stamp_ns) * 1e-9


def test_float_baseline_is_rejected_and_the_other_beacon_used() -> None:
    run = run_adapter(new_adapter(), change_where(session(), lambda a: a.topic == ALPHA, set_field("fix", 3)))
    assert run.reasons(ALPHA) == {"not_fixed": 30}
    assert ("baseline.alpha", "baseline is FLOAT: expected FIXED") in has_reason(run, Reason.NOT_FIXED)
    assert ("light.alpha", "baseline is FLOAT: expected FIXED") in has_reason(run, Reason.NOT_FIXED)
    assert run.reasons(BEACONS)["not_fixed"] == 11
    assert {m.mode for m in run.pointings[20:]} == {Mode.ONE_LIGHT}
    assert {m.light_count for m in run.pointings[20:]} == {1}
    assert is_within_covariance(run)


def test_no_solution_is_not_fixed_whatever_its_numbers() -> None:
    def remove_fix(message: Any) -> None:
        message.fix, message.enu.x = 0, np.nan

    run = run_adapter(new_adapter(), replace_message(session(), index_at(session(), ALPHA, CHANGE_S), remove_fix))
    assert run.reasons(ALPHA) == {"not_fixed": 1}
    # No exposure waits for another baseline, and no baselines are interpolated across this one.
    assert run.reasons(BEACONS).keys() <= {"not_fixed"}
    assert is_within_covariance(run)


def test_float_is_used_if_allowed() -> None:
    floating = change_where(session(), lambda a: a.topic == ALPHA, set_field("fix", 3))
    assert run_adapter(new_adapter(least_fix="float"), floating).state() == fault_free_run().state()


def test_hidden_beacon_leaves_the_other() -> None:
    def hide(message: Any) -> None:
        message.beacons = [make_sighting(message, "bravo")]

    run = run_adapter(new_adapter(), change_where(session(), lambda a: a.topic == BEACONS, hide))
    assert {m.mode for m in run.pointings[20:]} == {Mode.ONE_LIGHT}
    assert {m.status for m in run.pointings[20:]} == {Status.VALID}
    assert run.reasons(BEACONS) == {}
    assert max(error_in_sigmas(message) for message in run.pointings) < 4.0


def test_image_without_beacons_is_valid() -> None:
    dark = change_where(session(), lambda a: a.topic == BEACONS, set_field("beacons", []))
    run = run_adapter(new_adapter(), dark)
    assert run.health(BEACONS).accepted == 12
    assert {m.mode for m in run.pointings} == {Mode.ENCODER}
    assert {m.status for m in run.pointings} == {Status.DEGRADED}
    assert np.isnan(run.pointings[-1].telescope_azimuth)


@pytest.mark.parametrize(
    ("change", "reason", "text"),
    [
        (set_field("beacon_id", "charlie"), Reason.UNKNOWN_SENSOR, "'charlie' is unknown: expected alpha, bravo"),
        (set_field("x", np.nan), Reason.NON_FINITE, "x, z holds nan"),
        (set_field("x", 5.0), Reason.UNITS, "expected metres on the detector"),
        (set_field("sigma", -1.0), Reason.BAD_COVARIANCE, "positive"),
    ],
)
def test_unreadable_beacon_is_rejected(change: Change, reason: Reason, text: str) -> None:
    index = index_at(session(), BEACONS, CHANGE_S)

    def spoil(message: Any) -> None:
        change(make_sighting(message, "alpha"))

    def leave_out(message: Any) -> None:
        message.beacons = [make_sighting(message, "bravo")]

    run = run_adapter(new_adapter(), replace_message(session(), index, spoil))
    ((source, reason_text),) = has_reason(run, reason)
    assert source.startswith("light.")
    assert text in reason_text
    assert run.reasons(BEACONS) == {reason.name.lower(): 1}
    assert run.state() == run_adapter(new_adapter(), replace_message(session(), index, leave_out)).state()


def test_duplicate_beacon_name_is_rejected() -> None:
    def twice(message: Any) -> None:
        make_sighting(message, "alpha").beacon_id = "bravo"

    run = run_adapter(new_adapter(), replace_message(session(), index_at(session(), BEACONS, CHANGE_S), twice))
    assert run.reasons(BEACONS) == {"conflict": 2}
    assert is_within_covariance(run)


def test_baseline_of_another_drone_is_rejected() -> None:
    ids = {"beacons__alpha__rtk__rover_id": "alpha", "beacons__alpha__rtk__base_id": "ship"}
    index = index_at(session(), ALPHA, CHANGE_S)
    run = run_adapter(new_adapter(**ids), replace_message(session(), index, set_field("rover_id", "bravo")))
    assert has_reason(run, Reason.UNKNOWN_SENSOR) == [("baseline.alpha", "rover_id is 'bravo': expected 'alpha'")]
    assert run.state() == run_adapter(new_adapter(**ids), without(session(), index)).state()


def test_exchanged_baselines_are_a_conflict() -> None:
    """Exchanged baselines leave the angle between the lights unchanged, and exchanged light names are consistent."""
    other = {BASELINE["alpha"]: BASELINE["bravo"], BASELINE["bravo"]: BASELINE["alpha"]}
    crossed = tuple(Arrival(other.get(a.topic, a.topic), a.message, a.receive_ns) for a in session())
    run = run_adapter(new_adapter(), crossed)
    assert all(m.accepted for m in run.innovations(Reason.LIGHT_CONFLICT))
    assert run.reasons(BEACONS) == {"light_conflict": 11}
    assert is_within_covariance(run)


def test_a_baseline_one_second_late_is_applied_at_its_own_time() -> None:
    index = index_at(session(), ALPHA, CHANGE_S)
    late_ns = session()[index].receive_ns + SECOND_NS
    run = run_adapter(new_adapter(), replace_message(session(), index, lambda message: None, late_ns))
    assert run.state() == fault_free_run().state()
    assert run.health(ALPHA).rejected == 0


def test_baseline_later_than_the_lag_is_rejected() -> None:
    index = index_at(session(), ALPHA, CHANGE_S)
    late_ns = session()[index].receive_ns + SECOND_NS
    run = run_adapter(new_adapter(lag_s=0.5), replace_message(session(), index, lambda message: None, late_ns))
    assert run.reasons(ALPHA) == {"late": 1}
    ((source, text),) = has_reason(run, Reason.LATE)
    assert source == "baseline.alpha"
    assert "more than lag_s = 0.5" in text
    assert is_within_covariance(run)


def test_baselines_one_second_old_are_a_conflict() -> None:
    """A light that moves by 1.5°/s is 1.5° from its baseline's direction: excluded after three sightings."""
    stale = change_where(session(), lambda a: a.topic == ALPHA, shift_stamp(1.0))
    stale = sort_by_arrival(Arrival(a.topic, a.message, a.receive_ns + SECOND_NS * (a.topic == ALPHA)) for a in stale)
    run = run_adapter(new_adapter(), stale)
    rejected = run.innovations(Reason.LIGHT_CONFLICT)
    assert len(rejected) == 3
    assert not any(m.accepted for m in rejected)
    assert {m.source for m in run.innovations(Reason.EXCLUDED)} == {"light.alpha"}
    assert len(run.innovations(Reason.EXCLUDED)) >= 5
    assert (run.pointings[-1].status, run.pointings[-1].light_count) == (Status.VALID, 1)
    assert is_within_covariance(run)


def frozen_encoders(from_s: float, until_s: float) -> tuple[Arrival, ...]:
    """Return ten seconds with constant encoder readings in a time range."""
    value = session()[index_at(session(), ENCODER, from_s)].message

    def freeze(message: Any) -> None:
        message.azimuth, message.elevation = value.azimuth, value.elevation

    return change_where(session(10.0), lambda a: a.topic == ENCODER and from_s < seconds_of(a) < until_s, freeze)


def test_stuck_encoder_is_detected_by_beacons() -> None:
    run = run_adapter(new_adapter(), frozen_encoders(2.0, 10.0))
    stuck = has_reason(run, Reason.STUCK)
    assert {source for source, _ in stuck} == {"encoder"}
    assert "both encoders stuck" in stuck[0][1]
    assert run.reasons(BEACONS).keys() <= {"gate", "attitude_conflict", "gap"}
    wrong = [m for m in run.pointings if seconds(m) > 2.0 and m.status != Status.INVALID]
    assert {m.status for m in wrong} == {Status.DEGRADED}
    assert run.pointings[-1].status == Status.INVALID
    assert is_within_covariance(run)


def seconds_of(arrival: Arrival) -> float:
    return (arrival.stamp_ns - session()[0].stamp_ns) * 1e-9


def test_an_encoder_comes_back_after_twenty_changing_readings() -> None:
    run = run_adapter(new_adapter(integrity__return_after_s=1.0), frozen_encoders(2.0, 5.0))
    rejected = run.reasons(ENCODER)["stuck"]
    assert 20 < rejected < 60
    assert run.pointings[-1].status == Status.VALID
    assert is_within_covariance(run)


def test_encoder_in_degrees_is_rejected() -> None:
    def degrees(message: Any) -> None:
        message.azimuth, message.elevation = np.rad2deg(message.azimuth), np.rad2deg(message.elevation)

    run = run_adapter(new_adapter(), change_where(session(), lambda a: a.topic == ENCODER, degrees))
    assert run.reasons(ENCODER) == {"units": 120}
    assert {m.status for m in run.pointings} == {Status.INVALID}
    assert "degrees?" in has_reason(run, Reason.UNITS)[-1][1]

    # Later the axis happens to be at 4.7 and 0.5 degrees.
    def small(message: Any) -> None:
        message.azimuth, message.elevation = 4.7, 0.5

    later = change_where(session(), lambda a: a.topic == ENCODER and seconds_of(a) < 3.0, degrees)
    later = change_where(later, lambda a: a.topic == ENCODER and seconds_of(a) >= 3.0, small)
    run = run_adapter(new_adapter(), later)
    # After a run of such readings the readings are used, and the lights contradict them.
    assert {m.status for m in run.pointings} == {Status.INVALID, Status.DEGRADED}


def test_too_many_beacons_and_long_ids_are_cut() -> None:
    def crowd(message: Any) -> None:
        unknown = [copy.copy(make_sighting(message, "alpha")) for _ in range(MAX_BEACONS + 50)]
        for number, one in enumerate(unknown):
            one.beacon_id = f"{number}" + "x" * 10**5
        message.beacons = [*message.beacons, *unknown]

    run = run_adapter(new_adapter(), replace_message(session(), index_at(session(), BEACONS, CHANGE_S), crowd))
    unknown = has_reason(run, Reason.UNKNOWN_SENSOR)
    assert len(unknown) == MAX_BEACONS - 2
    assert max(len(text) for both in unknown for text in both) <= LONGEST_TEXT
    assert unknown[0][1].endswith("…' is unknown: expected alpha, bravo")
    ((_, text),) = has_reason(run, Reason.OVERFLOW)
    assert text == f"{MAX_BEACONS + 52} lights in one image: only the first {MAX_BEACONS} are used"
    assert run.state() == fault_free_run().state()


def test_covariances_that_are_not_given_are_not_perfect() -> None:
    def unknown(message: Any) -> None:
        for name in ("rotation_covariance", "covariance"):
            if hasattr(message, name):
                getattr(message, name)[:] = 0.0
        for holder in (message, *getattr(message, "beacons", [])):
            if hasattr(holder, "sigma"):
                holder.sigma = 0.0

    run = run_adapter(new_adapter(), change_where(session(), lambda a: a.topic not in IMU.values(), unknown))
    for topic in (ENCODER, SHIP, BEACONS, ALPHA):
        assert run.reasons(topic) == {"covariance_unknown": run.health(topic).received}
        assert run.health(topic).rejected == 0
    # The ship's attitude then has the INS's errors; the others have the configured sigmas, which equal those of the
    # messages. Only medians are compared: the separations of the subfilters vary with each sighting.
    of_each = ([m.rotation_covariance[0] for m in one.pointings] for one in (run, fault_free_run()))
    assert np.greater(*(np.median(covariance) for covariance in of_each))
    assert is_within_covariance(run)


def test_drone_without_covariance_is_used_if_accepted() -> None:
    imus = tuple(IMU.values())
    unset = change_where(session(), lambda a: a.topic in imus, set_field("orientation_covariance", -1.0))
    accepted = {f"beacons__{id_}__imu__accept_unset_covariance": True for id_ in IMU}
    run = run_adapter(new_adapter(**accepted), unset)
    assert all(run.health(topic).rejected == 0 for topic in imus)
    assert run.results() == fault_free_run().results()
    rejected = run_adapter(new_adapter(), unset)
    assert all(rejected.reasons(topic) == {"not_given": rejected.health(topic).received} for topic in imus)


def test_without_the_ship_no_pointing_is_claimed() -> None:
    gone = tuple(a for a in session() if a.topic != SHIP or seconds_of(a) < 3.0)
    run = run_adapter(new_adapter(), gone)
    last = run.pointings[-1]
    assert last.status == Status.INVALID
    assert np.isnan([last.azimuth, last.elevation, last.image_rotation, *last.covariance]).all()
    assert run.diagnostics("pointing", 0, run.now_ns)[-1] == (2, "INVALID: no attitude on ship/attitude")
    assert all(seconds(m) < 3.1 for m in run.pointings if m.status != Status.INVALID)


def test_covariance_grows_without_beacons() -> None:
    gone = tuple(a for a in session(10.0) if a.topic != BEACONS or seconds_of(a) < 4.0)
    run = run_adapter(new_adapter(), gone)
    modes = [m.mode for m in run.pointings]
    assert modes[-1] == Mode.ENCODER
    assert run.pointings[-1].status == Status.COASTING
    trace = [np.trace(np.reshape(m.rotation_covariance, (3, 3))) for m in run.pointings if m.mode == Mode.ENCODER]
    assert trace[-1] > trace[-1 - len(trace) // 2]
    # At the change of mode, the error changes by no more than two readings may differ.
    first = modes.index(Mode.ENCODER, 40)
    assert abs(error_in_sigmas(run.pointings[first]) - error_in_sigmas(run.pointings[first - 1])) < 1.5
    assert is_within_covariance(run)
