"""The node star_attitude on a voyage under the real sky: attitudes compared with the truth, with and without an INS."""

import copy
import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.innovations.gates import chi_square_gate, mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import (
    angle_covariance,
    horizon_covariance,
    quaternion_from_rotation,
    rotation_from_angles,
    rotation_from_quaternion,
)
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_stars.attitude_from_stars.solution import SolutionStatus
from ship_stars.sky.catalogue import hipparcos
from ship_testing import small_voyage
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, change_where, exact_value, sort_by_arrival, stamp_of
from ship_testing.small_voyage import INS, Run, run_adapter
from ship_testing.star_voyage import (
    CAMERA_PARAMETERS,
    EXACT_OPTICS,
    FIX,
    FORE,
    HUMIDITY,
    LATENCY_NS,
    MAS,
    PERIOD_NS,
    PHASE_NS,
    PRESSURE,
    STARBOARD,
    STARS,
    TEMPERATURE,
    fault_free_run,
    new_adapter,
    observations,
    published_bytes,
    run_new_adapter,
    solution_rotation,
    true_deck,
    true_sensor,
    voyage,
    voyage_with_streaks,
    with_topics,
    without_topics,
)

SOLUTION = {FORE: "star/fore/solution", STARBOARD: "star/starboard/solution"}
JOINT = "star/joint/solution"
EXACT_MAS = 0.2
"""Limit of an attitude error, mas: twice the error of `RefreshedSky`."""


def error_n(message: Any, truth_n: FloatArray) -> FloatArray:
    return log_rotation(truth_n @ solution_rotation(message).T)


def since(message: Any) -> int:
    return stamp_of(message) - START_NS


def without_ins() -> tuple[Arrival, ...]:
    return without_topics(voyage(), INS)


def simultaneous(*counts: int) -> tuple[Arrival, ...]:
    """Return position, weather and simultaneous exposures of both sensors with ``counts`` stars each."""
    arrivals = list(with_topics(voyage(), FIX, PRESSURE, TEMPERATURE, HUMIDITY))
    for topic, count in zip((FORE, STARBOARD), counts, strict=True):
        for since_ns in range(PHASE_NS[FORE], SECOND_NS, PERIOD_NS):
            message = observations(topic, since_ns, count=STARS)
            message.stars = message.stars[:count]
            arrivals.append(Arrival(topic, message, START_NS + since_ns + LATENCY_NS))
    return sort_by_arrival(arrivals)


@pytest.mark.parametrize("topic", [FORE, STARBOARD])
def test_each_exposure_is_an_attitude_of_its_sensor_exact_to_the_chain(topic: str) -> None:
    exposures = [arrival.stamp_ns for arrival in with_topics(voyage(), topic)]
    solutions = fault_free_run().messages(SOLUTION[topic])
    assert [stamp_of(message) for message in solutions] == exposures
    for message in solutions:
        error = error_n(message, true_sensor(topic, since(message)))
        assert np.linalg.norm(error) < EXACT_MAS * MAS
        assert (message.status, message.star_count, message.rejected_count) == (SolutionStatus.VALID, STARS, 0)
        assert message.sensor_id == topic.split("/")[1]
        assert message.header.frame_id == f"star_{message.sensor_id}"
        assert message.residual_rms < 0.1 * MAS


def test_covariances_belong_together() -> None:
    for topic in (*SOLUTION.values(), JOINT):
        message = fault_free_run().messages(topic)[3]
        total_n = horizon_covariance(message.rotation_covariance.reshape(3, 3))
        noise_n = horizon_covariance(message.noise_covariance.reshape(3, 3))
        expected = angle_covariance(total_n, message.azimuth, message.elevation)
        np.testing.assert_allclose(message.covariance.reshape(3, 3), expected, rtol=1e-9)
        # Shared errors of the stars are added to the noise.
        assert np.linalg.eigvalsh(total_n - noise_n)[0] > -1e-6 * np.trace(total_n)
        assert np.trace(noise_n) < np.trace(total_n)


def test_errors_are_consistent_with_the_noise_covariance() -> None:
    run = run_new_adapter(voyage(noise=True))
    nees = [
        normalized_error_squared(
            error_n(message, true_sensor(topic, since(message))),
            horizon_covariance(message.noise_covariance.reshape(3, 3)),
        )
        for topic, name in SOLUTION.items()
        for message in run.messages(name)
    ]
    low, high = mean_nees_band(len(nees), 3)
    assert low < np.mean(nees) < high


def test_the_prior_selects_stars_and_does_not_change_the_attitude() -> None:
    without = run_new_adapter(without_ins())
    for name in SOLUTION.values():
        assert [exact_value(m) for m in without.messages(name)] == [
            exact_value(m) for m in fault_free_run().messages(name)
        ]


def covered_by_ins(messages: list[Any]) -> list[Any]:
    """Solutions of exposures fully covered by INS samples."""
    return [message for message in messages if 0.1 * SECOND_NS < since(message) < 2.85 * SECOND_NS]


@pytest.mark.parametrize("topic", [FORE, STARBOARD])
def test_streaks_give_the_attitude_at_the_middle_of_their_exposure(topic: str) -> None:
    streaks = covered_by_ins(run_new_adapter(voyage_with_streaks()).messages(SOLUTION[topic]))
    as_seen = covered_by_ins(run_new_adapter(without_topics(voyage_with_streaks(), INS)).messages(SOLUTION[topic]))
    points = covered_by_ins(fault_free_run().messages(SOLUTION[topic]))
    assert len(streaks) == len(points) >= 13

    def errors_arcsec(messages: list[Any]) -> FloatArray:
        return np.array([np.linalg.norm(error_n(m, true_sensor(topic, since(m)))) for m in messages]) / ARCSEC

    # INS noise of 1″ per sample causes noise of 0.4″ in each axis of the correction.
    assert np.sqrt(np.mean(errors_arcsec(streaks) ** 2)) < 1.0
    assert np.sqrt(np.mean(errors_arcsec(as_seen) ** 2)) > 5.0
    noise = [[np.trace(m.noise_covariance.reshape(3, 3)) for m in messages] for messages in (streaks, points)]
    assert np.mean(np.divide(*noise)) > 2.0


def test_without_the_ins_streaks_are_used_as_measured_and_this_is_reported() -> None:
    level, text, _ = status(run_new_adapter(without_topics(voyage_with_streaks(), INS)), "solution fore")
    assert level == 1
    assert "no rotation of the ship from ins/imu during the exposure of 0.2 s" in text
    assert "exposure" not in status(run_new_adapter(without_ins()), "solution fore")[1]


def test_an_exposure_that_the_ins_covers_in_part_is_not_solved() -> None:
    """The first exposure lasts from 87 ms before the first INS sample to 113 ms after that sample."""
    run = run_new_adapter(voyage_with_streaks())
    first, *others = run.messages(SOLUTION[FORE])
    assert (since(first), first.status) == (PHASE_NS[FORE], SolutionStatus.INVALID)
    assert {message.status for message in others} == {SolutionStatus.VALID}


@pytest.mark.parametrize("topic", [FORE, STARBOARD])
def test_without_the_ins_the_covariance_holds_the_unmeasured_rotation(topic: str) -> None:
    messages = run_new_adapter(without_topics(voyage_with_streaks(), INS)).messages(SOLUTION[topic])
    assert len(messages) >= 13
    for message in messages:
        error = error_n(message, true_sensor(topic, since(message)))
        covariance_n = horizon_covariance(message.rotation_covariance.reshape(3, 3))
        assert normalized_error_squared(error, covariance_n) < chi_square_gate(0.9999, 3)


def test_simultaneous_exposures_make_an_exact_deck_without_any_ins() -> None:
    run = run_new_adapter(simultaneous(STARS, STARS), use_ins=False)
    assert len(run.messages(JOINT)) == 5
    for message in run.messages(JOINT):
        assert np.linalg.norm(error_n(message, true_deck(since(message)))) < EXACT_MAS * MAS
        assert (message.star_count, message.status) == (2 * STARS, SolutionStatus.VALID)
        assert (message.sensor_id, message.header.frame_id) == ("joint", "deck")


def test_exposures_at_different_times_are_propagated_to_one_by_the_ins() -> None:
    joint = fault_free_run().messages(JOINT)
    # Each pair is solved once, at the time of the first exposure.
    assert [since(message) for message in joint] == list(range(PHASE_NS[FORE], 3 * SECOND_NS, PERIOD_NS))
    # Without correction, 64 ms of rolling would be up to 2.3°/s x 64 ms = 0.15° = 530″.
    moved = [
        log_rotation(true_deck(since(m)).T @ true_deck(since(m) + PHASE_NS[STARBOARD] - PHASE_NS[FORE])) for m in joint
    ]
    assert np.max(np.linalg.norm(moved, axis=-1)) > 300 * ARCSEC
    for message in joint:
        error = error_n(message, true_deck(since(message)))
        covariance_n = horizon_covariance(message.rotation_covariance.reshape(3, 3))
        assert normalized_error_squared(error, covariance_n) < chi_square_gate(0.9999, 3)
        assert message.star_count == 2 * STARS


def test_without_ins_exposures_at_different_times_are_not_joined_and_this_is_reported() -> None:
    run = run_new_adapter(without_ins())
    stamps = [stamp_of(message) for message in run.messages(JOINT)]
    assert len(stamps) == len(with_topics(voyage(), FORE, STARBOARD))
    assert stamps == sorted(stamps)
    assert {message.star_count for message in run.messages(JOINT)} == {STARS}
    assert status(run, "solution joint")[1].endswith("without ins/imu only exposures within 0.1 ms are joined")
    assert "without ins/imu" not in status(fault_free_run(), "solution joint")[1]


def test_the_deck_by_one_sensor_bears_the_error_of_its_mounting() -> None:
    run = run_new_adapter(without_topics(voyage(), STARBOARD))
    assert len(run.messages(JOINT)) == len(with_topics(voyage(), FORE))
    for message in run.messages(JOINT):
        assert np.linalg.norm(error_n(message, true_deck(since(message)))) < EXACT_MAS * MAS
        # The mounting sigma about the boresight is 20″; the noise of the stars is added.
        installation_n = horizon_covariance(message.rotation_covariance.reshape(3, 3))
        boresight_n = true_sensor(FORE, since(message))[:, 0]
        assert np.sqrt(boresight_n @ installation_n @ boresight_n) / ARCSEC == pytest.approx(21.8, abs=1.0)


def test_a_joint_solution_waits_no_longer_than_it_may() -> None:
    run = run_new_adapter(without_topics(voyage(), STARBOARD), joint__wait_s=0.5)
    since_ns = [time_ns - stamp_of(message) for time_ns, topic, message in run.published if topic == JOINT]
    waits_ns = [ns - LATENCY_NS for ns in since_ns]
    # A solution waits from the arrival of the exposure on; ticks come every 0.1 s.
    assert min(waits_ns) >= 0.5 * SECOND_NS
    assert max(waits_ns) < 0.6 * SECOND_NS
    both = [time_ns - stamp_of(message) for time_ns, topic, message in fault_free_run().published if topic == JOINT]
    assert max(both) == PHASE_NS[STARBOARD] - PHASE_NS[FORE] + LATENCY_NS


def test_one_star_in_each_of_two_sensors_is_an_attitude_of_the_deck_only() -> None:
    run = run_new_adapter(simultaneous(1, 1), use_ins=False)
    for name in SOLUTION.values():
        for message in run.messages(name):
            assert message.status == SolutionStatus.INVALID
            assert np.isnan([message.azimuth, message.elevation, message.roll, message.residual_rms]).all()
            assert np.isnan(np.concatenate([message.covariance, message.rotation_covariance])).all()
            assert (message.star_count, message.rejected_count) == (0, 0)
    for message in run.messages(JOINT):
        assert (message.status, message.star_count) == (SolutionStatus.UNVERIFIED, 2)
        assert np.linalg.norm(error_n(message, true_deck(since(message)))) < EXACT_MAS * MAS
    assert run.reasons(FORE) == {"too_few_stars": 5}
    assert {m.source for m in run.messages("star/innovation")} == {"star.fore", "star.starboard"}


def test_with_the_ins_two_stars_are_enough_to_be_sure() -> None:
    ins = (arrival for arrival in with_topics(voyage(), INS) if arrival.receive_ns < START_NS + 2 * SECOND_NS)
    arrivals = sort_by_arrival([*simultaneous(1, 1), *ins])
    joint = run_new_adapter(arrivals).messages(JOINT)
    assert {(message.status, message.star_count) for message in joint} == {(SolutionStatus.VALID, 2)}


def ins_samples_with_rotation(heading_deg: float) -> tuple[Arrival, ...]:
    turn = rotation_from_angles(np.deg2rad(heading_deg), 0.0, 0.0)

    def change(message: Any) -> None:
        o = message.orientation
        rotation_nd = turn @ rotation_from_quaternion(np.array([o.x, o.y, o.z, o.w]))
        o.x, o.y, o.z, o.w = quaternion_from_rotation(rotation_nd).tolist()

    return change_where(voyage(), lambda arrival: arrival.topic == INS, change)


def test_an_ins_that_contradicts_all_stars_does_not_reject_them() -> None:
    run = run_new_adapter(ins_samples_with_rotation(90.0))
    for topic, name in SOLUTION.items():
        for message in run.messages(name):
            assert message.status == SolutionStatus.VALID
            assert np.linalg.norm(error_n(message, true_sensor(topic, since(message)))) < EXACT_MAS * MAS
    level, text, _ = status(run, "solution fore")
    assert level == 1
    assert "not with ins/imu" in text


def without_identities(arrivals: tuple[Arrival, ...]) -> tuple[Arrival, ...]:
    def change(message: Any) -> None:
        for star in message.stars:
            star.catalogue_id = 0

    return change_where(arrivals, lambda arrival: arrival.topic in SOLUTION, change)


def test_stars_without_a_name_are_identified_by_the_ins() -> None:
    run = run_new_adapter(without_identities(voyage()))
    for topic, name in SOLUTION.items():
        for message in run.messages(name):
            assert message.star_count + message.rejected_count == STARS
            assert message.star_count >= STARS - 2
            assert np.linalg.norm(error_n(message, true_sensor(topic, since(message)))) < EXACT_MAS * MAS


def test_a_detection_without_a_name_is_not_given_that_of_another() -> None:
    def double(message: Any) -> None:
        again = copy.deepcopy(message.stars[0])
        again.catalogue_id, again.u = 0, again.u + 0.05
        message.stars.append(again)

    run = run_new_adapter(change_where(voyage(), lambda arrival: arrival.topic == FORE, double))
    for message in run.messages(SOLUTION[FORE]):
        assert (message.star_count, message.rejected_count) == (STARS, 1)
    assert run.reasons(FORE) == {"unidentified": len(with_topics(voyage(), FORE))}
    assert "matched by two detections" in run.messages("star/innovation")[0].reason_text


def test_without_a_name_and_without_an_ins_there_is_no_solution() -> None:
    run = run_new_adapter(without_identities(without_ins()))
    assert {message.status for message in run.messages(SOLUTION[FORE])} == {SolutionStatus.INVALID}
    exposures = len(with_topics(voyage(), FORE))
    assert run.reasons(FORE) == {"unidentified": STARS * exposures, "too_few_stars": exposures}


def test_a_star_given_by_its_direction_counts_like_one_of_the_catalogue() -> None:
    catalogue = hipparcos()

    def change(message: Any) -> None:
        for star in message.stars:
            (row,) = catalogue.rows([star.catalogue_id])
            # The sensor sends positions with the proper motion of 23.87 years since J2000.
            listed = catalogue.at_j2000[row]
            star.right_ascension = listed.right_ascension + 23.87 * listed.pm_right_ascension
            star.declination = listed.declination + 23.87 * listed.pm_declination
            star.catalogue_id = 0

    run = run_new_adapter(change_where(without_ins(), lambda arrival: arrival.topic in SOLUTION, change))
    for message in run.messages(SOLUTION[FORE]):
        # The sent positions lack parallaxes: up to 0.1″ for the nearest stars.
        assert np.linalg.norm(error_n(message, true_sensor(FORE, since(message)))) < 0.1 * ARCSEC
        assert message.star_count == STARS


def test_the_budget_is_the_covariance_of_the_joint_solution_by_source() -> None:
    budgets = fault_free_run().messages("star/joint/error_budget")
    assert len(budgets) == 3  # once a second
    joint = {stamp_of(message): message for message in fault_free_run().messages(JOINT)}
    for budget in budgets:
        assert (budget.quantity, budget.header.frame_id) == ("star_joint", "deck")
        assert budget.sources == [
            "star_noise", "installation", "refraction", "earth_rotation", "ship_position", "catalogue", "optics",
        ]  # fmt: skip
        np.testing.assert_allclose(np.reshape(budget.covariances, (7, 9)).sum(axis=0), budget.total, rtol=1e-9)
        np.testing.assert_array_equal(budget.total, joint[stamp_of(budget)].rotation_covariance)


def test_with_a_utc_sigma_the_budget_has_its_entry_and_all_else_is_the_same() -> None:
    found = run_new_adapter(voyage(), sky__utc_sigma_s=0.1).messages("star/joint/error_budget")
    for budget, without in zip(found, fault_free_run().messages("star/joint/error_budget"), strict=True):
        assert budget.sources == [*without.sources, "utc"]
        parts = np.reshape(budget.covariances, (8, 9))
        np.testing.assert_allclose(parts.sum(axis=0), budget.total, rtol=1e-9)
        np.testing.assert_allclose(parts[:-1], np.reshape(without.covariances, (7, 9)), rtol=1e-6, atol=1e-18)
        # 0.1 s at 15.04″/s are 1.504″ about the Earth's axis, for any stars.
        assert np.sqrt(np.trace(parts[-1].reshape(3, 3))) / ARCSEC == pytest.approx(1.504, rel=1e-3)


def test_old_budgets_are_not_repeated() -> None:
    run = run_adapter(new_adapter(), voyage(), until_ns=START_NS + 10 * SECOND_NS)
    assert len(run.messages("star/joint/error_budget")) == 3


def test_any_order_within_the_lag_gives_the_same_attitudes_of_the_sensors() -> None:
    delayed = tuple(
        replace(a, receive_ns=a.receive_ns + (900_000_000 if a.topic == FORE and index % 2 else 0))
        for index, a in enumerate(voyage())
    )
    run = run_new_adapter(sort_by_arrival(delayed))
    for name in SOLUTION.values():
        by_stamp = {stamp_of(m): solution_rotation(m) for m in run.messages(name)}
        for message in fault_free_run().messages(name):
            np.testing.assert_array_equal(by_stamp[stamp_of(message)], solution_rotation(message))
    joint = [stamp_of(m) for m in run.messages(JOINT)]
    assert all(b > a for a, b in itertools.pairwise(joint))
    assert run.reasons(FORE)["late"] > 0
    assert all("joint" in m.reason_text for m in run.messages("star/innovation") if m.reason == Reason.LATE)


def test_no_exposure_is_in_two_joint_solutions() -> None:
    for run in (fault_free_run(), run_new_adapter(without_ins())):
        used = sum(message.star_count for message in run.messages(JOINT))
        assert used == STARS * len(with_topics(voyage(), FORE, STARBOARD))


def test_after_the_clock_went_back_it_restarts_with_the_same_results() -> None:
    adapter = new_adapter()
    first = run_adapter(adapter, voyage())
    adapter.clock_jumped_back(voyage()[0].receive_ns)
    second = run_adapter(adapter, voyage())
    assert published_bytes(second) == published_bytes(first)
    assert status(second, "sky")[2]["clock jumps back"] == "1"


def test_reset_discards_the_position() -> None:
    adapter = new_adapter()
    run_adapter(adapter, voyage())
    assert adapter.service("reset", START_NS + 4 * SECOND_NS).success
    again = run_adapter(adapter, with_topics(voyage(), FORE))
    assert {message.status for message in again.messages(SOLUTION[FORE])} == {SolutionStatus.INVALID}


def test_sigma_of_the_centroid_changes_while_it_runs() -> None:
    def change(message: Any) -> None:
        for star in message.stars:
            star.sigma_px = 0.0

    exposures = change_where(voyage(), lambda arrival: arrival.topic in SOLUTION, change)
    # With exact optics the noise of the attitude is in proportion to that of the centroids.
    before, adapter = run_adapter(new_adapter(**EXACT_OPTICS), voyage()), new_adapter(**EXACT_OPTICS)
    adapter.set_parameters({"star_sensors.fore.camera.centroid_sigma_px": 0.08})
    run = run_adapter(adapter, exposures)
    fore, starboard = (
        np.trace(run.messages(name)[0].noise_covariance.reshape(3, 3))
        / np.trace(before.messages(name)[0].noise_covariance.reshape(3, 3))
        for name in SOLUTION.values()
    )
    assert fore == pytest.approx(4.0, rel=1e-3)
    assert starboard == pytest.approx(1.0, rel=1e-3)
    assert run.reasons(FORE) == {"covariance_unknown": len(with_topics(voyage(), FORE))}
    with pytest.raises(ParameterError, match="cannot be changed"):
        adapter.set_parameters({"star_sensors.fore.azimuth_deg": 1.0})


def test_a_sensor_must_not_be_called_joint() -> None:
    with pytest.raises(ParameterError, match=r"'star_sensors\.joint': 'joint' is reserved for all sensors"):
        new_adapter(star_sensors__joint={"azimuth_deg": 1.0, "elevation_deg": 2.0, "camera": camera()})
    # With star/joint/solution in addition to those of the sensors, ship_attitude would count every star twice.
    with pytest.raises(ParameterError, match=r"'star_sensors\.joint': 'joint' is reserved for all sensors"):
        small_voyage.config(star_sensors__joint={"azimuth_deg": 1.0, "elevation_deg": 2.0, "input": "solution"})


def test_a_sensor_needs_its_camera() -> None:
    given = camera()
    del given["focal_length_m"]
    with pytest.raises(ParameterError, match=r"'star_sensors\.fore\.camera\.focal_length_m' .* must be given"):
        new_adapter(star_sensors__fore__camera=given)


def camera() -> dict[str, float]:
    return copy.deepcopy(CAMERA_PARAMETERS)


def status(run: Run, name: str) -> tuple[int, str, dict[str, str]]:
    """Return level, text and values of the last diagnostic status ``name``."""
    report = [message for _, topic, message in run.published if topic == "/diagnostics"][-1]
    (found,) = [entry for entry in report.status if entry.name == f"star_attitude: {name}"]
    return found.level, found.message, {value.key: value.value for value in found.values}


def test_an_old_solution_is_reported_as_timed_out() -> None:
    """Exposures end; the last solutions were VALID."""
    run = run_adapter(new_adapter(), voyage(), until_ns=voyage()[-1].receive_ns + 15 * SECOND_NS)
    for name in ("solution fore", "solution joint"):
        reports = run.diagnostics(name, run.now_ns - 14 * SECOND_NS, run.now_ns)
        assert reports[0] == (0, "VALID")
        level, text = reports[-1]
        assert level == 1
        assert text.startswith("no solution for 1")
        assert text.endswith(" s, last status VALID")
