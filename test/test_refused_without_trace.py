"""Rejected malformed messages have no effect: all outputs are bit-equal to those without them.

For each input topic of each node and each defect in :data:`UNUSABLE`, a defective message follows every valid message.
Only health, innovations and diagnostics report the defective messages.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_testing.adapter_runs import (
    SECOND_NS,
    Arrival,
    Arrivals,
    changed_copy,
    flood_topic,
    sort_by_arrival,
    without_rejected,
)
from ship_testing.every_input import NODES, fault_free_run, topics, voyage
from ship_testing.message_values import type_name_of

Change = Callable[[Arrival], Arrival]

FIRST_NUMBER = {
    "sensor_msgs/msg/Imu": "orientation.x",
    "ship_msgs/msg/ShipAttitude": "orientation.x",
    "ship_msgs/msg/StarInertialAttitude": "orientation.x",
    "ship_msgs/msg/StarHorizonAttitude": "azimuth",
    "ship_msgs/msg/StarObservationArray": "exposure_s",
    "sensor_msgs/msg/NavSatFix": "latitude",
    "sensor_msgs/msg/FluidPressure": "fluid_pressure",
    "sensor_msgs/msg/Temperature": "temperature",
    "sensor_msgs/msg/RelativeHumidity": "relative_humidity",
    "ship_msgs/msg/TheodoliteEncoder": "azimuth",
    "ship_msgs/msg/BeaconImage": "exposure_s",
    "ship_msgs/msg/RtkBaseline": "enu.x",
    "ship_msgs/msg/TargetImage": "x",
    "ship_msgs/msg/TargetDirection": "direction.x",
}
"""Message type → number that every message of this type must have."""


def with_stamp(time_ns: Callable[[Arrival], int]) -> Change:
    """Return a change that gives a message another stamp."""

    def change(arrival: Arrival) -> Arrival:
        def change_message(message: Any) -> None:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns(arrival), SECOND_NS)

        return changed_copy(arrival, change_message)

    return change


def another_frame(arrival: Arrival) -> Arrival:
    return changed_copy(arrival, lambda message: setattr(message.header, "frame_id", "elsewhere"))


def set_infinite(arrival: Arrival) -> Arrival:
    *parents, leaf = FIRST_NUMBER[type_name_of(arrival.message)].split(".")

    def change_message(message: Any) -> None:
        for name in parents:
            message = getattr(message, name)
        setattr(message, leaf, np.inf)

    return changed_copy(arrival, change_message)


def repeat_after(after_s: float) -> Change:
    return lambda arrival: changed_copy(arrival, lambda message: None, arrival.receive_ns + round(after_s * SECOND_NS))


def bad_quaternion(arrival: Arrival) -> Arrival:
    return changed_copy(arrival, lambda message: setattr(message.orientation, "w", 10.0))


def negative_variance(arrival: Arrival) -> Arrival:
    """Set a negative variance in the first field of :data:`VARIANCES` that the message has."""

    def change_message(message: Any) -> None:
        name = next(name for name in VARIANCES if hasattr(message, name))
        value = getattr(message, name)
        if isinstance(value, np.ndarray):
            value[:] = np.diag([1.0, -1.0, 1.0]).ravel()
        else:
            setattr(message, name, -1.0)

    return changed_copy(arrival, change_message)


def no_orientation(arrival: Arrival) -> Arrival:
    """Set the first element of the covariance to -1: by Imu.msg there is no orientation."""

    def change_message(message: Any) -> None:
        message.orientation_covariance[0] = -1.0

    return changed_copy(arrival, change_message)


VARIANCES = (
    *("rotation_covariance", "orientation_covariance", "direction_covariance", "position_covariance"),
    *("covariance", "variance", "sigma"),
)
UNUSABLE: dict[str, tuple[str, Change]] = {
    "stamp zero": ("bad_stamp", with_stamp(lambda arrival: 0)),
    "late": ("late", with_stamp(lambda arrival: arrival.stamp_ns - 5 * SECOND_NS // 2)),
    "future": ("future", with_stamp(lambda arrival: arrival.receive_ns + SECOND_NS // 10)),
    "infinite": ("non_finite", set_infinite),
    "frame": ("frame", another_frame),
    "quaternion": ("bad_quaternion", bad_quaternion),
    "variance": ("bad_covariance", negative_variance),
    "orientation": ("not_given", no_orientation),
    "again at once": ("duplicate", repeat_after(1e-6)),
    "again later": ("duplicate", repeat_after(0.7)),
    "again too late": ("late", repeat_after(2.5)),
}


def missing_changes(topic: str) -> tuple[str, ...]:
    """Return the faults that do not make a message of a topic unusable.

    Old positions and weather readings are used if none is newer, and may be in any frame; the covariance of a drone's
    attitude is not used.
    """
    if topic in ("gnss/fix", "met/humidity", "met/pressure", "met/temperature"):
        return "late", "again too late", "frame", "quaternion", "orientation"
    if topic.endswith("/imu"):
        return ("variance",) if topic.startswith("beacon/") else ()
    if topic.endswith(("/observations", "/beacons")):
        return "quaternion", "variance", "orientation"
    without_quaternion = "/horizon_attitude", "/encoder", "/baseline", "/target", "/target_direction"
    return ("quaternion", "orientation") if topic.endswith(without_quaternion) else ("orientation",)


@pytest.mark.slow
@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("kind", UNUSABLE)
def test_outputs_are_bit_equal_to_those_without_the_rejected_messages(node: str, kind: str) -> None:
    reason, change = UNUSABLE[kind]
    arrivals = voyage(node).arrivals
    concerned = [topic for topic in topics(node) if kind not in missing_changes(topic)]
    run = voyage(node).run(sort_by_arrival((*arrivals, *(change(a) for a in arrivals if a.topic in concerned))))
    clean = fault_free_run(node)
    for topic in concerned:
        count = sum(arrival.topic == topic for arrival in arrivals)
        assert reason in run.reasons(topic)
        assert run.health(topic).rejected == clean.health(topic).rejected + count
    assert run.results() == clean.results()


@pytest.mark.parametrize(
    ("node", "topic"),
    [
        ("ship_attitude", "ins/imu"),
        ("star_attitude", "ins/imu"),
        ("optical_axis", "ship/attitude"),
        ("optical_axis", "theodolite/encoder"),
        ("optical_axis by ins", "ins/imu"),
    ],
)
def test_current_values_with_old_stamps_have_no_effect(node: str, topic: str) -> None:
    """Stamps are 0.3 s old: if ship or mount has moved, the message contradicts its neighbours and is rejected."""
    arrivals = voyage(node).arrivals
    back = with_stamp(lambda arrival: arrival.stamp_ns - 3 * SECOND_NS // 10 - 1)
    moved = [a for a in arrivals if a.topic == topic and a.stamp_ns > arrivals[0].stamp_ns + 2 * SECOND_NS]
    run = voyage(node).run(sort_by_arrival((*arrivals, *map(back, moved))))
    assert run.reasons(topic)["gate"] == len(moved)
    assert run.results() == fault_free_run(node).results()


def flood_cases() -> list[tuple[str, str]]:
    """Return (node, topic) of the measurements for which a filter rewinds."""
    return [
        ("ship_attitude", "reference/gyro/imu"),
        ("ship_attitude", "star/aft/inertial_attitude"),
        ("ship_attitude", "star/fore/horizon_attitude"),
        ("ship_attitude", "star/starboard/observations"),
        ("optical_axis", "theodolite/beacons"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("node", "topic"), flood_cases())
def test_messages_at_a_too_high_rate_have_no_effect(node: str, topic: str) -> None:
    everything = voyage(node).arrivals
    three_seconds = [a for a in everything if a.receive_ns < everything[0].receive_ns + 3 * SECOND_NS]
    arrivals = flood_topic(tuple(three_seconds), topic, 20, up_to_s=1.9)
    run = voyage(node).run(arrivals)
    overflow = run.innovations(Reason.OVERFLOW)
    assert run.reasons(topic)["overflow"] == len(overflow) > 30
    assert run.results() == voyage(node).run(without_rejected(arrivals, topic, overflow)).results()


@pytest.mark.parametrize("count", [1, 4, 8])
def test_a_baseline_without_fixed_solution_only_makes_its_light_unusable(count: int) -> None:
    """A baseline without fixed solution is an exception: its position is not used, but it has an effect.

    No exposure waits for a fixed baseline in place of an unfixed one, and no position is interpolated across an unfixed
    one. If the fixed baselines before and after are too far apart for interpolation, the final state is that without
    the unfixed baselines.
    Otherwise lights between the fixed baselines are missing.
    """
    everything, topic = voyage("optical_axis"), "beacon/a/baseline"
    chosen = [a for a in everything.arrivals if a.topic == topic][30 : 30 + count]
    others = tuple(a for a in everything.arrivals if a not in chosen)
    runs = [
        everything.run(sort_by_arrival((*others, *(changed_copy(a, set_floating_fix(enu_m)) for a in chosen))))
        for enu_m in (0.0, 1e300, np.nan)
    ]
    assert runs[0].results() == runs[1].results() == runs[2].results()
    assert runs[0].reasons(topic) == {"not_fixed": count}
    without_them, states = everything.run(others), []
    for run in (runs[0], without_them):
        state = run.adapter.core.state
        states.append((state.mean.tobytes(), state.covariance_by_source.tobytes(), state.point_count))
    is_gap_too_long = others_around_s(others, topic, chosen) > MAX_GAP_S
    assert is_gap_too_long == (count == 8)
    assert (states[0] == states[1]) == is_gap_too_long
    assert states[0][2] <= states[1][2]


MAX_GAP_S = 0.5
"""Default maximum gap between baselines, s."""


def others_around_s(others: Arrivals, topic: str, chosen: list[Arrival]) -> float:
    stamps = [a.stamp_ns for a in others if a.topic == topic]
    before_ns = max(ns for ns in stamps if ns < chosen[0].stamp_ns)
    after_ns = min(ns for ns in stamps if ns > chosen[-1].stamp_ns)
    return (after_ns - before_ns) / SECOND_NS


def set_floating_fix(enu_x: float) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.fix, message.enu.x = 3, enu_x

    return change
