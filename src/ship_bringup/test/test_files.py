"""Launch, parameter, aggregator and service files: all names in them exist, and the XML is accepted by launch.

The grammar is that of ``launch_xml``, ``launch`` and ``launch_ros`` of Jazzy: the attributes that the parsers of their
actions accept (``launch/actions/*.py``, ``launch_ros/actions/*.py``, methods ``parse``), and the substitutions.
"""

import configparser
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from ship_bags.live.ros_process import DDS_PROFILE
from ship_bags.message_factory import RosidlFactory
from ship_bringup.commands import suite as suite_command
from ship_node.adapters.recovering_adapter import RecoveringAdapter
from ship_node.live.node_runtime import usage_text
from ship_node.parameters.parameter_file import COMPANIONS
from ship_replay.offline.replay import ADAPTERS
from ship_replay.preflight.check_config import Findings, check_file

PACKAGE = Path(__file__).parents[1]
SOURCES, ROOT = PACKAGE.parent, PACKAGE.parents[1]
LAUNCH_FILES = sorted((PACKAGE / "launch").glob("*.xml"))

CONDITIONS = {"if", "unless"}
PROCESS = {
    "name", "output", "respawn", "respawn_delay", "respawn_max_retries", "cwd", "env", "launch-prefix", "on_exit",
    "sigkill_timeout", "sigterm_timeout", "shell", "emulate_tty", *CONDITIONS,
}  # fmt: skip
GRAMMAR = {  # tag: (attributes taken, attributes that must be there, children)
    "launch": ({"version"}, set(), {"arg", "group", "node", "executable", "let", "include"}),
    "arg": ({"name", "default", "description"}, {"name"}, {"choice"}),
    "let": ({"name", "value", *CONDITIONS}, {"name", "value"}, set()),
    "group": (
        {"scoped", "forwarding", *CONDITIONS}, set(), {"push_ros_namespace", "set_remap", "node", "executable", "let"},
    ),
    "push_ros_namespace": ({"namespace", *CONDITIONS}, {"namespace"}, set()),
    "set_remap": ({"from", "to", *CONDITIONS}, {"from", "to"}, set()),
    "executable": ({"cmd", *PROCESS}, {"cmd"}, {"env"}),
    "node": ({"pkg", "exec", "args", "ros_args", "namespace", *PROCESS}, {"pkg", "exec"}, {"param", "remap", "env"}),
    "param": ({"name", "value", "type", "from", "allow_substs"}, set(), {"param"}),
    "remap": ({"from", "to"}, {"from", "to"}, set()),
}
SUBSTITUTIONS = {"var": 1, "find-pkg-share": 1, "exec-in-pkg": 2}
NOT_OURS = {("diagnostic_aggregator", "aggregator_node")}


def executables():
    """Return (package, executable) of each entry point in the ``setup.py`` files."""
    return {
        (path.parent.name, name)
        for path in SOURCES.glob("*/setup.py")
        for name in re.findall(r'"(\w+) = [\w.]+:\w+"', path.read_text(encoding="utf-8"))
    }


@pytest.fixture(params=LAUNCH_FILES, ids=lambda path: path.name)
def launch(request):
    return ET.parse(request.param).getroot()


def texts(root):
    return [value for element in root.iter() for value in element.attrib.values()]


def test_launch_files():
    assert [path.name for path in LAUNCH_FILES] == ["replay.launch.xml", "suite.launch.xml"]


def test_every_tag_and_attribute_is_accepted_by_launch(launch):
    assert launch.tag == "launch"
    for element in launch.iter():
        taken, needed, children = GRAMMAR[element.tag]
        assert set(element.attrib) <= taken, element.attrib
        assert needed <= set(element.attrib), element.attrib
        assert {child.tag for child in element} <= children, element.tag
        assert not (element.text or "").strip()
        if element.tag == "param":
            assert ("from" in element.attrib) != ("name" in element.attrib)
            assert ("name" in element.attrib) == ("value" in element.attrib)
            assert element.get("type", "str") in ("bool", "int", "float", "str")


def test_every_substitution_exists_and_every_variable_is_declared(launch):
    declared = [element.get("name") for element in launch.iter() if element.tag in ("arg", "let")]
    assert len([e for e in launch if e.tag == "arg"]) == len({e.get("name") for e in launch if e.tag == "arg"})
    for text in texts(launch):
        for inner in re.findall(r"\$\(([^)]*)\)", text):
            name, *arguments = inner.split()
            assert len(arguments) == SUBSTITUTIONS[name], text
            if name == "var":
                assert arguments[0] in declared, text
        assert "$" not in re.sub(r"\$\(([^)]*)\)", "", text)


def test_every_argument_is_used_and_described(launch):
    used = " ".join(texts(launch))
    for element in launch.iter("arg"):
        assert f"$(var {element.get('name')})" in used
        assert len(element.get("description", "")) > 10


def test_every_executable_exists(launch):
    known = executables() | NOT_OURS
    named = [(node.get("pkg"), node.get("exec")) for node in launch.iter("node")]
    found = [pair for text in texts(launch) for pair in re.findall(r"exec-in-pkg (\w+) (\w+)", text)]
    named += [(package, name) for name, package in found]
    assert named
    assert set(named) <= known


def test_every_named_parameter_and_file_exists(launch):
    helps = {"alerts": ""} | {each.node_name: usage_text(each, "package", RosidlFactory()) for each in ADAPTERS}
    for node in launch.iter("node"):
        for name in {param.get("name") for param in node.iter("param")} - {None, "use_sim_time"}:
            parameters = helps[node.get("exec")].partition("parameters (")[2]
            assert re.search(rf"^  {re.escape(name)} ", parameters, re.MULTILINE), name
    for text in texts(launch):
        for path in re.findall(r"\$\(find-pkg-share ship_bringup\)/(\S+)", text):
            assert (PACKAGE / path).is_file()


def test_missing_suite_file_ends_each_node_that_reads_it(launch):
    """launch_ros only warns of a missing ``<param from>`` file; a missing ``--params-file`` ends the node."""
    readers = {node.node_name for node in (*ADAPTERS, *COMPANIONS)}
    for node in launch.iter("node"):
        assert (node.get("ros_args") == "--params-file $(var file)") == (node.get("exec") in readers)
        assert [param.get("from") for param in node.iter("param") if "$(var" in param.get("from", "")] == []


def test_every_named_option_of_suite_exists(launch, capsys):
    with pytest.raises(SystemExit):
        suite_command.main(["--help"])
    shown = capsys.readouterr().out
    for text in texts(launch):
        if "exec-in-pkg suite" in text:
            for option in re.findall(r"--[\w-]+", text):
                assert f"  {option} " in shown, option


MISTAKES = [
    ("respawn_delay", "respawn_dely", test_every_tag_and_attribute_is_accepted_by_launch),
    ("push_ros_namespace", "push_namespace", test_every_tag_and_attribute_is_accepted_by_launch),
    ('type="bool"', 'type="boolean"', test_every_tag_and_attribute_is_accepted_by_launch),
    ("find-pkg-share", "find-package-share", test_every_substitution_exists_and_every_variable_is_declared),
    ("$(var namespace)", "$(var name_space)", test_every_substitution_exists_and_every_variable_is_declared),
    ('if="$(var star_attitude)"', 'if="true"', test_every_argument_is_used_and_described),
    ('exec="optical_axis"', 'exec="optical_axes"', test_every_executable_exists),
    ('pkg="ship_monitor"', 'pkg="ship_monitors"', test_every_executable_exists),
    ("exec-in-pkg monitor", "exec-in-pkg monitors", test_every_executable_exists),
    (
        'ros_args="--params-file $(var file)"',
        'ros_args="--param-file $(var file)"',
        test_missing_suite_file_ends_each_node_that_reads_it,
    ),
    ('name="black_box"', 'name="blackbox"', test_every_named_parameter_and_file_exists),
    ('exec="alerts"', 'exec="alert"', test_every_executable_exists),
    ("config/two_sensors.yaml", "config/two_sensor.yaml", test_every_named_parameter_and_file_exists),
]


@pytest.mark.parametrize(("right", "wrong", "check"), MISTAKES, ids=[wrong for _, wrong, _ in MISTAKES])
def test_mistake_in_a_launch_file_is_found(right, wrong, check):
    text = (PACKAGE / "launch" / "suite.launch.xml").read_text(encoding="utf-8")
    assert right in text
    with pytest.raises((AssertionError, KeyError)):
        check(ET.fromstring(text.replace(right, wrong)))


def test_mistake_in_an_option_is_found(capsys):
    text = (PACKAGE / "launch" / "replay.launch.xml").read_text(encoding="utf-8")
    with pytest.raises(AssertionError):
        test_every_named_option_of_suite_exists(ET.fromstring(text.replace("--rate", "--speed")), capsys)


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_ros2_launch_parses_the_file(path):
    pytest.importorskip("launch_ros", reason="ros2 launch is not installed here")
    frontend = pytest.importorskip("launch.frontend", reason="ros2 launch is not installed here")
    pytest.importorskip("launch_xml", reason="ros2 launch is not installed here")
    root, parser = frontend.Parser.load(str(path))
    assert parser.parse_description(root).entities


def test_parameter_files_are_the_examples_and_valid():
    names = {path.name for path in (ROOT / "examples").glob("*.yaml")}
    files = [path for path in (PACKAGE / "config").glob("*.yaml") if path.name != "diagnostic_aggregator.yaml"]
    assert {path.name for path in files} == names
    for path in files:
        assert (ROOT / "examples" / path.name).resolve() == path
        findings = Findings()
        assert check_file(path, ADAPTERS, findings)
        assert findings.errors == []


def test_shown_dds_profile_is_the_used_one():
    assert (PACKAGE / "config" / "dds_profile.xml").read_bytes() == DDS_PROFILE.read_bytes()


def test_all_files_are_installed():
    share = next(iter((ROOT / "install" / "ship_bringup" / "share").glob("ship_bringup")), None)
    if share is None:
        pytest.skip("nothing is installed here: this runs over another installation")
    for folder in ("launch", "config", "layouts", "systemd"):
        for path in (PACKAGE / folder).iterdir():
            assert (share / folder / path.name).read_bytes() == path.read_bytes()


def test_service_does_not_restart_after_bad_input():
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str
    unit.read(PACKAGE / "systemd" / "ship-suite@.service")
    service = unit["Service"]
    assert service["RestartPreventExitStatus"] == "2"
    assert service["KillMode"] == "mixed"
    _, package, executable, file, *options = service["ExecStart"].split()
    assert (package, executable) in executables()
    assert (file, options) == ("/etc/ship/%i.yaml", ["--namespace", "%i", "--monitor", "$SHIP_SUITE_OPTIONS"])


@pytest.mark.parametrize("slip", [None, ("KillMode=mixed", "KillMode=mix")], ids=["as it is", "with a slip"])
def test_systemd_accepts_the_service(tmp_path, slip):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd here")
    text = (PACKAGE / "systemd" / "ship-suite@.service").read_text(encoding="utf-8")
    text = text.replace("/opt/ship/ros2run", str(ROOT / "ros2run"))
    (tmp_path / "ship-suite@demo.service").write_text(text.replace(*slip) if slip else text, encoding="utf-8")
    command = ["systemd-analyze", "verify", str(tmp_path / "ship-suite@demo.service")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    complaints = [line for line in run.stderr.splitlines() if "ship-suite@demo" in line]
    assert (run.returncode, bool(complaints)) == (0, slip is not None), run.stderr


# -- aggregator ---------------------------------------------------------------------------------------------------

ANALYZERS = "diagnostic_aggregator/GenericAnalyzer", "diagnostic_aggregator/AnalyzerGroup"
OPTIONS = {"type", "path", "name", "startswith", "find_and_remove_prefix"}


def analyzers(group):
    """Yield the generic analyzers of a group and of its groups."""
    for one in group.values():
        assert one["type"] in ANALYZERS
        if one["type"] == ANALYZERS[1]:
            assert set(one) == {"type", "path", "analyzers"}
            yield from analyzers(one["analyzers"])
        else:
            assert set(one) <= OPTIONS
            assert one.get("find_and_remove_prefix", one.get("startswith")) == one.get("startswith")
            yield one


def tree():
    document = yaml.safe_load((PACKAGE / "config" / "diagnostic_aggregator.yaml").read_text(encoding="utf-8"))
    (section,) = document.values()
    parameters = section["ros__parameters"]
    assert isinstance(parameters.pop("path"), str)
    return list(analyzers(parameters))


def names_in_code(*patterns):
    """Return names of statuses in the code of some files; '{}' stands for the name of a source or topic."""
    made = set()
    for path in {path for pattern in patterns for path in SOURCES.glob(pattern) if "test" not in path.parts}:
        code = path.read_text(encoding="utf-8")
        made |= set(re.findall(r'DiagnosticStatus\(\s*f?"([a-z][^"]*)"', code))
        if "DiagnosticStatus(name, " in code:
            made |= set(re.findall(r'    name = f"([a-z][^"]*)"', code))
    return {re.sub(r"\{[^}]*\}", "{}", name) for name in made}


ADAPTER_NODES = {node.node_name for node in ADAPTERS}
RECOVERING_NODES = {node.node_name for node in ADAPTERS if issubclass(node, RecoveringAdapter)}
NMEA_NODES = {companion.node_name for companion in COMPANIONS}
MAKERS = {  # files that make statuses: nodes that publish them
    "ship_attitude_star/*/adapters/ship_attitude_adapter.py": {"ship_attitude"},
    "ship_attitude_star/*/adapters/star_attitude_adapter.py": {"star_attitude"},
    "theodolite_calib/*/adapters/optical_axis_adapter.py": {"optical_axis"},
    "theodolite_calib/*/adapters/triangulation_adapter.py": {"triangulation"},
    "ship_node/*/adapters/recovering_adapter.py": RECOVERING_NODES,
    "ship_node/*/messages/common_messages.py": RECOVERING_NODES,
    "ship_node/*/adapters/node_adapter.py": ADAPTER_NODES,
    "ship_node/*/adapters/adapter_report.py": ADAPTER_NODES,
    "ship_node/*/adapters/input_processing.py": ADAPTER_NODES,
    "ship_node/*/health/input_health.py": ADAPTER_NODES,
    "ship_node/*/health/time_base.py": ADAPTER_NODES,
    "ship_node/*/black_box/*.py": ADAPTER_NODES,
    "ship_node/*/live/node_report.py": ADAPTER_NODES | NMEA_NODES | {"alerts"},
    "ship_node/*/live/node_clock.py": ADAPTER_NODES | NMEA_NODES,
    "ship_node/*/live/node_events.py": ADAPTER_NODES | NMEA_NODES,
    "ship_node/*/live/ros_parameters.py": ADAPTER_NODES | NMEA_NODES,
    "ship_nmea/*/out/*.py": {"nmea_out"},
    "ship_nmea/*/instruments/*.py": {"nmea_in"},
    "ship_monitor/*/alerts/*.py": {"alerts"},
}
NOT_PUBLISHED = {  # status: nodes of its file in MAKERS that do not publish it
    "clocks": ADAPTER_NODES - RECOVERING_NODES,
    "conflict {}": ADAPTER_NODES - RECOVERING_NODES,
    "verdict {}": ADAPTER_NODES - RECOVERING_NODES,
    "stamps": NMEA_NODES | {"alerts"},
    "name": {"alerts"},
}


def names_of(node):
    made = {name for pattern, nodes in MAKERS.items() if node in nodes for name in names_in_code(pattern)}
    return {f"{node}: {name}" for name in made if node not in NOT_PUBLISHED.get(name, ())}


def test_every_file_with_statuses_is_listed():
    assert names_in_code("*/*/**/*.py") == names_in_code(*MAKERS)


@pytest.mark.parametrize("node", sorted(ADAPTER_NODES | NMEA_NODES | {"alerts"}))
def test_every_status_of_a_node_has_an_analyzer(node):
    """The aggregator puts statuses without an analyzer under "Other"."""
    names = [name for analyzer in tree() for name in analyzer.get("name", [])]
    prefixes = tuple(prefix for analyzer in tree() for prefix in analyzer.get("startswith", []))
    assert {name for name in names_of(node) if name not in names and not name.startswith(prefixes)} == set()


def test_every_name_in_the_aggregator_file_is_a_status():
    published = {name for node in ADAPTER_NODES | NMEA_NODES | {"alerts"} for name in names_of(node)}
    for analyzer in tree():
        assert set(analyzer.get("name", [])) - published == set()
        for prefix in analyzer.get("startswith", []):
            assert any(name.startswith(prefix) and "{}" in name for name in published), prefix
