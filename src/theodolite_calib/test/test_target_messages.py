"""Images of targets through the adapter: directions at the image's time, bad images, timeouts, order of arrival."""

import functools
from typing import Any

import numpy as np
import pytest

from ship_bags.stamps import make_header
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import ENU_FROM_HORIZON
from ship_testing.adapter_runs import FACTORY, SECOND_NS, START_NS, Arrival, exact_value, sort_by_arrival, stamp_of
from ship_testing.small_session import ENCODER, LEVER_D, SHIP, Run, deck, mount_state, new_adapter, run_adapter, session

TARGET, DIRECTION = "theodolite/target", "theodolite/target_direction"
DETECTOR = {"main_detector__focal_length_m": 1.5, "main_detector__frame_id": "main_detector"}
DISTANCE_M, K, EARTH_RADIUS_M = 1500.0, 0.13, 6_371_000.0
FIRST_S, EVERY_S, LATENCY_S = 1.0231, 0.1, 0.06
NAN = float("nan")


def target_direction_n(t_s: float) -> np.ndarray:
    """Return the direction of a target that drifts slowly near the mount's line of sight."""
    line_of_sight = np.array([1.0, 0.004 * np.sin(t_s), 0.006])
    return mount_state(t_s)[2] @ (line_of_sight / np.linalg.norm(line_of_sight))


def path_n(t_s: float) -> np.ndarray:
    lowered = np.array([0.0, K * DISTANCE_M**2 / (2.0 * EARTH_RADIUS_M), 0.0])
    path: np.ndarray = DISTANCE_M * target_direction_n(t_s) - lowered
    return path


def image(t_s: float, **changes: Any) -> Any:
    """Return an image of a detector whose right side is down by 0.4 rad."""
    rho, seen_m = 0.4, mount_state(t_s)[2].T @ target_direction_n(t_s)
    up_v = seen_m @ [0.0, np.cos(rho), np.sin(rho)]
    right_v = seen_m @ [0.0, -np.sin(rho), np.cos(rho)]
    fields = {
        "target_id": "buoy",
        "x": -1.5 * right_v / seen_m[0],
        "z": -1.5 * up_v / seen_m[0],
        "sigma": 3e-6,
        "exposure_s": 0.0,
        "detector_rotation": rho,
        "range": float(np.linalg.norm(path_n(t_s))),
        "range_sigma": 0.1,
    }
    header = make_header(FACTORY, START_NS + round(t_s * SECOND_NS), changes.pop("frame_id", "main_detector"))
    return FACTORY.make("ship_msgs/msg/TargetImage", header=header, **{**fields, **changes})


def arrival_of(message: Any, latency_s: float = LATENCY_S) -> Arrival:
    return Arrival(TARGET, message, stamp_of(message) + round(latency_s * SECOND_NS))


@functools.cache
def images() -> tuple[Arrival, ...]:
    return tuple(arrival_of(image(t_s)) for t_s in np.arange(FIRST_S, 5.5, EVERY_S))


def run_of(*targets: Arrival, base: tuple[Arrival, ...] | None = None, **changes: Any) -> Run:
    base = session() if base is None else base
    return run_adapter(
        new_adapter(**{**DETECTOR, **changes}), sort_by_arrival((*base, *targets)), START_NS + 9 * SECOND_NS
    )


@functools.cache
def undisturbed_run() -> Run:
    return run_of(*images())


def outputs_without_targets(run: Run) -> list[Any]:
    return [result for result in run.results() if result[1] != DIRECTION]


def test_each_image_gets_its_direction_at_its_own_time() -> None:
    directions = undisturbed_run().messages(DIRECTION)
    assert [stamp_of(m) for m in directions] == [a.stamp_ns for a in images()]
    for message in directions:
        t_s = (stamp_of(message) - START_NS) * 1e-9
        found = np.array([message.direction.x, message.direction.y, message.direction.z])
        error = ENU_FROM_HORIZON @ target_direction_n(t_s) - found
        assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-12)
        covariance = np.array(message.direction_covariance).reshape(3, 3)
        sigma = np.sqrt(np.trace(covariance))
        # The pointing's own error in this session is within two sigmas; a direction of another time would be off by 1.5
        # deg per second.
        assert np.linalg.norm(error) < 3.0 * sigma < 2e-4
        north, east, up = found[1], found[0], found[2]
        np.testing.assert_allclose([message.azimuth, message.elevation], [np.arctan2(east, north), np.arcsin(up)])
        place = np.array([message.position.x, message.position.y, message.position.z])
        true_place = ENU_FROM_HORIZON @ (path_n(t_s) + deck(t_s) @ LEVER_D)
        place_sigma = np.sqrt(np.trace(np.array(message.position_covariance).reshape(3, 3)))
        assert np.linalg.norm(place - true_place) < 3.0 * place_sigma < 1.0
    assert undisturbed_run().health(TARGET).accepted == len(images())
    assert undisturbed_run().health(TARGET).rejected == 0


def test_direction_has_the_worst_status_of_adjacent_pointings() -> None:
    pointings = {stamp_of(m): m.status for m in undisturbed_run().pointings}
    times = sorted(pointings)
    statuses = set()
    for message in undisturbed_run().messages(DIRECTION):
        after = next(i for i, ns in enumerate(times) if ns >= stamp_of(message))
        assert message.status >= max(pointings[times[after - 1]], pointings[times[after]])
        statuses.add(message.status)
    assert Status.VALID in statuses


def test_images_change_no_other_output_to_the_last_bit() -> None:
    assert outputs_without_targets(undisturbed_run()) == run_of().results()


def test_degraded_ship_makes_it_degraded() -> None:
    base = tuple(
        Arrival(a.topic, _change_message(a.message, status=2), a.receive_ns) if a.topic == SHIP else a
        for a in session()
    )
    run = run_of(*images(), base=base)
    assert {m.status for m in run.messages(DIRECTION)} == {Status.DEGRADED}


def _change_message(message: Any, **fields: Any) -> Any:
    kept = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    return type(message)(**{**kept, **fields})


BAD: dict[str, tuple[Reason, dict[str, Any]]] = {
    "x is NaN": (Reason.NON_FINITE, {"x": NAN}),
    "rotation is NaN": (Reason.NON_FINITE, {"detector_rotation": NAN}),
    "exposure is infinite": (Reason.NON_FINITE, {"exposure_s": float("inf")}),
    "range is infinite": (Reason.NON_FINITE, {"range": float("inf")}),
    "millimetres": (Reason.UNITS, {"x": 3.0}),
    "degrees": (Reason.UNITS, {"detector_rotation": 90.0}),
    "range of zero": (Reason.UNITS, {"range": 0.0}),
    "exposure of a minute": (Reason.UNITS, {"exposure_s": 60.0}),
    "sigma below zero": (Reason.BAD_COVARIANCE, {"sigma": -1e-6}),
    "another detector": (Reason.FRAME, {"frame_id": "telescope"}),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_image_is_rejected_by_name_without_effect(kind: str) -> None:
    reason, fields = BAD[kind]
    run = run_of(*images(), arrival_of(image(2.05, **fields)))
    assert run.reasons(TARGET) == {reason.word: 1}
    assert run.results() == undisturbed_run().results()


def test_images_without_a_main_detector_are_rejected_with_advice() -> None:
    run = run_adapter(new_adapter(), sort_by_arrival((*session(), *images())), START_NS + 9 * SECOND_NS)
    assert run.messages(DIRECTION) == []
    assert run.reasons(TARGET) == {"unknown_sensor": len(images())}
    rejection = run.innovations(Reason.UNKNOWN_SENSOR)[0]
    assert rejection.source == "target"
    assert "main_detector.focal_length_m is not set" in rejection.reason_text


def test_an_unknown_range_gives_a_direction_and_no_place() -> None:
    run = run_of(arrival_of(image(2.05, range=NAN)), arrival_of(image(2.25, range_sigma=NAN)))
    for message in run.messages(DIRECTION):
        assert message.status == Status.VALID
        assert np.isfinite([message.azimuth, message.elevation, *message.covariance]).all()
        assert np.isnan([message.position.x, message.position.y, message.position.z]).all()
        assert np.isnan(message.position_covariance).all()


def test_the_same_image_again_is_a_duplicate_and_another_one_a_conflict() -> None:
    first = arrival_of(image(2.05))
    again = Arrival(TARGET, first.message, first.receive_ns + 1_000_000)
    run = run_of(first, again)
    assert run.reasons(TARGET) == {"duplicate": 1}
    assert [m.status for m in run.messages(DIRECTION)] == [Status.VALID]
    other = Arrival(TARGET, image(2.05, x=0.001), first.receive_ns + 1_000_000)
    run = run_of(first, other, arrival_of(image(2.25)))
    assert run.reasons(TARGET) == {"conflict": 1}
    # The detector has sent conflicting images of one time: for ten seconds none of its directions is VALID.
    assert [m.status for m in run.messages(DIRECTION)][-1] == Status.DEGRADED


def test_two_targets_in_one_exposure_are_two_directions() -> None:
    run = run_of(arrival_of(image(2.05)), arrival_of(image(2.05, target_id="mast", x=0.001)))
    assert {m.target_id for m in run.messages(DIRECTION)} == {"buoy", "mast"}


@pytest.mark.parametrize(("latency_s", "reason"), [(1.5, None), (2.5, "late")])
def test_a_late_image_is_answered_at_its_own_time_within_the_lag(latency_s: float, reason: str | None) -> None:
    run = run_of(arrival_of(image(2.05), latency_s))
    directions = run.messages(DIRECTION)
    if reason is not None:
        assert (directions, run.reasons(TARGET)) == ([], {reason: 1})
        return
    (message,) = directions
    found = np.array([message.direction.x, message.direction.y, message.direction.z])
    assert np.linalg.norm(ENU_FROM_HORIZON @ target_direction_n(2.05) - found) < 2e-4


@pytest.mark.parametrize(("topic", "text"), [(ENCODER, "no encoder readings"), (SHIP, "no attitudes of the ship")])
def test_image_without_pointing_is_invalid_and_reported(topic: str, text: str) -> None:
    """Without data the image waits for the lag; then INVALID with NaN is published, and the reason is in health."""
    base = tuple(a for a in session() if not (a.topic == topic and a.stamp_ns > START_NS + 3 * SECOND_NS))
    run = run_of(arrival_of(image(2.05)), arrival_of(image(4.05)), base=base)
    first, invalid = sorted(run.messages(DIRECTION), key=stamp_of)
    assert (first.status, invalid.status) == (Status.VALID, Status.INVALID)
    numbers = [invalid.azimuth, invalid.elevation, *invalid.covariance, invalid.direction.x, invalid.position.x]
    assert np.isnan([*numbers, *invalid.direction_covariance, *invalid.position_covariance]).all()
    assert run.reasons(TARGET) == {"gap": 1}
    assert text in run.innovations(Reason.GAP)[0].reason_text


def test_flood_is_bounded_and_its_oldest_are_rejected() -> None:
    base = tuple(a for a in session() if a.stamp_ns < START_NS + 3 * SECOND_NS)
    flood = [arrival_of(image(3.5, target_id=f"t{number}"), 0.01) for number in range(1100)]
    run = run_of(*flood, base=base)
    assert run.reasons(TARGET)["overflow"] == 100
    assert len(run.messages(DIRECTION)) == 1000


def test_the_order_in_which_images_come_does_not_matter() -> None:
    targets = [arrival_of(image(t_s)) for t_s in (2.05, 2.15, 2.25)]
    last_ns = targets[-1].receive_ns + 200_000_000
    backwards = [Arrival(TARGET, a.message, last_ns - i) for i, a in enumerate(targets)]
    in_turn = [Arrival(TARGET, a.message, last_ns + i) for i, a in enumerate(targets)]
    found = [
        sorted((exact_value(m) for m in run_of(*arrivals).messages(DIRECTION)), key=repr)
        for arrivals in (in_turn, backwards)
    ]
    assert found[0] == found[1]
