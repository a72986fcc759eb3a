"""Sections of parameter files: values as ROS reads them, the line of each, and refusals with their location."""

import math
import os
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import ParameterFile, merge_sections, read_nested_parameters, read_sections, sections_text
from ship_geometry.input_error import InputError


def read_merged(source: Path | str) -> ParameterFile:
    """Return all sections of a file as one."""
    return merge_sections(*read_sections(source))


def test_file_and_text_give_the_same(tmp_path):
    text = "ship:\n  ros__parameters:\n    gate: {probability: 0.9}\n"
    path = tmp_path / "suite.yaml"
    path.write_text(text)
    assert read_merged(path).values == read_merged(text).values == {"gate": {"probability": 0.9}}


def test_a_text_is_never_used_as_a_path(tmp_path):
    """An attachment without a line break was once read as a file name, and lines of that file were shown."""
    (tmp_path / "secret").write_text("root: $6$hash\n")
    with pytest.raises(BadInput) as caught:
        read_merged(str(tmp_path / "secret"))
    assert "configuration:1: the file: expected 'name: value' entries" in str(caught.value)
    assert "hash" not in str(caught.value)
    assert read_merged("ship: {ros__parameters: {a: 1}}").values == {"a": 1}


_SECTION = "  ship_attitude:\n    ros__parameters: {a: 1}\n"
_SHARED = "  ros__parameters: {use_sim_time: false}\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (f"/**:\n{_SHARED}{_SECTION}", ":3: 'ship_attitude' follows 'ros__parameters' of '/**'"),
        (f"ns:\n{_SHARED}  deeper: {{x: {{ros__parameters: {{a: 1}}}}}}\n", ":3: 'deeper' follows"),
        ("x:\n  ros__parameters: {a: &p 1, b: *p}\n", ":2: the value here is used again by an alias"),
        ("x:\n  ros__parameters:\n", ":2: ros__parameters: expected 'name: value' entries, got nothing"),
        ("x:\n  ros__parameters: {a: 1}\n  other: 3\n", ":3: 'other' follows 'ros__parameters' of 'x'"),
        ("x:\n  other: 3\n", ":2: x/other: expected 'name: value' entries"),
        ("x:\n  ros__parameters: {a: }\n", ":2: parameter 'a' has no value"),
        ("12:\n  ros__parameters: {a: 1}\n", ":1: section '12' is not a node name"),
        (f"/**:\n{_SECTION}{_SHARED}", ""),
        (f"/**:\n{_SHARED}ship_attitude:\n  ros__parameters: {{a: 1}}\n", ""),
        ("a:\n  b:\n    c: {ros__parameters: {a: 1}}\n  d:\n    ros__parameters: {a: 1}\n", ""),
        ("x:\n  ros__parameters: {a: &p 1}\n", ""),
        ("x:\n  ros__parameters: {}\n", ""),
    ],
)
def test_a_file_is_refused_where_rcl_refuses_it(tmp_path, text, complaint):
    """Each of these files is accepted if and only if rcl accepts it as the parameter file of a node."""
    path, context = tmp_path / "suite.yaml", Context()
    path.write_text(text)
    try:
        rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
        context.try_shutdown()
        is_refused_by_rcl = False
    except RuntimeError:
        is_refused_by_rcl = True
    assert is_refused_by_rcl == bool(complaint)
    if complaint:
        with pytest.raises(BadInput) as caught:
            read_sections(path)
        assert complaint in str(caught.value)
    else:
        assert read_sections(path)


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
            "configuration: its aliases expand to more than 1000000 values",
        ),
    ],
    ids=["NUL", "digits", "hexadecimal", "65 bits", "nested list", "nested groups", "long", "aliases"],
)
def test_endless_expansion_is_refused_in_one_line(text, complaint):
    with pytest.raises(BadInput) as caught:
        read_merged(text)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


def test_middlewares_own_parameters_are_left_out_but_have_a_line():
    text = "ship:\n  ros__parameters:\n    use_sim_time: true\n    lag_s: 1.0\n    qos_overrides: {/a: {depth: 5}}\n"
    file = read_merged(text)
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
    got = read_merged(f"ship:\n  ros__parameters: {{x: {written}}}\n").values["x"]
    assert (got, type(got)) == (value, type(value))


def test_not_a_number_is_a_number():
    assert math.isnan(read_merged("ship:\n  ros__parameters: {x: .nan}\n").values["x"])


@pytest.mark.parametrize(
    ("body", "line", "text"),
    [
        ("    a: 1\n    b: {c: 2\n", 5, "not YAML: expected ',' or '}'"),
        ("    a: 1\n    a: 2\n", 4, "'a' is given twice, first in line 3"),
        ("    a:\n", 3, "parameter 'a' has no value"),
        ("    a: 1\n    b:\n      c: {}\n", 5, "group 'b.c' is empty: give it a parameter, or remove it"),
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
        read_merged(path)
    assert str(caught.value).startswith(f"{path}:{line}: {text}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("\n", "configuration: empty: expected a section"),
        ("ros__parameters:\n  a: 1\n", "configuration:1: 'ros__parameters' must be below the name of a node"),
        ("ship:\n  lag_s: 2\n", "configuration:2: ship/lag_s: expected 'name: value' entries, got a single value (2)"),
        (
            "ship:\n  ros__parameters: {x: 1}\n/ship/:\n  ros__parameters: {x: 2}\n",
            "configuration:3: section '/ship/' is not a node name",
        ),
        ("a: \x00\n", "configuration: not YAML"),
        ("ship:\n  ros__parameters: &a {b: *a}\n", "configuration: nested too deeply, or a group that contains itself"),
    ],
)
def test_invalid_parameter_files(text, complaint):
    with pytest.raises(BadInput, match="configuration") as caught:
        read_merged(text)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pipe_or_device_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(BadInput, match="cannot be read: it is a pipe, a device or a socket: expected a file"):
            read_nested_parameters(path)
    with pytest.raises(BadInput, match=r"absent\.yaml: cannot be read: No such file"):
        read_merged(tmp_path / "absent.yaml")
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP\xff\x00")
    with pytest.raises(BadInput, match=r"bag\.mcap: is not a text file"):
        read_merged(tmp_path / "bag.mcap")


def test_parameter_file_round_trip():
    sections = {"/a/ship": {"x": 1, "gate": {"name": "5", "on": True}}, "/**/boat": {"y.z": [1.5, 2.0]}}
    name, read = read_sections(sections_text(sections))
    assert name == "configuration"
    assert {section.node: {key: value for key, (value, _) in section.parameters.items()} for section in read} == {
        "/a/ship": {"x": 1, "gate.name": "5", "gate.on": True},
        "/**/boat": {"y.z": [1.5, 2.0]},
    }


def test_a_parameter_error_has_file_and_line_as_data():
    file = read_nested_parameters("camera:\n  width_px: 5\n")
    problem = file.error(InputError("is too small", parameters=("camera.width_px", "camera.height_px"), value=5))
    assert str(problem) == "configuration:2: is too small"
    assert (problem.file, problem.line, problem.value) == ("configuration", 2, 5)
    assert problem.parameters == ("camera.width_px", "camera.height_px")
    assert file.error(InputError("is missing", parameters=("camera.pitch",))).line == 2
    assert file.error(InputError("is missing", parameters=("lens",))).line is None
