import math
from dataclasses import dataclass

import pytest

from ship_estimation.parameters import parameter, section
from ship_node.errors import BadInput
from ship_node.parameter_file import load, load_config, read, read_whatever_fits


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
    assert load(path, "ship") == load(str(path), "ship") == load(text, "ship") == {"gate": {"probability": 0.9}}


@pytest.mark.parametrize(
    "node", ["ship", "/ship", "/fleet/ship", "'/**'", "'/*'", "/*/ship", "/**/ship", "/fleet/**", "fleet:\n  /ship"]
)
def test_ways_to_name_a_node(node):
    indent = "    " if "\n" in node else "  "
    assert load(f"{node}:\n{indent}ros__parameters: {{lag_s: 1.5}}\n", "ship") == {"lag_s": 1.5}


@pytest.mark.parametrize("node", ["boat", "/ship/boat", "ships", "/**/boat"])
def test_section_of_another_node_does_not_fit(node):
    with pytest.raises(BadInput) as caught:
        load(f"{node}:\n  ros__parameters: {{lag_s: 1.5}}\n", "ship")
    found = node if node.startswith("/") else "/" + node
    assert str(caught.value).endswith(f"no section for node 'ship': expected 'ship' or '/**', found '{found}'")


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
        ("ship:\n  lag_s: 2\n", "configuration:2: /ship/lag_s: expected 'name: value' entries, got a single value (2)"),
        (
            "a/ship:\n  ros__parameters: {x: 1}\nb/ship:\n  ros__parameters: {x: 2}\n",
            "sections /a/ship and /b/ship both",
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
            "configuration:4: parameter 'gate.probabilty' is unknown: expected one of probability",
        ),
        ("    gate: 5\n", "configuration:3: parameter 'gate' must be a group of parameters, got 5"),
    ],
)
def test_bad_parameters_are_refused_with_line(body, message):
    with pytest.raises(BadInput) as caught:
        load_config(Config, f"ship:\n  ros__parameters:\n{body}", "ship")
    assert str(caught.value) == message
