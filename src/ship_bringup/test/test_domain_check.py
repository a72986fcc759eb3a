"""The domain of the suite: its number, how far it reaches, and who is in it before the suite is."""

import pytest

from ship_bringup.checks.check_line import Verdict
from ship_bringup.checks.domain_check import domain_of, judge_domain, judge_settings
from ship_bringup.checks.network_look import HeardTopic, NetworkState, Publisher
from ship_node.edge.topics import InputTopic

OWN = ("/demo/ship_attitude",)
INS = HeardTopic(InputTopic("ins/imu", "sensor_msgs/msg/Imu", True, 1000), (Publisher("/demo/ins", "x"),))


def found(state):
    return [(row.verdict, row.found) for row in judge_domain(state, OWN)]


@pytest.mark.parametrize(
    ("text", "verdict", "domain"),
    [(None, Verdict.WARN, 0), ("", Verdict.WARN, 0), ("0", Verdict.OK, 0), ("7", Verdict.OK, 7),
     ("101", Verdict.OK, 101), ("102", Verdict.WARN, 102), ("232", Verdict.WARN, 232), ("233", Verdict.FAIL, 0),
     ("-1", Verdict.FAIL, 0), ("seven", Verdict.FAIL, 0), ("٧", Verdict.FAIL, 0)],
)  # fmt: skip
def test_the_number_of_the_domain(text, verdict, domain):
    environment = {} if text is None else {"ROS_DOMAIN_ID": text}
    number, reach = judge_settings(environment)
    assert (number.verdict, reach.verdict) == (verdict, Verdict.OK)
    assert domain_of(environment) == domain


@pytest.mark.parametrize(
    ("reach", "peers", "verdict"),
    [("SUBNET", "", Verdict.OK), ("LOCALHOST", "", Verdict.OK), ("OFF", "", Verdict.FAIL),
     ("OFF", "10.0.0.2", Verdict.OK), ("localhost", "", Verdict.FAIL)],
)  # fmt: skip
def test_how_far_others_are_met(reach, peers, verdict):
    environment = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_STATIC_PEERS": peers}
    assert [row.verdict for row in judge_settings(environment)] == [Verdict.OK, verdict]


def test_drivers_of_sensors_belong_there():
    assert found(NetworkState("rmw", ("/demo/ins",), (INS,))) == [(Verdict.OK, "rmw; sensors: /demo/ins")]


def test_a_node_of_the_suite_that_runs_already_fails():
    rows = found(NetworkState("rmw", (*OWN, "/demo/ins"), (INS,), {"ship/attitude": OWN}))
    assert (Verdict.FAIL, "/demo/ship_attitude is running already") in rows
    assert len(rows) == 2


def test_somebody_else_who_gives_what_the_suite_gives_fails():
    rows = found(NetworkState("rmw", ("/x", "/demo/ins"), (INS,), {"ship/attitude": ("/x",)}))
    assert (Verdict.FAIL, "ship/attitude, which the suite gives, is published by /x") in rows


def test_strangers_namesakes_and_a_clock_are_warnings():
    rows = found(NetworkState("rmw", ("/demo/ins", "/rviz", "/rviz"), (INS,), has_clock=True))
    assert [text for verdict, text in rows if verdict is Verdict.WARN] == [
        "somebody publishes a clock, as for a bag", "2 nodes are called /rviz", "no part of the suite: /rviz"
    ]  # fmt: skip


def test_what_was_not_seen_is_not_checked():
    assert found(NetworkState(failure="no rmw")) == [(Verdict.NOT_CHECKED, "no rmw")]
