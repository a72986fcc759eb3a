"""``preflight`` over real DDS: a ship that is ready, and one with many faults at the same time."""

import re
import subprocess
import time
from functools import partial
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from ship_bags.live.ros_process import executable
from ship_bags.stamps import NS_PER_S, stamp_fields
from ship_msgs.msg import ShipAttitude, StarHorizonAttitude
from ship_testing.trials.live_process import GraphObserver, free_domain_id, live_environment

pytestmark = pytest.mark.live

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "two_sensors.yaml"
READY_S = 60.0


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return free_domain_id()


def publish(node, topic, kind, rate_hz, ahead_s=0.0, qos=10, pause_s=0.0):
    """Publish messages of a type, stamped by the clock or ahead of it; optionally from a time after discovery on."""
    publisher = node.create_publisher(kind, topic, qos)

    def send():
        message = kind()
        time_ns = time.time_ns() + round(ahead_s * NS_PER_S)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(time_ns)
        publisher.publish(message)

    def begin():
        node.create_timer(1.0 / rate_hz, send)

    if pause_s:
        after_link(node, publisher, pause_s, begin)
    else:
        begin()
    return publisher


def after_link(node, publisher, delay_s, act):
    """Call `act` once, `delay_s` after the first subscription was matched with the publisher."""
    linked_s = []

    def look():
        if not linked_s and publisher.get_subscription_count():
            linked_s.append(time.monotonic())
        if linked_s and time.monotonic() >= linked_s[0] + delay_s:
            timer.cancel()
            act()

    timer = node.create_timer(0.1, look)


def preflight(observer, environment, *arguments):
    """Return exit code, rows as (check, result, found) and stderr, while the observer's timers run."""
    command = [*executable("ship_bringup", "preflight"), *map(str, arguments)]
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, cwd=environment["ROS_LOG_DIR"], **piped) as process:
        assert observer.spin_until(lambda: process.poll() is not None, READY_S)
        output, error = process.communicate()
    row = re.compile(r"^  (\w+) +(OK|WARN|FAIL|not checked) +(.*)$", re.MULTILINE)
    assert output.splitlines()[-1].partition(": ")[2].startswith("NOT READY: " if process.returncode else "READY: ")
    return process.returncode, row.findall(output), error


def failed_checks(rows):
    """Return the failed checks and their findings."""
    return [f"{check}: {found}" for check, result, found in rows if result == "FAIL"]


@pytest.mark.smoke
def test_a_ship_that_is_ready(tmp_path, domain):
    environment = live_environment(domain, tmp_path)
    with GraphObserver(domain) as observer:
        publish(observer.node, "/demo/ins/imu", Imu, 50.0)
        publish(observer.node, "/diagnostics", DiagnosticArray, 1.0)  # as drivers do
        for sensor in ("fore", "starboard"):
            publish(observer.node, f"/demo/star/{sensor}/horizon_attitude", StarHorizonAttitude, 5.0)
        code, rows, error = preflight(observer, environment, EXAMPLE, "--namespace", "demo", "--listen", "2")
    assert (code, error, failed_checks(rows)) == (0, "", [])
    sensors = [found for check, result, found in rows if (check, result) == ("sensors", "OK")]
    assert len(sensors) == 3
    rates_hz = {found.split(":")[0]: float(re.search(r": ([\d.]+) Hz", found)[1]) for found in sensors}
    # Wide: the machine may be busy.
    assert 5.0 < rates_hz["ins/imu"] < 75.0
    assert 0.4 < rates_hz["star/fore/horizon_attitude"] < 8.0
    assert ("domain", "OK", f"ROS_DOMAIN_ID is {domain}") in rows
    assert ("domain", "OK", "rmw_fastrtps_cpp; sensors: /observer") in rows


@pytest.mark.parametrize("are_there", [True, False])
def test_late_sensors_are_waited_for(are_there, tmp_path, domain):
    """The sensors publish, or start, only after discovery (4 s) and listening (1 s) have ended."""
    environment, late_s = live_environment(domain, tmp_path), 5.5
    with GraphObserver(domain) as observer:
        imu = publish(observer.node, "/demo/ins/imu", Imu, 50.0)
        for sensor in ("fore", "starboard"):
            topic = f"/demo/star/{sensor}/horizon_attitude"
            star = partial(publish, observer.node, topic, StarHorizonAttitude, 5.0)
            if are_there:
                star(pause_s=late_s)
            else:
                after_link(observer.node, imu, late_s, star)
        code, rows, error = preflight(observer, environment, EXAMPLE, "--namespace", "demo", "--listen", "1")
    assert (code, error, failed_checks(rows)) == (0, "", [])
    assert len([found for check, result, found in rows if (check, result) == ("sensors", "OK")]) == 3


def test_simultaneous_faults_are_all_reported(tmp_path, domain):
    environment = live_environment(domain, tmp_path) | {"ROS_SECURITY_KEYSTORE": str(tmp_path)}
    path = tmp_path / "suite.yaml"
    head = "/**/ship_attitude:\n  ros__parameters:\n"
    bad = "    lag_s: -1.0\n    alignment_file: /nowhere/alignment.yaml\n"
    bad += "    qos_overrides: {/star/fore/horizon_attitude: {subscription: {reliability: reliable}}}\n"
    path.write_text(EXAMPLE.read_text().replace(head, head + bad))
    limits = tmp_path / "ship.yaml"
    limits.write_text("machine: {require_security: true}\n")
    with GraphObserver(domain) as observer:
        publish(observer.node, "/ins/imu", Imu, 50.0, ahead_s=-100.0)
        best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        publish(observer.node, "/star/fore/horizon_attitude", StarHorizonAttitude, 5.0, qos=best_effort)
        publish(observer.node, "/ship/attitude", ShipAttitude, 5.0)
        code, rows, error = preflight(
            observer, environment, path, "--limits", limits, "--listen", "1", "--hours", "1e7", "--box", "/proc/boxes"
        )
    lines = failed_checks(rows)
    assert (code, error) == (1, "")
    for expected in (
        rf"parameters: {re.escape(str(path))}:\d+: parameter 'lag_s'",
        r"security: machine.require_security demands it, and no DDS security: .* built without security",
        r"security: machine.require_security demands it, and ROS_SECURITY_ENABLE is not set",
        r"keystore: .*: is not a keystore",
        r"domain: ship/attitude, an output of the suite, is published by /observer",
        r"disk: .*/proc/boxes is not there yet: .* in /proc, ",
        r"files: --box /proc/boxes: user \w+ cannot create it",
        r"files: .*suite.yaml:\d+: alignment_file /nowhere/alignment.yaml: user \w+ cannot create it",
        r"sensors: ins/imu: .* Hz from /observer, stamps (99|100|101)\.\d+ s old",
        r"sensors: star/fore/horizon_attitude: /observer does not offer reliable, required by qos_overrides in the ",
        r"sensors: star/starboard/horizon_attitude: no publisher",
    ):
        assert any(re.match(expected, line) for line in lines), (expected, lines)


NMEA = """
/**/nmea_in:
  ros__parameters:
    sources:
      seapath: {kind: udp, address: 127.0.0.1, port: 10200, becomes: ins}
"""


def test_an_ins_that_nmea_in_will_read_is_not_ready_before_it_is_received(tmp_path, domain):
    environment = live_environment(domain, tmp_path)
    path = tmp_path / "the suite.yaml"
    path.write_text(EXAMPLE.read_text() + NMEA)
    with GraphObserver(domain) as observer:
        for sensor in ("fore", "starboard"):
            publish(observer.node, f"/demo/star/{sensor}/horizon_attitude", StarHorizonAttitude, 5.0)
        by_hand = Node("nmea_in", namespace="/demo", context=observer.node.context, start_parameter_services=False)
        code, rows, _ = preflight(observer, environment, path, "--namespace", "demo", "--listen", "1")
        by_hand.destroy_node()
    assert ("parameters", "OK", f"{path}: good for ship_attitude, nmea_in") in rows
    expected = "sensors: ins/imu: no publisher yet: the suite starts nmea_in, which may publish it"
    assert (code, failed_checks(rows)) == (1, [expected])
    assert ("domain", "WARN", "/demo/nmea_in is running already") in rows


def test_an_invalid_domain_is_reported_and_nothing_is_received(tmp_path, domain):
    environment = live_environment(domain, tmp_path) | {"ROS_DOMAIN_ID": "300"}
    with GraphObserver(domain) as observer:
        code, rows, _ = preflight(observer, environment, EXAMPLE)
    wrong = "ROS_DOMAIN_ID is '300': expected a number from 0 to 232"
    assert code == 1
    assert ("domain", "FAIL", wrong) in rows
    assert ("domain", "not checked", wrong) in rows
    assert ("sensors", "FAIL", f"nothing could be received: {wrong}") in rows


def test_bad_input_is_one_line_and_exit_code_2(tmp_path, domain):
    environment = live_environment(domain, tmp_path)
    empty, strange, limits = tmp_path / "empty.yaml", tmp_path / "strange.yaml", tmp_path / "limits.yaml"
    empty.write_text("")
    strange.write_text("/**/nonsense:\n  ros__parameters:\n    a: 1\n")
    limits.write_text("machine: {require_securty: true}\n")
    for arguments, expected in (
        ([tmp_path / "none.yaml"], "none.yaml: cannot be read"),
        ([empty], "empty.yaml: empty: expected a section"),
        ([strange], "no section for a node of this suite"),
        ([EXAMPLE, "--limits", limits], "limits.yaml:1: parameter 'machine.require_securty' is unknown"),
        ([EXAMPLE, "--hours", "nan"], "nan is not a positive number"),
    ):
        command = [*executable("ship_bringup", "preflight"), *map(str, arguments)]
        ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), ended.stderr
        assert expected in ended.stderr


def test_a_suite_whose_profile_requires_security_does_not_start_without_it(tmp_path, domain):
    limits = tmp_path / "ship.yaml"
    limits.write_text("heading_arcsec: 8.0\nmachine:\n  require_security: true\n")
    environment = live_environment(domain, tmp_path)
    for name in ("ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY", "ROS_SECURITY_KEYSTORE"):
        environment.pop(name, None)
    command = [*executable("ship_bringup", "suite"), str(EXAMPLE), "--limits", str(limits)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    expected = f"suite: {limits}: machine.require_security is true, and no DDS security: "
    assert ended.stderr.startswith(expected)
    assert ended.stderr.count("\n") == 1
