"""``ship_attitude`` with single stars: its attitude compared with the truth, and all bad inputs of star_attitude."""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import horizon_covariance, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_stars.attitude_samples import Horizon
from ship_testing.adapter_runs import (
    FACTORY,
    SECOND_NS,
    START_NS,
    Arrival,
    change_where,
    exact_value,
    index_at,
    replace_message,
    sort_by_arrival,
    stamp_of,
    without,
)
from ship_testing.ship_observations import SENSORS, config, run_new_adapter
from ship_testing.small_voyage import INS, Run, ins_message
from ship_testing.star_bad_input import REJECTED_MESSAGES, REJECTED_STARS, SOURCE, Change, remove_star, set_star_fields
from ship_testing.star_voyage import (
    FIX,
    FORE,
    HEADING_DEG,
    PRESSURE,
    STARBOARD,
    TEMPERATURE,
    true_deck,
    voyage,
    voyage_with_streaks,
    with_topics,
    without_topics,
)

CHANGE_S = 1.5
SHIP_TOPICS = ("ship/attitude", "ship/imu", "ship/alignment", "ship/error_budget", "ship/error_arcsec")


@functools.cache
def clean_run() -> Run:
    return run_new_adapter(voyage())


@functools.cache
def run_without(topic: str) -> Run:
    return run_new_adapter(without(voyage(), index_at(voyage(), topic, CHANGE_S)))


def outputs(run: Run) -> list[Any]:
    return [(ns, topic, exact_value(message)) for ns, topic, message in run.published if topic in SHIP_TOPICS]


def last_valid(run: Run) -> Any:
    return next(m for m in reversed(run.messages("ship/attitude")) if m.status == Status.VALID)


def attitude_statuses(run: Run) -> set[int]:
    """Return the statuses of all attitudes without INVALID, the status before the first INS sample."""
    return {message.status for message in run.messages("ship/attitude")} - {Status.INVALID}


def error_of(message: Any) -> np.ndarray:
    orientation = message.orientation
    rotation_nd = rotation_from_quaternion(np.array([orientation.x, orientation.y, orientation.z, orientation.w]))
    since_ns = message.header.stamp.sec * SECOND_NS + message.header.stamp.nanosec - START_NS
    return log_rotation(true_deck(since_ns) @ rotation_nd.T)


def test_the_attitude_is_the_true_one_within_its_sigma() -> None:
    message = last_valid(clean_run())
    assert message.horizon == Horizon.GEODETIC
    assert list(message.sources) == ["ins", "star.fore", "star.starboard"]
    sigma = np.sqrt(np.diagonal(np.array(message.rotation_covariance).reshape(3, 3)))
    # The stars have no noise and no mounting error: only the noise of the INS remains.
    assert np.linalg.norm(error_of(message)) < 3.0 * np.max(sigma) < 15.0 * ARCSEC


def test_the_budget_names_the_errors_shared_by_stars() -> None:
    budget = clean_run().messages("ship/error_budget")[-1]
    parts = dict(zip(budget.sources, np.array(budget.covariances).reshape(-1, 3, 3), strict=True))
    for name in ("refraction", "earth_rotation", "ship_position", "star_noise"):
        assert np.trace(parts[name]) > 0.0, name
    np.testing.assert_allclose(sum(parts.values()), np.array(budget.total).reshape(3, 3), rtol=1e-9)


def test_with_a_utc_sigma_its_error_is_a_state_with_its_own_budget_entry() -> None:
    budget = run_new_adapter(voyage(), sky={"utc_sigma_s": 0.1}).messages("ship/error_budget")[-1]
    assert "utc" not in clean_run().messages("ship/error_budget")[-1].sources
    parts = dict(zip(budget.sources, np.array(budget.covariances).reshape(-1, 3, 3), strict=True))
    np.testing.assert_allclose(sum(parts.values()), np.array(budget.total).reshape(3, 3), rtol=1e-9)
    # 0.1 s are 1.504″ about the Earth's axis. The INS, which does not depend on UTC, reduces the error a little.
    assert 1.2 < np.sqrt(np.trace(parts["utc"])) / ARCSEC < 1.505


@pytest.mark.parametrize(
    ("topic", "change", "reason", "text"), [c[1:] for c in REJECTED_MESSAGES], ids=[c[0] for c in REJECTED_MESSAGES]
)
def test_a_bad_message_is_reported_and_changes_nothing(topic: str, change: Change, reason: str, text: str) -> None:
    run = run_new_adapter(replace_message(voyage(), index_at(voyage(), topic, CHANGE_S), change))
    assert outputs(run) == outputs(run_without(topic))
    assert run.reasons(topic) == {reason: 1}
    (innovation,) = run.innovations(Reason[reason.upper()])
    assert innovation.source == SOURCE[topic]
    assert text in innovation.reason_text


@pytest.mark.slow
@pytest.mark.parametrize(("change", "reason"), [s[1:3] for s in REJECTED_STARS], ids=[s[0] for s in REJECTED_STARS])
def test_a_bad_star_alone_is_rejected(change: Change, reason: Reason) -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    run, lacking = (
        run_new_adapter(replace_message(voyage(), index, change)),
        run_new_adapter(replace_message(voyage(), index, remove_star(3))),
    )
    assert outputs(run) == outputs(lacking)
    assert run.reasons(FORE) == {reason.name.lower(): 1}
    assert len(run.innovations(reason)) == 1


def test_a_false_star_is_named_with_its_angle() -> None:
    index = index_at(voyage(), FORE, CHANGE_S)
    run = run_new_adapter(replace_message(voyage(), index, set_star_fields(3, u=100.0)))
    (innovation,) = run.innovations(Reason.MISIDENTIFIED)
    assert "from its expected direction, sigma" in innovation.reason_text
    assert not innovation.accepted
    assert run.health(FORE).rejected == 0


def test_without_a_fix_no_star_is_used_and_the_ins_continues() -> None:
    run = run_new_adapter(without_topics(voyage(), FIX))
    assert run.reasons(FORE) == {"no_fix": run.health(FORE).received}
    assert attitude_statuses(run) == {Status.DEGRADED}
    assert "check that gnss/fix is published" in run.innovations(Reason.NO_FIX)[0].reason_text


def test_a_fix_older_than_a_minute_is_none() -> None:
    """Fixes end a minute before the stars begin."""

    def set_older_stamp(message: Any) -> None:
        message.header.stamp.sec -= 64

    run = run_new_adapter(change_where(voyage(), lambda arrival: arrival.topic == FIX, set_older_stamp))
    assert set(run.reasons(FORE)) == {"no_fix"}
    assert "more than fix_max_age_s = 60" in run.innovations(Reason.NO_FIX)[-1].reason_text


def test_without_weather_refraction_is_less_well_known() -> None:
    def refraction(run: Run) -> float:
        budget = run.messages("ship/error_budget")[-1]
        parts = dict(zip(budget.sources, np.array(budget.covariances).reshape(-1, 3, 3), strict=True))
        return float(np.trace(parts["refraction"]))

    run = run_new_adapter(without_topics(voyage(), PRESSURE, TEMPERATURE))
    assert last_valid(run).status == Status.VALID
    # A field of 23° makes much of the refraction observable: low stars are raised more than high ones.
    assert refraction(run) > 2.0 * refraction(clean_run())


def test_a_camera_is_needed() -> None:
    with pytest.raises(ParameterError, match=r"star_sensors\.fore\.camera\.focal_length_m"):
        run_new_adapter((), star_sensors={"fore": {"azimuth_deg": 0.0, "elevation_deg": 45.0, "input": "observations"}})


def test_solutions_of_a_sensor_that_gives_its_stars_are_no_input() -> None:
    """Only the configured input of a sensor is subscribed to, of several that are possible."""
    topics = {entry.topic for entry in ShipAttitudeAdapter(config(), FACTORY).inputs}
    assert FORE in topics
    assert not {"star/fore/solution", "star/fore/horizon_attitude", "star/fore/inertial_attitude"} & topics


@pytest.mark.parametrize("arrivals", [voyage, voyage_with_streaks])
def test_after_an_ins_timeout_the_attitude_comes_from_stars_alone(arrivals: Callable[[], tuple[Arrival, ...]]) -> None:
    cut_ns = START_NS + SECOND_NS
    run = run_new_adapter([a for a in arrivals() if a.topic != INS or a.receive_ns < cut_ns])
    alone = [m for m in run.messages("ship/attitude") if list(m.sources) in (["star.fore"], ["star.starboard"])]
    assert alone
    assert all(m.status == Status.DEGRADED for m in alone)
    for message in alone:
        error, covariance = error_of(message), np.array(message.rotation_covariance).reshape(3, 3)
        east_north_up = error[[2, 0, 1]]
        # Chi² with three degrees of freedom: 30 is one in a million.
        assert east_north_up @ np.linalg.solve(covariance, east_north_up) < 30.0


def test_clouds_are_no_fault() -> None:
    """A working sensor without stars sends empty messages; nothing is rejected."""

    def clouds(message: Any) -> None:
        message.stars = []

    run = run_new_adapter(change_where(voyage(), lambda arrival: arrival.topic in (FORE, STARBOARD), clouds))
    assert run.reasons(FORE) == {}
    assert run.health(FORE).accepted == run.health(FORE).received
    assert attitude_statuses(run) == {Status.DEGRADED}


def test_one_sensor_alone_is_enough_to_be_valid() -> None:
    run = run_new_adapter(with_topics(voyage(), INS, FORE, FIX, PRESSURE, TEMPERATURE))
    assert list(last_valid(run).sources) == ["ins", "star.fore"]


EXACT_INS = {
    "frame_id": "ins",
    "tilt_sigma_arcsec": 0.0,
    "heading_sigma_arcsec": 0.0,
    "white_sigma_arcsec": 0.0,
    "time_offset_sigma_s": 0.0,
}
EXACT_SENSOR = {f"installation_sigma_{axis}_arcsec": 0.0 for axis in ("forward", "up", "right")}


def test_an_exact_prior_can_be_compared_with_stars(monkeypatch: pytest.MonkeyPatch) -> None:
    """The predicted attitude has zero covariance and still selects stars: all sigmas of INS and mounting are 0."""
    monkeypatch.setattr("ship_testing.small_voyage._INS_ERROR_N", np.zeros(3))
    monkeypatch.setattr("ship_testing.small_voyage._TAU_S", 0.0)
    exact = [
        replace(a, message=ins_message(a.stamp_ns - START_NS, HEADING_DEG, np.zeros(3))) if a.topic == INS else a
        for a in voyage(noise=True)
    ]
    sensors = {id_: {**sensor, **EXACT_SENSOR} for id_, sensor in SENSORS.items()}
    run = run_new_adapter(exact, ins=EXACT_INS, star_sensors=sensors)
    assert run.reasons(FORE) == run.reasons(STARBOARD) == {}
    assert run.health(FORE).accepted == run.health(FORE).received
    assert last_valid(run) is run.messages("ship/attitude")[-1]
    # The same stars are selected as by any other prediction.
    wrong = replace_message(exact, index_at(exact, FORE, CHANGE_S), set_star_fields(3, u=100.0))
    (innovation,) = run_new_adapter(wrong, ins=EXACT_INS, star_sensors=sensors).innovations(Reason.MISIDENTIFIED)
    assert "from its expected direction, sigma" in innovation.reason_text


def test_an_ins_with_errors_and_zero_sigma_is_in_conflict() -> None:
    sensors = {id_: {**sensor, **EXACT_SENSOR} for id_, sensor in SENSORS.items()}
    run = run_new_adapter(voyage(), ins=EXACT_INS, star_sensors=sensors)
    assert set(run.reasons(FORE)) == {"gate", "attitude_conflict"}


def test_streaks_wait_for_the_ins_and_any_order_of_arrival_gives_the_same_state() -> None:
    """Stars arrive at once or a second late; one INS sample, in the middle of an exposure, arrives at once or late."""
    states = []
    for star_delay_s, ins_delay_s in ((0.001, 0.001), (1.0, 0.001), (0.001, 0.3)):
        arrivals = [
            replace(a, receive_ns=a.stamp_ns + round((star_delay_s if a.topic in (FORE, STARBOARD) else 0.001) * 1e9))
            for a in voyage_with_streaks()
        ]
        late = index_at(arrivals, INS, CHANGE_S)
        arrivals[late] = replace(arrivals[late], receive_ns=arrivals[late].stamp_ns + round(ins_delay_s * 1e9))
        run = run_new_adapter(sort_by_arrival(arrivals))
        assert set(run.reasons(FORE)) <= {"gap", "revised"}
        state = run.adapter.core.state
        states.append((state.mean.tobytes(), state.covariance_by_source.tobytes()))
    assert states[1] == states[0]
    assert states[2] == states[0]


def test_the_ship_attitude_by_streaks_is_consistent_with_its_covariance() -> None:
    assert worst_sigmas(run_new_adapter(voyage_with_streaks())) < 2.5

    def hide_length(message: Any) -> None:
        message.exposure_s = np.nan

    as_points = change_where(voyage_with_streaks(), lambda a: a.topic in (FORE, STARBOARD), hide_length)
    assert worst_sigmas(run_new_adapter(as_points)) > 4.0


def worst_sigmas(run: Run) -> float:
    """Return the largest error of the attitudes after the first second, as the root of NEES / 3."""
    late = [m for m in run.messages("ship/attitude") if stamp_of(m) > START_NS + SECOND_NS]
    covariances_n = [horizon_covariance(m.rotation_covariance.reshape(3, 3)) for m in late]
    pairs = zip(late, covariances_n, strict=True)
    return max(float(np.sqrt(error_of(m) @ np.linalg.solve(cov, error_of(m)) / 3.0)) for m, cov in pairs)
