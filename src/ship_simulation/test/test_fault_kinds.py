"""Every kind of fault with every message type that nodes receive: it changes messages, or it is refused."""

import dataclasses
import itertools
import re

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import message_store
from ship_bags.stamps import NS_PER_S
from ship_simulation.inject_command import Injection
from ship_simulation.scenario.fault import KINDS, Fault, size_problems
from ship_simulation.scenario.names import COVARIANCES, FIRST_VALUE, is_applicable
from ship_simulation.scenario.scenario_file import fault_problems, load_scenario
from ship_simulation.simulate_command import write_bag
from ship_testing.every_case import check_every_case
from ship_testing.places import ROOT
from ship_testing.theodolite_scenes import with_stars_and_targets

TOPICS = {
    "ins/imu": "sensor_msgs/msg/Imu",
    "star/bow/horizon_attitude": "ship_msgs/msg/StarHorizonAttitude",
    "star/starboard/observations": "ship_msgs/msg/StarObservationArray",
    "star/port/inertial_attitude": "ship_msgs/msg/StarInertialAttitude",
    "ship/attitude": "ship_msgs/msg/ShipAttitude",
    "theodolite/encoder": "ship_msgs/msg/TheodoliteEncoder",
    "theodolite/beacons": "ship_msgs/msg/BeaconImage",
    "theodolite/target": "ship_msgs/msg/TargetImage",
    "theodolite/night/stars": "ship_msgs/msg/StarObservationArray",
    "beacon/a/baseline": "ship_msgs/msg/RtkBaseline",
    "gnss/fix": "sensor_msgs/msg/NavSatFix",
    "gravity/deflection": "ship_msgs/msg/Deflection",
    "met/pressure": "sensor_msgs/msg/FluidPressure",
    "met/temperature": "sensor_msgs/msg/Temperature",
    "met/humidity": "sensor_msgs/msg/RelativeHumidity",
}
"""A topic of each type that some node of the suite takes."""

SIZES = {
    "delay": {"delay_s": 0.3},
    "reorder": {"delay_s": 0.3},
    "stamp_late": {"delay_s": 0.3},
    "clock_step": {"step_s": -5.0},
    "flood": {"times": 3},
    "offset": {"value": 0.25},
    "axes": {"axes": "ned_frd"},
    "bias": {"up_arcsec": 30.0},
    "knock": {"up_arcsec": 30.0},
    "drift": {"up_arcsec_per_min": 30.0, "azimuth_arcsec_per_min": 30.0},
    "slip": {"azimuth_arcsec": 30.0},
    "position_off": {"north_m": 300.0},
    "wrong_fix": {"north_m": 0.3},
    "false_stars": {"count": 2},
    "false_lights": {"count": 2},
}
"""Parameters of the kinds that need some."""

START_S, END_S = 0.0, 1.5

UNCHANGED = {
    ("freeze", topic) for topic in ("met/pressure", "met/temperature", "met/humidity", "gravity/deflection")
} | {("swap", "theodolite/night/stars")}
"""Simulated weather, and the deflection at anchor, are constant anyway; stars without names cannot exchange them."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Return a bag of two seconds with every device, and with the fused attitude."""
    scenario = load_scenario(ROOT / "bags" / "scenarios" / "everything.yaml")
    fused = dataclasses.replace(scenario.fused_attitude, written=True)
    gravity = dataclasses.replace(
        scenario.gravity, told="topic", rate_hz=5.0, xi_arcsec=5.0, sigma_arcsec=1.0
    )
    scenario = dataclasses.replace(scenario, duration_s=2.0, fused_attitude=fused, gravity=gravity)
    scenario = with_stars_and_targets(scenario)
    path = tmp_path_factory.mktemp("bag") / "everything.mcap"
    write_bag(scenario, 3, path, b"scenario: here\n")
    return path


@pytest.fixture(scope="module")
def start_ns(bag):
    with read_bag(bag) as content:
        assert {topic: content.topics[topic] for topic in TOPICS} == TOPICS
        return content.start_ns


def fault_of(kind, topic):
    sizes = SIZES.get(kind, {})
    if kind in ("corrupt", "offset"):
        sizes = {**sizes, "field": FIRST_VALUE[TOPICS[topic]]}
    return Fault(topic=topic, kind=kind, start_s=START_S, end_s=END_S, **sizes)


def test_the_types_here_are_all_that_faults_apply_to():
    assert set(TOPICS.values()) == set(FIRST_VALUE)


@pytest.mark.parametrize("kind", KINDS)
def test_the_sizes_here_are_those_of_the_kind(kind):
    assert [str(problem) for problem in size_problems("f", fault_of(kind, "ins/imu"))] == []


@pytest.mark.slow
def test_a_kind_changes_messages_of_a_type_in_its_time_or_is_refused(bag, start_ns):
    def check(kind, topic):
        check_a_kind(bag, start_ns, kind, topic)

    check_every_case(itertools.product(KINDS, TOPICS), check)


def check_a_kind(bag, start_ns, kind, topic):
    fault = fault_of(kind, topic)
    if not is_applicable(kind, TOPICS[topic]):
        problems = [str(problem) for problem in fault_problems({"f": fault}, TOPICS, "in the bag")]
        assert problems == [f"'faults.f.kind' = {kind} does not apply to {TOPICS[topic]}"]
        return
    assert list(fault_problems({"f": fault}, TOPICS, "in the bag")) == []
    changed_ns = Injection(bag, {"f": fault}, 1).effect("f").times_ns
    since_s = [(time_ns - start_ns) / NS_PER_S for time_ns in changed_ns]
    assert bool(since_s) == ((kind, topic) not in UNCHANGED)
    # Faults apply by stamps; messages arrive at most 0.5 s after their stamps.
    assert all(START_S <= seconds < END_S + 0.5 for seconds in since_s)


@pytest.mark.parametrize("topic", TOPICS)
def test_covariance_faults_apply_to_all_types_with_covariances(topic):
    """The definitions of the messages name the covariances; of an IMU the nodes use only that of the orientation."""
    fields = message_store().fielddefs[TOPICS[topic]][1]
    names = [name for name, _ in fields if re.fullmatch(r"(\w+_)?covariance", name)]
    taken = [name for name in names if name not in ("angular_velocity_covariance", "linear_acceleration_covariance")]
    assert list(COVARIANCES.get(TOPICS[topic], ())) == taken
    for kind in ("covariance_unknown", "covariance_negative"):
        assert is_applicable(kind, TOPICS[topic]) == bool(taken)


def test_a_fault_may_change_nothing(bag):
    """Faults after the end of the bag, of a share of zero or without a size change nothing.

    The first frozen message is unchanged as well.
    """
    fix = {"topic": "gnss/fix", "end_s": END_S}
    frozen = Injection(bag, {"f": Fault(kind="freeze", start_s=START_S, **fix)}, 1).effect("f").times_ns
    dropped = Injection(bag, {"f": Fault(kind="drop", start_s=START_S, **fix)}, 1).effect("f").times_ns
    assert frozen == dropped[1:]
    for fault in (
        Fault(kind="drop", start_s=100.0, topic="ins/imu"),
        Fault(kind="duplicate", start_s=START_S, share=0.0, **fix),
        Fault(kind="flood", times=1, start_s=START_S, **fix),
        Fault(kind="wrong_fix", topic="beacon/a/baseline", start_s=START_S),
    ):
        assert Injection(bag, {"f": fault}, 1).effect("f").times_ns == []


def test_the_effect_of_a_fault_is_counted_without_other_faults(bag):
    """An earlier fault that drops all messages of the same time does not change the count."""
    faults = {
        "a": Fault(kind="drop", topic="ins/imu", start_s=START_S),
        "b": Fault(kind="frame", topic="ins/imu", start_s=START_S, end_s=END_S),
    }
    injection = Injection(bag, faults, 1)
    assert len(injection.effect("b").times_ns) == round(50.0 * (END_S - START_S))
    assert len(injection.effect("a").times_ns) > len(injection.effect("b").times_ns)
