"""The suite file that a simulation writes is what the nodes take: each parameter known, each value the scenario's."""

import dataclasses
import typing
from pathlib import Path

import pytest
import yaml

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ros.star_attitude_adapter import StarAttitudeAdapter
from ship_bags.parameter_yaml import PARAMETERS_KEY, anywhere
from ship_estimation.parameters import flatten
from ship_node.parameters.parameter_file import load_config
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite.suite import suite_yaml
from theodolite_calib.ros.optical_axis_adapter import OpticalAxisAdapter

SCENARIOS = sorted((Path(__file__).parents[1] / "bags" / "scenarios").glob("*.yaml"))
ADAPTERS = {adapter.node_name: adapter for adapter in (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter)}


@pytest.fixture(name="scenario", params=SCENARIOS, ids=lambda path: path.stem)
def fixture_scenario(request, tmp_path):
    text = request.param.read_text(encoding="utf-8")
    if request.param.stem == "recorded":
        # Its recording is not in the repository: any file in its place, which nobody opens here.
        (tmp_path / "recording.mcap").touch()
        values = yaml.safe_load(text)
        values["carrier"]["recording"]["bag"] = "recording.mcap"
        text = yaml.safe_dump(values)
    path = tmp_path / request.param.name
    path.write_text(text, encoding="utf-8")
    return load_scenario(path)


def told_nodes(scenario):
    """Node → (its configuration as loaded, the parameters that the file gives it, nested)."""
    text = suite_yaml(scenario)
    sections = yaml.safe_load(text)
    nodes = {section.rpartition("/")[2]: values[PARAMETERS_KEY] for section, values in sections.items()}
    return {
        node: (load_config(ADAPTERS[node].config_type, text, anywhere(node)), values) for node, values in nodes.items()
    }


def test_the_nodes_take_the_suite_file_of_each_scenario_as_it_stands(scenario):
    nodes = told_nodes(scenario)
    assert nodes
    for config, values in nodes.values():
        loaded, told = flatten(config), dict(flat(values))
        assert {name: loaded[name] for name in told} == told


def test_what_a_scenario_and_a_node_call_by_one_name_is_told(scenario):
    for config, values in told_nodes(scenario).values():
        for device, told, kind in devices(scenario, config, values):
            missing = shared_names(device, kind) - told.keys()
            assert not missing, (type(device).__name__, kind.__name__, missing)


def flat(values, prefix=""):
    for name, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def devices(scenario, config, values):
    """(device of the scenario, what the node is told of it, the node's dataclass for it), its groups likewise."""
    yield from grouped(scenario.ins, values["ins"], type(config.ins))
    for key, told in values.get("star_sensors", {}).items():
        yield from grouped(scenario.star_sensors[key], told, type(config.star_sensors[key]))
    for key, told in values.get("references", {}).items():
        yield from grouped(scenario.references[key], told, type(config.references[key]))
    for key, told in values.get("beacons", {}).items():
        yield from grouped(scenario.beacons[key], told, type(config.beacons[key]))
    if "telescope" in values:
        yield from grouped(scenario.theodolite, values, type(config))


def grouped(device, told, kind):
    yield device, told, kind
    for name, group in typing.get_type_hints(kind).items():
        # A camera belongs to sensors that give single stars, the only ones that are told of it.
        if dataclasses.is_dataclass(group) and hasattr(device, name) and (name != "camera" or name in told):
            yield from grouped(getattr(device, name), told[name], group)


def shared_names(device, kind):
    """Names that are a plain value of both."""
    values = {field.name for field in dataclasses.fields(device)} & {field.name for field in dataclasses.fields(kind)}
    return {name for name in values if not isinstance(getattr(device, name), dict)} - {
        name for name in values if dataclasses.is_dataclass(getattr(device, name))
    }
