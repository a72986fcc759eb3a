"""Suite files of examples/ are accepted, have comments at all parameters, and start nodes without warnings."""

import re
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.parameter_yaml import read_sections
from ship_estimation.parameters.schema import describe
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.replay import main as replay
from ship_simulation.simulate_command import main as simulate
from ship_testing.trials.live_process import LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import executable
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
NODES = {kind.node_name: kind for kind in (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter)}
VALID, DEGRADED = 0, 2
START_S = 30.0


def scenario(name: str) -> Any:
    return yaml.safe_load((ROOT / "bags" / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8"))


def two_sensors() -> Any:
    return scenario("demo")


def three_sensors() -> Any:
    return scenario("three_sensors")


def theodolite() -> Any:
    voyage = scenario("theodolite")
    voyage["fused_attitude"]["written"] = False
    voyage["star_sensors"] = scenario("demo")["star_sensors"]
    voyage["theodolite"]["telescope"]["phase_s"] = 0.1
    return voyage


def nbp1406() -> Any:
    """Return the demo scenario without star sensors: the INS has the errors configured in examples/nbp1406.yaml."""
    voyage = scenario("demo")
    del voyage["star_sensors"]
    quiet = {"tilt_sigma_arcsec": 1.0, "heading_sigma_arcsec": 1.0, "white_sigma_arcsec": 15.0}
    voyage["ins"] = {"rate_hz": 20.0, **quiet, "time_offset_sigma_s": 0.0}
    voyage["references"] = {"s330": {"rate_hz": 1.0}}
    return voyage


CASES = {
    "two_sensors": (two_sensors, "", {"ship/attitude": VALID}),
    "three_sensors": (three_sensors, "aurora", {"ship/attitude": VALID}),
    "theodolite": (theodolite, "", {"ship/attitude": VALID, "theodolite/pointing": VALID}),
    # Without stars nothing is VALID.
    "nbp1406": (nbp1406, "", {"ship/attitude": DEGRADED}),
}
"""Example → scenario of a voyage that it fits, namespace of the ship, status of each output at the end."""


def test_every_example_is_tested() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.yaml")} == set(CASES)
    # test_requirement of ship_attitude_star tests layout.yaml.
    assert [path.name for path in EXAMPLES.rglob("*") if path.parent != EXAMPLES] == ["layout.yaml"]


@pytest.mark.parametrize("name", CASES)
def test_an_example_is_valid_and_meets_its_bounds(name: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    voyage, namespace, expected = CASES[name]
    config, bag, out = EXAMPLES / f"{name}.yaml", tmp_path / "voyage.mcap", tmp_path / "out.mcap"
    assert check_config([str(config)]) == 0
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(voyage() | {"duration_s": 10.0}), encoding="utf-8")
    assert simulate([str(tmp_path / "scenario.yaml"), "--out", str(bag), "--seed", "1"]) == 0
    if namespace:
        bag = in_namespace(bag, tmp_path / "renamed.mcap", namespace)
    options = ["--namespace", namespace] if namespace else []
    assert check_config([str(config), str(bag), *options]) == 0
    assert replay([str(bag), "--config", str(config), "--out", str(out), *options]) == 0
    reported = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("warning", "error"))]
    assert reported == []
    with read_bag(out) as replayed:
        last = {record.topic: record.decode() for record in replayed.records(expected)}
    assert {topic: message.status for topic, message in last.items()} == expected
    sources = {source for source in last["ship/attitude"].sources if source != "ins"}
    assert sources == used_sources(config)


def used_sources(config: Path) -> set[str]:
    """Return star sensors and references named in the suite file."""
    ship = yaml.safe_load(config.read_text(encoding="utf-8"))["/**/ship_attitude"]["ros__parameters"]
    stars = {f"star.{id_}" for id_ in ship.get("star_sensors", {})}
    return stars | {f"reference.{name}" for name in ship.get("references", {})}


def in_namespace(bag_path: Path, path: Path, namespace: str) -> Path:
    """Return the bag as recorded aboard a ship with a namespace."""
    with read_bag(bag_path) as bag, BagWriter(path) as writer:
        for record in bag.records():
            writer.write_raw(f"/{namespace}/{record.topic}", record.type_name, record.data, record.log_time_ns)
    return path


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_parameter_is_below_a_comment_or_in_a_commented_group(path: Path) -> None:
    """A comment stands above each block of parameters, or above an earlier parameter of the same last name."""
    lines = path.read_text(encoding="utf-8").splitlines()
    commented: set[str] = set()
    _, sections = read_sections(path)
    for section in sections:
        config_type = NODES[section.node.rpartition("/")[2]].config_type
        known = {parameter.name.rpartition(".")[2] for parameter in describe(config_type)}
        for name, (_, line) in section.parameters.items():
            leaf = name.rpartition(".")[2]
            assert leaf in known
            above = line - 2
            while re.match(r"\s*[a-zA-Z]\w*: \S", lines[above]):
                above -= 1
            if lines[above].lstrip().startswith("#"):
                commented.add(leaf)
            assert leaf in commented, f"{path.name}:{line}: {name} has no comment"


def wait_for(text: str, process: LiveProcess) -> None:
    """Return when a process has printed a text."""
    end_s = time.monotonic() + START_S
    while text not in process.log_text():
        assert time.monotonic() < end_s, process.log_text()
        assert process.exit_code is None, process.log_text()
        time.sleep(0.02)


@pytest.mark.smoke
@pytest.mark.live
@pytest.mark.parametrize(
    ("example", "package", "node", "arguments"),
    [
        ("three_sensors", "ship_attitude_star", "ship_attitude", ["-r", "__ns:=/aurora"]),
        ("three_sensors", "ship_attitude_star", "star_attitude", ["-r", "__ns:=/aurora"]),
        ("theodolite", "theodolite_calib", "optical_axis", []),
    ],
)
def test_a_node_starts_with_its_example_without_warnings(
    example: str, package: str, node: str, arguments: list[str], tmp_path: Path
) -> None:
    # This override names an unknown topic. The node logs its warning last, so that all other warnings are logged by
    # then.
    last = ["-p", "qos_overrides./absent.subscription.depth:=1"]
    files = ["--params-file", str(EXAMPLES / f"{example}.yaml")]
    command = [*executable(package, node), "--ros-args", *files, *arguments, *last]
    with LiveProcess(command, tmp_path / "node.log", live_environment(free_domain_id(), tmp_path / "ros")) as process:
        wait_for("names no topic and policy", process)
        assert process.end() == 0
        logged = [line for line in process.log_text().splitlines() if "[WARN]" in line or "[ERROR]" in line]
    assert len(logged) == 1


@pytest.mark.live
def test_a_node_without_sensors_warns_at_its_start(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text("/**/radar: {ros__parameters: {gain: 1.0}}\n", encoding="utf-8")
    command = [*executable("ship_attitude_star", "ship_attitude"), "--ros-args", "--params-file", str(other)]
    with LiveProcess(command, tmp_path / "node.log", live_environment(free_domain_id(), tmp_path / "ros")) as process:
        wait_for("no star_sensors, no references and no ship_baseline are configured", process)
        assert process.end() == 0
        assert "no section is for node '/ship_attitude', its sections are '/**/radar'" in process.log_text()
