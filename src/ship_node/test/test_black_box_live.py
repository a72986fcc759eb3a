"""Parameter ``black_box`` of a live node: records, reports, refusals."""

import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import Trigger

from ship_msgs.msg import ShipAttitude
from ship_node.black_box.black_box_format import (
    EVENTS_TOPIC,
    ChangeRefused,
    ClockJumpedBack,
    Closed,
    ParametersChanged,
    ServiceCalled,
    Tick,
)
from ship_testing.black_box_entries import SECOND_NS, read_entries
from ship_testing.live_relay import RELIABLE_INPUT, SIM_TIME, imu_message
from ship_testing.places import RELAY_PROGRAM

REFUSAL = "parameter 'gate.count' = 13 is not wanted by the adapter"

pytestmark = pytest.mark.live


def set_parameter(relay, name: str, value: object):
    parameter = Parameter(name, value=value).to_parameter_msg()
    return relay.call(SetParameters, "set_parameters", SetParameters.Request(parameters=[parameter])).results[0]


@pytest.mark.smoke
def test_black_box_contains_everything_in_order_of_use(live_relay, tmp_path):
    relay = live_relay(*RELIABLE_INPUT, *SIM_TIME, "-p", f"black_box:={tmp_path}/box.mcap")
    publisher, set_time = relay.imu_publisher(), relay.clock_publisher()
    assert set_parameter(relay, "gate.bias_deg", 1.5).successful
    early, late = imu_message(100 * SECOND_NS), imu_message(100 * SECOND_NS + 250_000_000)
    set_time(100.0)
    publisher.publish(early)
    relay.wait_until(lambda: len(relay.attitudes) == 1)
    set_time(100.25)
    publisher.publish(late)
    relay.wait_until(lambda: len(relay.attitudes) == 2)
    assert set_parameter(relay, "gate.count", 13).reason == REFUSAL
    assert relay.call(Trigger, "reset", Trigger.Request()).success
    assert not relay.call(Trigger, "explode", Trigger.Request()).success
    set_time(50.0)
    relay.wait_until(lambda: relay.adapter.resets)
    relay.live._black_box.close()
    rows = read_entries(tmp_path / "box.mcap")
    uses = [(topic, what) for topic, what, _ in rows if topic in ("ins/imu", EVENTS_TOPIC)]
    assert uses == [
        (EVENTS_TOPIC, ParametersChanged({"gate.bias_deg": 1.5}, None)),
        ("ins/imu", bytes(serialize_message(early))),
        (EVENTS_TOPIC, Tick()),
        (EVENTS_TOPIC, Tick()),
        ("ins/imu", bytes(serialize_message(late))),
        (EVENTS_TOPIC, ParametersChanged({"gate.count": 13}, REFUSAL)),
        (EVENTS_TOPIC, ServiceCalled("reset", True, "reset")),
        (EVENTS_TOPIC, ServiceCalled("explode", None, None)),
        (EVENTS_TOPIC, ClockJumpedBack()),
        (EVENTS_TOPIC, Closed()),
    ]
    topics = [topic for topic, _, _ in rows if topic in ("ins/imu", "ship/attitude")]
    assert topics == ["ins/imu", "ship/attitude"] * 2
    outputs = [deserialize_message(what, ShipAttitude) for topic, what, _ in rows if topic == "ship/attitude"]
    # Compared as texts, because a NaN in a message is not equal to itself.
    assert list(map(str, outputs)) == list(map(str, relay.attitudes))


def test_black_box_and_changed_parameters_are_in_the_diagnostics(live_relay, tmp_path):
    relay = live_relay("-p", f"black_box:={tmp_path}/box.mcap")
    relay.wait_until(lambda: relay.has_level("relay: black box", DiagnosticStatus.OK))
    assert relay.diagnostics["relay: black box"].message == f"writing {tmp_path}/box.mcap"
    assert relay.diagnostics["relay: parameters"].message == "as at the start"
    assert set_parameter(relay, "gate.count", 5).successful
    assert not set_parameter(relay, "gate.count", 13).successful
    wanted = f"changed: gate.count = 5, 3 at the start; last refusal: {REFUSAL}"
    relay.wait_until(lambda: relay.diagnostics["relay: parameters"].message == wanted)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gate.probability", 1.5),
        ("gate.probability", "high"),
        ("gate.probabilty", 0.75),
        ("sensors.fore.elevation_deg", 50.0),
        ("black_box", "other.mcap"),
        ("frame_id", [b"a", b"b"]),
    ],
)
def test_a_change_refused_before_the_adapter_is_in_log_black_box_and_diagnostics(
    live_relay, tmp_path, capfd, name, value
):
    relay = live_relay("-p", f"black_box:={tmp_path}/box.mcap", "-p", "sensors.fore.elevation_deg:=45")
    reason = set_parameter(relay, name, value).reason
    wanted = f"as at the start; last refusal: {reason}"
    relay.wait_until(
        lambda: "relay: parameters" in relay.diagnostics and relay.diagnostics["relay: parameters"].message == wanted
    )
    assert reason
    assert f"refused: {reason}" in "".join(capfd.readouterr())
    relay.live._black_box.close()
    noted = [what for topic, what, _ in read_entries(tmp_path / "box.mcap") if isinstance(what, ChangeRefused)]
    # Values without a JSON form are recorded in Python's notation.
    recorded = value if not isinstance(value, list) else [repr(part) for part in value]
    assert noted == [ChangeRefused({name: recorded}, reason)]


def test_black_box_parameter_is_read_only_and_optional(live_relay, tmp_path):
    relay = live_relay()
    result = set_parameter(relay, "black_box", f"{tmp_path}/box.mcap")
    assert not result.successful
    assert "read-only" in result.reason
    relay.wait_until(lambda: "relay: clock" in relay.diagnostics)
    assert "relay: black box" not in relay.diagnostics
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("box.bag", "relay.yaml:3: parameter 'black_box' = 'box.bag': expected a file ending in .mcap, or a folder"),
        ("7", "relay.yaml:3: parameter 'black_box' must be of type str"),
        ("/proc/box.mcap", "relay.yaml:3: parameter 'black_box' = '/proc/box.mcap': "),
    ],
)
def test_a_bad_path_is_one_line_with_file_and_line(tmp_path, value, reason):
    file = tmp_path / "relay.yaml"
    file.write_text(f"relay:\n  ros__parameters:\n    black_box: {value}\n", encoding="utf-8")
    command = [sys.executable, RELAY_PROGRAM, "--ros-args", "--params-file", str(file)]
    finished = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert finished.returncode == 2
    assert finished.stderr.splitlines() == [finished.stderr.rstrip("\n")]
    assert reason in finished.stderr
