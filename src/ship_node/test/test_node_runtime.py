"""Executable of a node for the user: help, one-line errors, clean end."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ship_testing.places import RELAY_PROGRAM, ROOT

pytestmark = pytest.mark.live

RELAY = [sys.executable, RELAY_PROGRAM]


def run_relay(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*RELAY, *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_help_shows_topics_and_parameters_with_units():
    result = run_relay("--help")
    assert result.returncode == 0
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert "Relays every Imu as ShipAttitude." in lines
    assert "ins/imu sensor_msgs/msg/Imu required" in lines
    assert "ship/calibration ship_msgs/msg/AlignmentState latched" in lines
    assert "sensors.<id>.elevation_deg deg must be given [-90, 90] elevation" in lines
    assert "gate.probability* - 0.99 [0.5, 1] gate" in lines


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--ros-args", "-p", "gate.x:=1"], "relay: parameter 'gate.x' is unknown: expected one of bias_deg, count,"),
        (
            ["--ros-args", "-p", "sensors.fore.elevation_deg:=95.0"],
            "relay: parameter 'sensors.fore.elevation_deg' = 95.0 deg is out of its range [-90.0, 90.0] deg",
        ),
        (
            ["--ros-args", "-p", "sensors.fore.mode:=slow"],
            "relay: parameter 'sensors.fore.elevation_deg' (elevation) must be given",
        ),
        (["--ros-args", "-p", "gate.bias_deg:=.nan"], "relay: parameter 'gate.bias_deg' must be finite, got nan"),
        (["--ros-args", "--params-file", "absent.yaml"], "relay: absent.yaml: cannot be read: No such file"),
        (["bag.mcap"], "relay: unknown argument 'bag.mcap': parameters follow --ros-args (see "),
    ],
)
def test_bad_start_exits_2_with_one_line(arguments, line):
    result = run_relay(*arguments)
    assert result.returncode == 2
    assert result.stderr.startswith(line)
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("parameters", "line", "text"),
    [
        ("gate:\n      probability: 3.0", 4, "parameter 'gate.probability' = 3.0 is out of its range [0.5, 1.0]"),
        ("gate: {probability: 1.0", 4, "not YAML: expected ',' or '}'"),
        ("sensors: {fore mast: {elevation_deg: 45.0}}", 3, "parameter 'sensors.fore mast': 'fore mast' cannot be"),
        ("gate.probabilty: 0.9", 3, "parameter 'gate.probabilty' is unknown: expected one of bias_deg, count"),
        ("qos_overrides:\n      /ins/imu: {subscription: {reliability: sure}}", 4, "parameter 'qos_overrides./ins/i"),
        ("qos_overrides:\n      /ins/imu: {subscription: {depth: 0}}", 4, "parameter 'qos_overrides./ins/imu': "),
        ("reliable_inputs: 1", 3, "parameter 'reliable_inputs' must be of type bool: "),
    ],
)
def test_bad_parameter_file_exits_2_with_file_and_line(tmp_path, parameters, line, text):
    path = tmp_path / "relay.yaml"
    path.write_text(f"relay:\n  ros__parameters:\n    {parameters}\n")
    result = run_relay("--ros-args", "--params-file", str(path))
    assert result.returncode == 2
    assert result.stderr.startswith(f"relay: {path}:{line}: {text}")
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_the_node_cleanly(number):
    # The signal handlers cannot be observed from outside, so wait for a line that the node logs later.
    arguments = ["--ros-args", "-p", "qos_overrides./absent.subscription.depth:=1"]
    with subprocess.Popen([*RELAY, *arguments], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert "clock: system time; black box: none" in process.stderr.readline()
        assert "names no topic and policy" in process.stderr.readline()
        os.kill(process.pid, number)
        rest = process.stderr.read()
        assert process.wait(timeout=30) == 0
        assert rest == ""


RELAY_FILE = "{section}:\n  ros__parameters: {{frame_id: ins}}\n"


@pytest.mark.parametrize(
    ("section", "remaps", "node"),
    [
        ("relay", ["-r", "__ns:=/aurora"], "/aurora/relay"),
        ("/**/relay", ["-r", "__node:=relay_2"], "/relay_2"),
        ("/**/relai", ["-r", "relay:__ns:=/aurora"], "/aurora/relay"),
    ],
)
def test_a_file_with_a_similar_section_name_exits_2_with_both_names(tmp_path, section, remaps, node):
    path = tmp_path / "suite.yaml"
    path.write_text(RELAY_FILE.format(section=section))
    result = run_relay("--ros-args", "--params-file", str(path), *remaps)
    assert result.returncode == 2
    full = section if section.startswith("/") else f"/{section}"
    assert result.stderr.startswith(f"relay: {path}:1: section '{full}' does not fit node '{node}': name it '/**/relay")
    assert result.stderr.count("\n") == 1


def test_a_file_for_other_nodes_is_one_warning_and_each_file_is_checked(tmp_path):
    """The second file has the section that ros2 launch writes for inline parameters, which matches every node."""
    other, inline = tmp_path / "other.yaml", tmp_path / "inline.yaml"
    other.write_text(RELAY_FILE.format(section="/**/radar"))
    inline.write_text(RELAY_FILE.format(section="/**"))
    arguments = ["--ros-args", "--params-file", str(other), "--params-file", str(inline), "-r", "__ns:=/aurora"]
    last = ["-p", "qos_overrides./absent.subscription.depth:=1"]
    with subprocess.Popen([*RELAY, *arguments, *last], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        warning = f"{other}: no section is for node '/aurora/relay', its sections are '/**/radar'"
        assert warning in process.stderr.readline()
        assert "clock: system time; black box: none" in process.stderr.readline()
        assert "names no topic and policy" in process.stderr.readline()
        process.terminate()
        assert process.stderr.read() == ""
        assert process.wait(timeout=30) == 0


def test_a_signal_during_the_imports_ends_the_node_cleanly():
    code = "from ship_node.live.start import start_node; start_node('ship_testing.relay_adapter', 'RelayAdapter')"
    with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT / "test", stderr=subprocess.PIPE) as process:
        proc = Path(f"/proc/{process.pid}")
        deadline_s = time.monotonic() + 30.0
        while not _is_caught(proc, signal.SIGTERM):
            assert time.monotonic() < deadline_s
        was_reading = "_rclpy_pybind11" not in (proc / "maps").read_text()
        process.terminate()
        assert process.wait(timeout=30) == 0
        assert process.stderr is not None
        assert process.stderr.read() == b""
    assert was_reading


def _is_caught(proc: Path, number: signal.Signals) -> bool:
    """Return True if a process has a handler for a signal."""
    (mask,) = [line.split()[1] for line in (proc / "status").read_text().splitlines() if line.startswith("SigCgt")]
    return bool(int(mask, 16) >> (number - 1) & 1)
