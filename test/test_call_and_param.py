"""``call`` and ``param`` with a real node and the alert node: accepted and rejected requests, and unknown names."""

import re
import subprocess
from pathlib import Path

import pytest
from rcl_interfaces.msg import ParameterType, ParameterValue

from ship_bags.live.ros_process import executable
from ship_bringup.remote_node import parse_value, unknown_name_text, value_text
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

pytestmark = pytest.mark.live

ROOT = Path(__file__).parents[1]
NODE = "/alpha/ship_attitude"


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Return the environment of a suite of one node in the namespace alpha, and of the alert node."""
    folder = tmp_path_factory.mktemp("nodes")
    domain = free_domain_id()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        environment = live_environment(domain, folder)
        names = "--ros-args", "-r", "__ns:=/alpha"
        file = str(ROOT / "examples" / "two_sensors.yaml")
        suite = [*executable("ship_bringup", "suite"), file, "--namespace", "alpha"]
        alerts = [*executable("ship_monitor", "alerts"), "--state", str(folder / "alerts.json"), *names]
        with (
            GraphObserver(domain) as observer,
            LiveProcess(suite, folder / "suite.log", environment) as process,
            LiveProcess(alerts, folder / "alerts.log", environment),
        ):
            assert observer.wait_for({"/alpha/ship/attitude": 1, "/alpha/ship/alerts": 1}, timeout_s=60), (
                process.log_text()
            )
            yield environment


def run_command(environment, command, *arguments):
    """Return (exit code, stdout, stderr)."""
    ended = subprocess.run(
        [*executable("ship_bringup", command), *arguments, "--timeout", "15"],
        env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    return ended.returncode, ended.stdout, ended.stderr


def test_services_are_listed_and_called(environment):
    assert run_command(environment, "call", NODE) == (0, "load_alignment\nreset\nsave_alignment\n", "")
    assert run_command(environment, "call", NODE, "reset") == (0, "done: the filter was reset\n", "")
    code, printed, _ = run_command(environment, "call", NODE, "save_alignment")
    assert code == 1
    assert printed.startswith("not done: parameter 'alignment_file' is empty")


def test_an_alert_is_acknowledged_by_its_id_and_instance(environment):
    code, listed, _ = run_command(environment, "call", "/alpha/alerts")
    assert code == 0
    assert listed == "acknowledge id=<string> instance=<uint32>\nsilence\n"
    code, out, _ = run_command(environment, "call", "/alpha/alerts", "acknowledge", "id=there.is.none", "instance=7")
    assert code == 1
    assert out.startswith("not done: ")
    code, _, error = run_command(environment, "call", "/alpha/alerts", "acknowledge", "id=x")
    assert (code, error) == (2, "call: service 'acknowledge' needs instance=<uint32>\n")
    code, _, error = run_command(environment, "call", "/alpha/alerts", "acknowledge", "id=x", "instance=one")
    assert (code, error) == (2, "call: field 'instance' of service 'acknowledge': 'one' is no uint32\n")


def test_an_unknown_name_is_answered_with_the_nearest(environment):
    code, _, error = run_command(environment, "call", "/alpha/ship_atitude", "reset")
    assert (code, error.count("\n")) == (2, 1)
    assert error.startswith(f"call: no node '/alpha/ship_atitude': did you mean '{NODE}'? There are ")
    code, _, error = run_command(environment, "call", NODE, "restet")
    assert (code, "did you mean 'reset'?" in error) == (2, True)
    code, _, error = run_command(environment, "param", NODE, "gate.probabilty")
    expected = f"param: node {NODE}: no parameter 'gate.probabilty': did you mean 'gate.probability'?\n"
    assert (code, error) == (2, expected)


def test_parameters_are_listed_with_units_read_and_set(environment):
    code, listed, _ = run_command(environment, "param", NODE)
    assert code == 0
    assert re.search(r"^  alignment_max_age_d +30\.0 +\[0, 36500\] +.*\[d\]$", listed, re.MULTILINE)
    assert re.search(r"^  star_sensors\.fore\.azimuth_deg +0\.0 ", listed, re.MULTILINE)
    set_ = run_command(environment, "param", NODE, "gate.probability", "0.999")
    assert set_ == (0, "gate.probability = 0.999, was 0.9999\n", "")
    assert re.match(r"  gate\.probability\* +0\.999 ", run_command(environment, "param", NODE, "gate.probability")[1])


def test_a_source_is_removed_and_added_again(environment):
    assert run_command(environment, "param", NODE, "sources_off", "star.fore") == (
        0,
        "sources_off = star.fore, was []\n",
        "",
    )
    assert run_command(environment, "param", NODE, "sources_off", "[]") == (0, "sources_off = [], was star.fore\n", "")
    code, _, error = run_command(environment, "param", NODE, "sources_off", "fore")
    assert code == 1
    assert error.startswith(
        "param: refused: parameter 'sources_off': there is no source 'fore': expected some of star."
    )
    code, _, error = run_command(environment, "param", NODE, "sources_off", "ins")
    assert (code, "stop the publisher of ins/imu" in error) == (1, True)


def test_a_rejection_has_the_reason_of_the_node(environment):
    code, _, error = run_command(environment, "param", NODE, "gate.probability", "7")
    assert (code, error.count("\n")) == (1, 1)
    assert error.startswith("param: refused: parameter 'gate.probability' = 7.0 is out of its range [0.5, ")
    code, _, error = run_command(environment, "param", NODE, "lag_s", "3")
    assert (code, error.startswith("param: refused: parameter 'lag_s' cannot be changed")) == (1, True)
    code, _, error = run_command(environment, "param", NODE, "gate.probability", "high")
    assert code == 2
    assert re.fullmatch(r"param: parameter 'gate\.probability' is .*: expected a number\n", error)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True), "true"),
        (ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=-3), "-3"),
        (ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=2.5), "2.5"),
        (ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="a,b c"), "a,b c"),
        (ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[1.0, 2.5]), "1.0,2.5"),
        (ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=["a", "b"]), "a,b"),
        (ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY), "[]"),
    ],
)
def test_a_value_is_written_as_it_is_read(value, text):
    assert value_text(value) == text
    assert parse_value(text, value) == value


@pytest.mark.parametrize(("kind", "text"), [("BOOL", "yes"), ("INTEGER", "1.5"), ("DOUBLE", ""), ("BYTE_ARRAY", "1")])
def test_a_text_that_is_no_such_value_is_refused(kind, text):
    with pytest.raises(ValueError, match=r"true|number|can set"):
        parse_value(text, ParameterValue(type=getattr(ParameterType, f"PARAMETER_{kind}")))


def test_nothing_near_is_not_guessed():
    assert unknown_name_text("node", "/x", []) == "no node '/x': there are none"
    assert unknown_name_text("node", "/x", ["/optical_axis"]) == "no node '/x': there are /optical_axis"
