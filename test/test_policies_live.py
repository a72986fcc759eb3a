"""Network entities of live nodes compared with the rights in their policies: none missing, none unused."""

import contextlib
import fnmatch
import socket
from pathlib import Path

import pytest

from ship_bags.live.ros_process import command_node, executable
from ship_bringup.security.rights import load_companions, suite_rights
from ship_bringup.suite.plan import check_nodes
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

pytestmark = pytest.mark.live

ROOT = Path(__file__).parents[1]
NAMESPACE = "demo"


NMEA = """
/**/nmea_out:
  ros__parameters:
    sinks: {{bridge: {{kind: tcp_server, port: {0}, sentences: [THS, ALF, ALC, HBT]}}}}
/**/nmea_in:
  ros__parameters:
    sources:
      seapath: {{kind: udp, port: {1}, becomes: ins}}
      s330: {{kind: udp, port: {2}, becomes: reference}}
"""


def free_ports(count):
    with contextlib.ExitStack() as probes:
        sockets = [probes.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return free_domain_id()


def network_rights(node, names):
    """Return topics and services of the nodes of a namespace: published, subscribed, served, called."""
    queries = (
        node.get_publisher_names_and_types_by_node,
        node.get_subscriber_names_and_types_by_node,
        node.get_service_names_and_types_by_node,
        node.get_client_names_and_types_by_node,
    )
    return [{topic for name in names for topic, _ in query(name, f"/{NAMESPACE}")} for query in queries]


def test_every_program_has_rights_for_its_network_entities(tmp_path, domain):
    suite_file = tmp_path / "suite.yaml"
    suite_file.write_text((ROOT / "examples" / "three_sensors.yaml").read_text() + NMEA.format(*free_ports(3)))
    checked, _ = check_nodes(suite_file, NAMESPACE)
    companions = load_companions(suite_file, NAMESPACE)
    every = suite_rights([node.adapter for node in checked], NAMESPACE, companions=companions)
    rights = {each.enclave: each for each in every}
    environment = live_environment(domain, tmp_path) | {"ROS_HOME": str(tmp_path)}
    command = [*executable("ship_bringup", "suite"), str(suite_file), "--namespace", NAMESPACE, "--monitor"]
    command += ["--port", str(*free_ports(1))]
    record = [*executable("ship_bags", "record"), "--out", str(tmp_path / "a.mcap"), "--ros-args", "-r", "__ns:=/demo"]
    programs = {"ship_attitude": ["ship_attitude"], "star_attitude": ["star_attitude"], "record": ["record"]}
    programs |= {"nmea_out": ["nmea_out"], "nmea_in": ["nmea_in"]}
    programs |= {"alerts": ["alerts", "alerts_reader"], "monitor": ["monitor"]}
    names = {name for nodes in programs.values() for name in nodes}
    with (
        GraphObserver(domain) as observer,
        LiveProcess(command, tmp_path / "suite.log", environment) as suite,
        LiveProcess(record, tmp_path / "record.log", environment),
    ):
        assert observer.spin_until(lambda: names <= set(observer.node.get_node_names()), 60.0), suite.log_text()
        there = {"/demo/ship/attitude": 1, "/demo/ship/alerts": 1, "/demo/reference/s330/imu": 1}
        assert observer.wait_for(there), suite.log_text()
        # The recorder is last: it subscribes to a topic when it has discovered the publisher.
        assert observer.spin_until(lambda: "/demo/ship/alerts" in network_rights(observer.node, ["record"])[1]), (
            suite.log_text()
        )
        assert observer.spin_until(lambda: "/demo/ship/attitude" in network_rights(observer.node, ["monitor"])[1]), (
            suite.log_text()
        )
        for program, nodes in programs.items():
            granted = rights[f"/demo/{program}"]
            allowed = (granted.publishes, granted.subscribes, granted.serves, granted.requests)
            found = network_rights(observer.node, nodes)
            for kind, has, may in zip(("publishes", "subscribes", "serves", "requests"), found, allowed, strict=True):
                beyond = [name for name in has if not any(fnmatch.fnmatchcase(name, each) for each in may)]
                assert not beyond, (program, kind, beyond)
            if program.endswith("_attitude"):
                assert found[0] == granted.publishes
                assert found[1] == granted.subscribes
                assert found[2] == granted.serves


@pytest.mark.parametrize("name", ["call", "param", "preflight"])
def test_a_short_tool_has_rights_for_its_network_entities(name, domain, monkeypatch):
    """The node is created as in the tool."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    checked, _ = check_nodes(ROOT / "examples" / "two_sensors.yaml", NAMESPACE)
    all_rights = suite_rights([node.adapter for node in checked], NAMESPACE)
    (granted,) = [each for each in all_rights if each.enclave == f"/demo/{name}"]
    node_name, arguments = f"{name}_4711", []
    if name == "preflight":
        node_name, arguments = name, ["--ros-args", "-r", "__ns:=/demo"]
    with command_node(node_name, arguments) as node:
        namespace = node.get_namespace()
        published = {each for each, _ in node.get_publisher_names_and_types_by_node(node_name, namespace)}
        served = {each for each, _ in node.get_service_names_and_types_by_node(node_name, namespace)}
    assert published <= granted.publishes
    assert [each for each in served if not any(fnmatch.fnmatchcase(each, may) for may in granted.serves)] == []
    assert len(served) == 7
