"""Help of every executable: purpose, arguments, and an example at the end."""

import ast
import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.command_line import LAUNCHER_VARIABLE
from ship_bags.message_factory import RosidlFactory
from ship_estimation.parameters.schema import describe
from ship_node.live.node_runtime import usage_text
from ship_replay.offline.replay import ADAPTERS
from ship_simulation.scenario.scenario import Fault, Scenario

ROOT = Path(__file__).parents[1]
NODES = {kind.node_name: kind for kind in ADAPTERS}
SUITE = {"nmea_in", "nmea_out", "suite", "check_config", "preflight"}
SETUPS = "".join(path.read_text(encoding="utf-8") for path in ROOT.glob("src/*/setup.py"))
# An executable that was moved to another package only prints its new package.
EXECUTABLES = re.findall(r'"(\w+) = (?!ship_bags\.commands\.moved)([\w.]+):\w+"', SETUPS)


def help_of(name, module, capsys):
    if name in NODES:
        return usage_text(NODES[name], module.partition(".")[0], RosidlFactory())
    with pytest.raises(SystemExit) as left:
        importlib.import_module(module).main(["--help"])
    assert left.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("start", ["./ros2run", "ros2 run"])
@pytest.mark.parametrize(("name", "module"), EXECUTABLES)
def test_every_help_begins_with_the_whole_command_and_ends_with_an_example(name, module, start, capsys, monkeypatch):
    monkeypatch.delenv(LAUNCHER_VARIABLE, raising=False)
    if start == "./ros2run":
        monkeypatch.setenv(LAUNCHER_VARIABLE, start)
    command = f"{start} {module.partition('.')[0]} {name}"
    shown = help_of(name, module, capsys)
    assert re.match(rf"usage: {re.escape(command)}\s+\[", shown)
    *_, head, example = shown.rstrip().splitlines()
    assert head == "example:"
    assert example.startswith(f"  {command} ")
    assert "exit code" in shown
    # Files of the repository that the example names exist, and the options of the example are in the help.
    words = shlex.split(example)
    assert all((ROOT / word).exists() for word in words if word.startswith(("bags/", "examples/")))
    assert all(word in shown for word in words if word.startswith("--"))


@pytest.mark.parametrize(("name", "module"), [row for row in EXECUTABLES if row[0] not in NODES])
def test_an_abbreviated_option_is_refused(name, module, capsys):
    with pytest.raises(SystemExit) as left:
        importlib.import_module(module).main(["--hel"])
    assert left.value.code == 2
    assert re.match(rf"{name}: .*\(see ros2 run {module.partition('.')[0]} {name} --help\)\n$", capsys.readouterr().err)


def test_no_tool_takes_abbreviated_options():
    for path in (ROOT / "tools").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("ArgumentParser"):
                assert {each.arg: ast.unparse(each.value) for each in node.keywords}["allow_abbrev"] == "False", path


@pytest.mark.parametrize("name", ["ship_attitude", "optical_axis", "nmea_in", "alerts", "replay"])
def test_a_help_with_a_closed_pipe_ends_without_output(name):
    """The exit code of ``ship_attitude --help | head -1`` is 141, as that of ``cat``."""
    module, function = re.search(rf'"{name} = ([\w.]+):(\w+)"', SETUPS).groups()
    reader, writer = os.pipe()
    os.close(reader)
    code = f"import sys; from {module} import {function}; sys.exit({function}())"
    command = [sys.executable, "-c", code, "--help"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize(("name", "module"), [row for row in EXECUTABLES if row[0] in {*NODES, *SUITE}])
def test_the_parameters_of_a_node_and_the_help_of_a_suite_are_no_wider_than_a_page(name, module, capsys):
    shown = help_of(name, module, capsys)
    looked_at = shown.partition("parameters (")[2] if name in NODES else shown
    assert max(map(len, looked_at.splitlines())) <= 120
    if name in ("suite", "check_config"):
        assert "nmea_in" in shown
        assert "nmea_out" in shown


def test_the_help_of_a_node_lists_the_inputs_of_all_configurations():
    shown = usage_text(ShipAttitudeAdapter, "ship_attitude_star", RosidlFactory())
    (choices,) = [d.choices for d in describe(ShipAttitudeConfig) if d.name == "star_sensors.<id>.input"]
    topics = shown.partition("topics out")[0]
    for choice in choices:
        assert f"star/<id>/{choice}" in topics, choice
    for topic in ("gnss/fix", "met/pressure", "met/temperature", "met/humidity", "reference/<id>/imu"):
        assert re.search(rf"^  {topic} ", topics, re.MULTILINE), topic


def test_replay_names_all_nodes_and_simulate_all_keys_and_faults(capsys):
    shown = " ".join(help_of("replay", "ship_replay.commands.replay", capsys).split())
    assert "(ship_attitude, star_attitude, optical_axis, triangulation;" in shown
    shown = help_of("simulate", "ship_simulation.simulate_command", capsys)
    assert all(f"  {d.name}" in shown for d in describe(Scenario))
    (kinds,) = [d.choices for d in describe(Fault) if d.name == "kind"]
    assert all(re.search(rf"^  {kind} ", shown, re.MULTILINE) for kind in kinds)


def test_bounds_on_the_pages_are_those_of_the_code():
    """The bounds are read back from the pages and compared exactly."""
    row = re.compile(r"^\| `([^`]+)` \|[^|]*\|[^|]*\| ([^|]*) \|", re.MULTILINE)
    pages = (ROOT / "docs" / "reference" / "parameters").glob("*.md")
    rows = {
        (page.stem.removesuffix("_inputs"), name): bounds
        for page in pages
        for name, bounds in row.findall(page.read_text(encoding="utf-8"))
    }
    count = 0
    for name, adapter in NODES.items():
        for parameter in describe(adapter.config_type):
            if parameter.choices or (parameter.minimum is None and parameter.maximum is None):
                continue
            low, high = (float(bound) if bound else None for bound in rows[name, parameter.name].split(" … "))
            assert (low, high) == (parameter.minimum, parameter.maximum), parameter.name
            count += 1
    assert count > 100
