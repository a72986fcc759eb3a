from dataclasses import dataclass

import pytest
import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import full_name, in_any_namespace
from ship_estimation.parameters.fields import parameter, section
from ship_node.parameters.parameter_file import (
    load_config,
    read_matching_sections,
    read_node_parameters,
    section_warning,
)

RCLError = rclpy_implementation.RCLError


@dataclass(frozen=True)
class GateConfig:
    probability: float = parameter(0.99, doc="gate", minimum=0.5, maximum=1.0)


@dataclass(frozen=True)
class Config:
    gate: GateConfig = section(GateConfig)
    lag_s: float = parameter(2.0, doc="lag", unit="s", minimum=0.0)


RUNS = "/ship", "/fleet/ship", "/fleet/blue/ship"
"""Full names of three nodes."""


@pytest.mark.live
@pytest.mark.parametrize(
    ("section", "fits"),
    [
        ("ship", "/ship"),
        ("/ship", "/ship"),
        ("/**", "/ship /fleet/ship /fleet/blue/ship"),
        ("**", "/ship /fleet/ship /fleet/blue/ship"),
        ("/*", "/ship"),
        ("/**/ship", "/ship /fleet/ship /fleet/blue/ship"),
        ("**/ship", "/ship /fleet/ship /fleet/blue/ship"),
        ("/*/ship", "/fleet/ship"),
        ("fleet/ship", "/fleet/ship"),
        ("/fleet/**", "/fleet/ship /fleet/blue/ship"),
        ("/fleet/*", "/fleet/ship"),
        ("/fleet/*/ship", "/fleet/blue/ship"),
        ("/fleet/**/ship", "/fleet/ship /fleet/blue/ship"),
        ("/**/fleet/ship", "/fleet/ship"),
        ("/*/**", "/ship /fleet/ship /fleet/blue/ship"),
        ("/fleet: ship", "/fleet/ship"),
        ("/fleet/: ship", "/fleet/ship"),
        ("/fleet/: blue: ship", "/fleet/blue/ship"),
        ("/**: ship", "/ship /fleet/ship /fleet/blue/ship"),
        ("/boat", ""),
        ("/**/boat", ""),
        ("/ship/boat", ""),
        ("/navy/**", ""),
    ],
)
def test_sections_match_the_same_nodes_as_in_rcl(tmp_path, section, fits):
    """The parameters read here and those that rcl itself reads are compared with the expected ones."""
    path = tmp_path / "suite.yaml"
    path.write_text(in_section(section, "lag_s: 1.5"))
    expected = {node: {"lag_s": 1.5} if node in fits.split() else {} for node in RUNS}
    assert {node: read_matching_sections(path, node).values for node in RUNS} == expected
    assert {node: given_by_rcl(path, node) for node in RUNS} == expected


def in_section(section, parameters):
    """Return a parameter file; each ``: `` in the name of the section begins a nested level."""
    names = section.split(": ")
    return "".join(f"{{'{name}': " for name in names) + f"{{ros__parameters: {{{parameters}}}}}" + "}" * len(names)


def given_by_rcl(path, node):
    """Return the parameters that rcl gives a node of that full name from a file."""
    context = Context()
    namespace, _, name = node.rpartition("/")
    remaps = ["-r", f"__ns:={namespace or '/'}", "-r", f"__node:={name}"]
    rclpy.init(args=["x", "--ros-args", "--params-file", str(path), *remaps], context=context)
    live = Node("x", context=context, enable_rosout=False, start_parameter_services=False)
    overrides = {parameter: value.value for parameter, value in live._parameter_overrides.items()}
    live.destroy_node()
    context.shutdown()
    return overrides


@pytest.mark.parametrize("section", ["/sh*", "ship/", "/a//ship", "/**ship", "a-b/ship", "/7/ship", "/a: /ship"])
def test_names_that_rcl_refuses_are_refused_with_their_line(tmp_path, section):
    path = tmp_path / "suite.yaml"
    path.write_text("# a ship\n" + in_section(section, "x: 1"))
    with pytest.raises(BadInput, match=r"suite\.yaml:2: section '.*' is not a node name: expected letters, digits"):
        read_matching_sections(path, "/ship")
    with pytest.raises(RCLError):
        rclpy.init(args=["x", "--ros-args", "--params-file", str(path)], context=Context())


AURORA = "/aurora/ship_attitude"


@pytest.mark.parametrize(
    ("section", "node", "advice"),
    [
        ("ship_attitude", AURORA, ", or run the node in that of the section (give it no namespace)"),
        (
            "/palmer/ship_attitude",
            AURORA,
            ", or run the node in that of the section (-r __ns:=/palmer, of a tool --namespace palmer)",
        ),
        ("/palmer/**/ship_attitude", AURORA, ""),
        ("/aurora/ship_atitude", AURORA, ""),
        ("ShipAttitude", "/ship_attitude", ""),
        ("ship_attitude_node", "/ship_attitude", ""),
        ("ship_attitude", "/ship_attitude_2", ""),
    ],
)
def test_a_section_with_a_similar_name_is_refused_with_both_names(section, node, advice):
    text = f"/**/star_attitude: {{ros__parameters: {{x: 1}}}}\n{section}: {{ros__parameters: {{x: 1}}}}\n"
    name = node.rpartition("/")[2]
    expected = (
        f"configuration:2: section '/{section.lstrip('/')}' does not fit node '{node}': name it '/**/{name}' to fit "
    )
    for reading in (section_warning, read_node_parameters):
        with pytest.raises(BadInput) as caught:
            reading(text, node)
        assert str(caught.value) == f"{expected}in every namespace{advice}"


def test_an_empty_group_is_refused():
    """rcl drops empty groups, so the reference would be missing."""
    text = "/**/ship_attitude:\n  ros__parameters:\n    references:\n      gyro: {}\n"
    with pytest.raises(BadInput, match=r"configuration:4: group 'references\.gyro' is empty: give it a parameter, or"):
        read_node_parameters(text, AURORA)


def test_a_file_for_other_nodes_is_a_warning():
    text = "/**/star_attitude: {ros__parameters: {x: 1}}\n/ship: {ros__parameters: {x: 1}}\n"
    expected = f"no section is for node '{AURORA}', its sections are '/**/star_attitude', '/ship'"
    assert section_warning(text, AURORA) == f"configuration: {expected}"
    with pytest.raises(BadInput, match="no section for node 'ship_attitude'"):
        read_node_parameters(text, AURORA)


def test_a_section_for_all_nodes_matches():
    """ros2 launch writes inline parameters as such a section. A section with the node's name in another namespace is
    then a warning, unless a section with the node's name matches too.
    """
    inline = "/**: {ros__parameters: {lag_s: 1.0}}\n"
    assert section_warning(inline, AURORA) == ""
    assert section_warning(f"{inline}/**/ship_attitude: {{ros__parameters: {{x: 1}}}}\n", AURORA) == ""
    missed = f"{inline}ship_attitude: {{ros__parameters: {{x: 1}}}}\n"
    assert section_warning(missed, AURORA).startswith(
        f"configuration:2: section '/ship_attitude' does not fit node '{AURORA}'"
    )
    fleet = f"{inline}/a/ship_attitude: {{ros__parameters: {{x: 1}}}}\n{AURORA}: {{ros__parameters: {{x: 2}}}}\n"
    assert section_warning(fleet, AURORA) == ""
    assert read_node_parameters(fleet, AURORA).values == {"lag_s": 1.0, "x": 2}


def test_a_node_in_any_namespace():
    for node in ("ship", "/a/ship", "/**"):
        assert read_node_parameters(f"{node}: {{ros__parameters: {{x: 1}}}}\n", in_any_namespace("ship")).values == {
            "x": 1
        }
    names = [full_name("ship", namespace) for namespace in ("", "/", "a", "/a/b/")]
    assert names == ["/ship", "/ship", "/a/ship", "/a/b/ship"]


def test_later_sections_override_earlier_ones_parameter_by_parameter():
    text = """
ship:
  ros__parameters:
    gate.probability: 0.9
    lag_s: 3.0
/**:
  ros__parameters:
    gate:
      probability: 0.8
boat:
  ros__parameters: {lag_s: 7.0}
"""
    file = read_node_parameters(text, "ship")
    assert file.values == {"gate": {"probability": 0.8}, "lag_s": 3.0}
    assert file.lines == {"gate": 4, "gate.probability": 9, "lag_s": 5}


def test_a_file_for_other_nodes_may_have_no_section():
    assert read_matching_sections("boat:\n  ros__parameters: {x: 1}\n", "ship").values == {}


def test_sections_of_several_namespaces_for_a_node_in_any_namespace():
    text = "a/ship:\n  ros__parameters: {x: 1}\nb/ship:\n  ros__parameters: {x: 2}\n"
    with pytest.raises(BadInput, match="sections /a/ship and /b/ship both fit node 'ship': keep one"):
        read_node_parameters(text, in_any_namespace("ship"))


def test_configuration_is_built_and_checked():
    assert load_config(Config, "ship:\n  ros__parameters: {lag_s: 3}\n", "ship") == Config(lag_s=3.0)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            "    lag_s: 1.0\n    gate:\n      probability: 3.0\n",
            "configuration:5: parameter 'gate.probability' = 3.0 is out of its range [0.5, 1.0]",
        ),
        (
            "    gate:\n      probabilty: 0.9\n",
            (
                "configuration:4: parameter 'gate.probabilty' is unknown: expected one of probability; "
                "did you mean 'probability'?"
            ),
        ),
        ("    gate: 5\n", "configuration:3: parameter 'gate' must be a group of parameters, got 5"),
    ],
)
def test_bad_parameters_are_refused_with_line(body, message):
    with pytest.raises(BadInput) as caught:
        load_config(Config, f"ship:\n  ros__parameters:\n{body}", "ship")
    assert str(caught.value) == message
