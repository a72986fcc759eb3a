"""Domain of the suite: its number, its range of discovery, and the nodes in it before the suite starts."""

import pytest

from ship_bringup.checks.check_line import Result
from ship_bringup.checks.network_check import check_domain, check_settings
from ship_bringup.checks.network_state import NetworkState, ObservedTopic, Publisher
from ship_bringup.security.demand import domain_of
from ship_node.messages.inputs_outputs import InputTopic

OWN = ("/demo/ship_attitude",)
INS = ObservedTopic(InputTopic("ins/imu", "sensor_msgs/msg/Imu", True, 1000), (Publisher("/demo/ins", "x"),))


def check_rows(state):
    return [(row.result, row.finding) for row in check_domain(state, OWN)]


@pytest.mark.parametrize(
    ("text", "result", "domain"),
    [(None, Result.WARN, 0), ("", Result.WARN, 0), ("0", Result.OK, 0), ("7", Result.OK, 7),
     ("101", Result.OK, 101), ("102", Result.WARN, 102), ("232", Result.WARN, 232), ("233", Result.FAIL, 0),
     ("-1", Result.FAIL, 0), ("seven", Result.FAIL, 0), ("٧", Result.FAIL, 0)],
)  # fmt: skip
def test_domain_number(text, result, domain):
    environment = {} if text is None else {"ROS_DOMAIN_ID": text}
    number, reach = check_settings(environment)
    assert (number.result, reach.result) == (result, Result.OK)
    assert domain_of(environment) == domain


@pytest.mark.parametrize(
    ("reach", "peers", "result"),
    [("SUBNET", "", Result.OK), ("LOCALHOST", "", Result.OK), ("OFF", "", Result.FAIL),
     ("OFF", "10.0.0.2", Result.OK), ("localhost", "", Result.FAIL)],
)  # fmt: skip
def test_range_of_discovery(reach, peers, result):
    environment = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_STATIC_PEERS": peers}
    assert [row.result for row in check_settings(environment)] == [Result.OK, result]


def test_drivers_of_sensors_are_accepted():
    assert check_rows(NetworkState("rmw", ("/demo/ins",), (INS,))) == [(Result.OK, "rmw; sensors: /demo/ins")]


def test_running_node_of_the_suite_fails():
    rows = check_rows(NetworkState("rmw", (*OWN, "/demo/ins"), (INS,), {"ship/attitude": OWN}))
    assert (Result.FAIL, "/demo/ship_attitude is running already") in rows
    assert len(rows) == 2


def test_nmea_nodes_started_by_hand_are_a_warning():
    state = NetworkState("rmw", ("/demo/nmea_in", "/demo/nmea_out", "/demo/ins"), (INS,))
    warning, good = check_domain(state, OWN, ["/demo/nmea_in", "/demo/nmea_out"])
    assert (warning.result, warning.finding) == (Result.WARN, "/demo/nmea_in, /demo/nmea_out is running already")
    assert warning.advice.startswith("end it before the suite is started")
    assert good.result is Result.OK


def test_foreign_publisher_of_an_output_fails():
    rows = check_rows(NetworkState("rmw", ("/x", "/demo/ins"), (INS,), {"ship/attitude": ("/x",)}))
    assert (Result.FAIL, "ship/attitude, an output of the suite, is published by /x") in rows


def test_unknown_nodes_duplicate_names_and_clock_are_warnings():
    rows = check_rows(NetworkState("rmw", ("/demo/ins", "/rviz", "/rviz"), (INS,), has_clock=True))
    assert [text for result, text in rows if result is Result.WARN] == [
        "/clock is published, as by the player of a bag", "2 nodes are called /rviz", "not part of the suite: /rviz"
    ]  # fmt: skip


def test_failed_observation_is_not_checked():
    assert check_rows(NetworkState(failure="no rmw")) == [(Result.NOT_CHECKED, "no rmw")]
