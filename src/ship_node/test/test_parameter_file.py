import math
from dataclasses import dataclass

import pytest
import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import anywhere, full_name
from ship_estimation.parameters import parameter, section
from ship_node.parameters.parameter_file import load, load_config, misfit, read, read_whatever_fits

RCLError = rclpy_implementation.RCLError


@dataclass(frozen=True)
class GateConfig:
    probability: float = parameter(0.99, doc="gate", minimum=0.5, maximum=1.0)


@dataclass(frozen=True)
class Config:
    gate: GateConfig = section(GateConfig)
    lag_s: float = parameter(2.0, doc="lag", unit="s", minimum=0.0)


def test_file_and_text_give_the_same(tmp_path):
    text = "ship:\n  ros__parameters:\n    gate: {probability: 0.9}\n"
    path = tmp_path / "suite.yaml"
    path.write_text(text)
    assert load(path, "ship") == load(text, "ship") == {"gate": {"probability": 0.9}}


def test_mend_25_a_text_is_never_taken_for_a_path(tmp_path):
    """An attachment without a line break named any file, which was read, and its lines shown."""
    (tmp_path / "secret").write_text("root: $6$hash\n")
    with pytest.raises(BadInput) as caught:
        load(str(tmp_path / "secret"), "ship")
    assert "configuration:1: the file: expected 'name: value' entries" in str(caught.value)
    assert "hash" not in str(caught.value)
    assert load("ship: {ros__parameters: {a: 1}}", "ship") == {"a": 1}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("\x00" * 5000, "configuration: not YAML"),
        (f"ship: {{ros__parameters: {{a: {'9' * 5000}}}}}", "parameter 'a' is a number of 5000 digits"),
        (f"ship: {{ros__parameters: {{a: -0x{'f' * 5000}}}}}", "parameter 'a' is a number of 5000 digits"),
        (f"ship: {{ros__parameters: {{a: {2**63}}}}}", "parameter 'a' is a number of 19 digits: expected one of 64"),
        ("ship:\n  ros__parameters:\n    a: " + "[" * 100_000, "configuration: nested too deeply"),
        ("ship: {ros__parameters: " + "{a: " * 60 + "1" + "}" * 61, "configuration: nested too deeply"),
        ("a: 1\n" * 1_000_000, "configuration: 5000000 characters: expected a text of at most"),
        (
            "a0: &a0 {x: 1}\n"
            + "".join(f"a{n}: &a{n} {{{', '.join(f'k{k}: *a{n - 1}' for k in range(9))}}}\n" for n in range(1, 12))
            + "ship: {ros__parameters: {x: *a11}}\n",
            "configuration: its aliases unfold to more than 1000000 values",
        ),
    ],
    ids=["NUL", "digits", "hexadecimal", "65 bits", "nested list", "nested groups", "long", "aliases"],
)
def test_mend_25_what_unfolds_without_end_is_one_line(text, complaint):
    with pytest.raises(BadInput) as caught:
        load(text, "ship")
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


RUNS = "/ship", "/fleet/ship", "/fleet/blue/ship"
"""Full names of three nodes."""


@pytest.mark.live
@pytest.mark.xdist_group("dds")
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
def test_mend_12_sections_fit_the_nodes_that_rcl_gives_them_to(tmp_path, section, fits):
    """Held against rcl itself."""
    path = tmp_path / "suite.yaml"
    path.write_text(in_section(section, "lag_s: 1.5"))
    expected = {node: {"lag_s": 1.5} if node in fits.split() else {} for node in RUNS}
    assert {node: read_whatever_fits(path, node).values for node in RUNS} == expected
    assert {node: given_by_rcl(path, node) for node in RUNS} == expected


def in_section(section, parameters):
    """A parameter file; ``: `` in the name of the section nests it."""
    names = section.split(": ")
    return "".join(f"{{'{name}': " for name in names) + f"{{ros__parameters: {{{parameters}}}}}" + "}" * len(names)


def given_by_rcl(path, node):
    """What a node of that full name is given of a file."""
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
def test_mend_12_names_that_rcl_refuses_are_refused_with_their_line(tmp_path, section):
    path = tmp_path / "suite.yaml"
    path.write_text("# a ship\n" + in_section(section, "x: 1"))
    with pytest.raises(BadInput, match=r"suite\.yaml:2: section '.*' is no name of a node: expected letters, digits"):
        read_whatever_fits(path, "/ship")
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
def test_mend_12_a_section_meant_for_the_node_that_does_not_fit_is_refused_with_both_names(section, node, advice):
    text = f"/**/star_attitude: {{ros__parameters: {{x: 1}}}}\n{section}: {{ros__parameters: {{x: 1}}}}\n"
    name = node.rpartition("/")[2]
    said = f"configuration:2: section '/{section.lstrip('/')}' does not fit node '{node}': name it '/**/{name}' to fit "
    for reading in (misfit, read):
        with pytest.raises(BadInput) as caught:
            reading(text, node)
        assert str(caught.value) == f"{said}in every namespace{advice}"


def test_mend_12_a_device_with_nothing_but_defaults_is_not_dropped_silently():
    """rcl drops empty groups, so the reference would not be there."""
    text = "/**/ship_attitude:\n  ros__parameters:\n    references:\n      gyro: {}\n"
    with pytest.raises(BadInput, match=r"configuration:4: group 'references\.gyro' is empty: give it a parameter, or"):
        read(text, AURORA)


def test_mend_12_a_file_about_other_nodes_is_a_warning():
    text = "/**/star_attitude: {ros__parameters: {x: 1}}\n/ship: {ros__parameters: {x: 1}}\n"
    said = f"nothing in it is for node '{AURORA}', its sections are '/**/star_attitude', '/ship'"
    assert misfit(text, AURORA) == f"configuration: {said}"
    with pytest.raises(BadInput, match="no section for node 'ship_attitude'"):
        read(text, AURORA)


def test_mend_12_a_section_for_all_nodes_fits():
    """What ros2 launch writes for inline parameters; where a section of the node's name misses it, that is said."""
    inline = "/**: {ros__parameters: {lag_s: 1.0}}\n"
    assert misfit(inline, AURORA) == ""
    assert misfit(f"{inline}/**/ship_attitude: {{ros__parameters: {{x: 1}}}}\n", AURORA) == ""
    missed = f"{inline}ship_attitude: {{ros__parameters: {{x: 1}}}}\n"
    assert misfit(missed, AURORA).startswith(f"configuration:2: section '/ship_attitude' does not fit node '{AURORA}'")
    fleet = f"{inline}/a/ship_attitude: {{ros__parameters: {{x: 1}}}}\n{AURORA}: {{ros__parameters: {{x: 2}}}}\n"
    assert misfit(fleet, AURORA) == ""
    assert load(fleet, AURORA) == {"lag_s": 1.0, "x": 2}


def test_a_node_that_ran_in_whatever_namespace():
    for node in ("ship", "/a/ship", "/**"):
        assert load(f"{node}: {{ros__parameters: {{x: 1}}}}\n", anywhere("ship")) == {"x": 1}
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
    file = read(text, "ship")
    assert file.values == {"gate": {"probability": 0.8}, "lag_s": 3.0}
    assert file.lines == {"gate": 4, "gate.probability": 9, "lag_s": 5}


def test_middlewares_own_parameters_are_left_out_but_have_a_line():
    text = "ship:\n  ros__parameters:\n    use_sim_time: true\n    lag_s: 1.0\n    qos_overrides: {/a: {depth: 5}}\n"
    file = read(text, "ship")
    assert file.values == {"lag_s": 1.0}
    assert file.line_of("qos_overrides./a.subscription") == 5


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("1e-3", 0.001),
        ("-.5", -0.5),
        ("3.", 3.0),
        ("0x10", 16),
        ("-7", -7),
        ("yes", True),
        ("Off", False),
        ("'5'", "5"),
        ("1:30", "1:30"),
        ("2024-01-31", "2024-01-31"),
        ("-.inf", -math.inf),
        ("[1.0, 2.5]", [1.0, 2.5]),
        ("[]", []),
        ("''", ""),
    ],
)
def test_values_are_read_as_ros_reads_them(written, value):
    got = load(f"ship:\n  ros__parameters: {{x: {written}}}\n", "ship")["x"]
    assert (got, type(got)) == (value, type(value))


def test_not_a_number_is_a_number():
    assert math.isnan(load("ship:\n  ros__parameters: {x: .nan}\n", "ship")["x"])


@pytest.mark.parametrize(
    ("body", "line", "text"),
    [
        ("    a: 1\n    b: {c: 2\n", 5, "not YAML: expected ',' or '}'"),
        ("    a: 1\n    a: 2\n", 4, "'a' was given before, in line 3"),
        ("    a:\n", 3, "parameter 'a' has no value"),
        ("    a: 1\n    b:\n      c: {}\n", 5, "group 'b.c' is empty: give it a parameter, or take it out"),
        ("    a: [1, x]\n", 3, "parameter 'a' mixes int and str: all elements of a list must be of one type"),
        ("    a: [[1], [2]]\n", 3, "parameter 'a' is a list of lists: expected a plain list"),
        ("    a: [{b: 1}]\n", 3, "parameter 'a' is a list of groups: expected a plain list"),
        ("    - a\n", 3, "ros__parameters: expected 'name: value' entries, got a list"),
        ("    a: 1\n    a.b: 2\n", 4, "parameter 'a.b': 'a' is a value elsewhere, not a group"),
        ("    a.b: 1\n    a: 2\n", 4, "parameter 'a' is a group elsewhere, not a value"),
    ],
)
def test_bad_files_are_refused_with_name_and_line(tmp_path, body, line, text):
    path = tmp_path / "suite.yaml"
    path.write_text(f"ship:\n  ros__parameters:\n{body}")
    with pytest.raises(BadInput) as caught:
        load(path, "ship")
    assert str(caught.value).startswith(f"{path}:{line}: {text}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("\n", "configuration: empty: expected a section"),
        ("ros__parameters:\n  a: 1\n", "configuration:1: 'ros__parameters' must stand below the name of a node"),
        ("ship:\n  lag_s: 2\n", "configuration:2: ship/lag_s: expected 'name: value' entries, got a single value (2)"),
        (
            "ship:\n  ros__parameters: {x: 1}\n/ship/:\n  ros__parameters: {x: 2}\n",
            "configuration:3: section '/ship/' is no name of a node",
        ),
        ("a: \x00\n", "configuration: not YAML"),
        ("ship:\n  ros__parameters: &a {b: *a}\n", "configuration: nested too deeply, or a group that holds itself"),
    ],
)
def test_what_is_no_parameter_file(text, complaint):
    with pytest.raises(BadInput, match="configuration") as caught:
        load(text, "ship")
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_file_that_cannot_be_read(tmp_path):
    with pytest.raises(BadInput, match=r"absent\.yaml: cannot be read: No such file"):
        load(tmp_path / "absent.yaml", "ship")
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP\xff\x00")
    with pytest.raises(BadInput, match=r"bag\.mcap: is not a text file"):
        load(tmp_path / "bag.mcap", "ship")


def test_file_about_other_nodes_may_say_nothing():
    assert read_whatever_fits("boat:\n  ros__parameters: {x: 1}\n", "ship").values == {}


def test_sections_of_several_namespaces_fit_a_node_of_any():
    text = "a/ship:\n  ros__parameters: {x: 1}\nb/ship:\n  ros__parameters: {x: 2}\n"
    with pytest.raises(BadInput, match="sections /a/ship and /b/ship both fit node 'ship': keep one"):
        read(text, anywhere("ship"))


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
