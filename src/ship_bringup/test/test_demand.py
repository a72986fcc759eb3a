"""A demand for DDS security fails closed: anything missing or unknown is reported and nothing starts."""

import datetime
import shutil
from pathlib import Path

import pytest

from ship_bags.errors import BadInput
from ship_bags.live.ros_process import dds_has_security, loaded_libraries
from ship_bringup.checks.check_line import CheckLine, Result, exit_code, limit_rows, table
from ship_bringup.checks.network_check import check_keystore, check_security
from ship_bringup.security.demand import enclave_command, require_profile, security_problems
from ship_bringup.security.rights import suite_rights
from ship_bringup.suite.plan import SuiteOptions, check_nodes, make_plan
from ship_testing.keystores import Keystore, new_authority
from ship_watch.safety.limits import Limits, MachineLimits, read_limits

ROOT = Path(__file__).parents[3]
REQUIRED = Limits(machine=MachineLimits(require_security=True))
NAMES = ("ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY", "ROS_SECURITY_KEYSTORE")


@pytest.fixture
def good(tmp_path):
    return dict(zip(NAMES, ("true", "Enforce", str(tmp_path)), strict=True))


def set_to(monkeypatch, environment):
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)


def test_complete_environment_has_no_problem(good, monkeypatch):
    assert security_problems(good, True) == []
    set_to(monkeypatch, good)
    require_profile(REQUIRED, Path("ship.yaml"), True)
    assert [row.result for row in check_security(good, True, True)] == [Result.OK]


BAD = [
    ("ROS_SECURITY_ENABLE", None, "ROS_SECURITY_ENABLE is not set: nodes run unprotected"),
    ("ROS_SECURITY_ENABLE", "false", "ROS_SECURITY_ENABLE is false: nodes run unprotected"),
    ("ROS_SECURITY_STRATEGY", None, "a node without an enclave runs unprotected"),
    ("ROS_SECURITY_STRATEGY", "Permissive", "a node without an enclave runs unprotected"),
    ("ROS_SECURITY_STRATEGY", "enforce", "a node without an enclave runs unprotected"),
    ("ROS_SECURITY_KEYSTORE", None, "ROS_SECURITY_KEYSTORE is not set"),
    ("ROS_SECURITY_KEYSTORE", "/nowhere", "ROS_SECURITY_KEYSTORE=/nowhere is not a folder"),
]


@pytest.mark.parametrize(("name", "value", "expected"), BAD)
def test_each_missing_item_refuses_the_start(name, value, expected, good, monkeypatch):
    environment = {key: text for key, text in good.items() if key != name} | ({} if value is None else {name: value})
    ((text, _),) = security_problems(environment, True)
    assert expected in text
    set_to(monkeypatch, environment)
    with pytest.raises(BadInput, match=r"^ship\.yaml: machine\.require_security is true, and .*: not started; "):
        require_profile(REQUIRED, Path("ship.yaml"), True)
    require_profile(Limits(), None, True)


@pytest.mark.parametrize("has_security", [False, None])
def test_dds_without_security_refuses_the_start(has_security, good, monkeypatch):
    set_to(monkeypatch, good)
    with pytest.raises(BadInput, match="no DDS security"):
        require_profile(REQUIRED, Path("ship.yaml"), has_security)


def test_security_of_this_dds_is_detected():
    """The DDS of the wheels lacks security, that of Ubuntu's packages has security; either is detected."""
    assert dds_has_security(loaded_libraries()) in (True, False)


def test_require_security_is_a_key_of_the_limits():
    assert read_limits("machine: {require_security: true}\n").machine.require_security is True
    assert Limits().machine.require_security is False
    with pytest.raises(BadInput, match=r":1: .*require_security"):
        read_limits("machine: {require_security: 1.5}\n")


@pytest.mark.parametrize(("required", "result"), [(True, Result.FAIL), (False, Result.WARN)])
def test_missing_security_fails_only_if_required(required, result):
    rows = list(check_security({}, False, required))
    assert {row.result for row in rows} == {result}
    assert len(rows) == (4 if required else 1)


def test_demand_of_the_environment_is_required():
    assert {row.result for row in check_security({"ROS_SECURITY_ENABLE": "1"}, False, False)} == {Result.FAIL}


def test_missing_keystore_fails_if_security_is_required():
    assert [row.result for row in check_keystore("", None, True)] == [Result.FAIL]


def programs(**options):
    suite, options = ROOT / "examples" / "two_sensors.yaml", SuiteOptions(namespace="demo", monitor=True, **options)
    planned, warnings = make_plan(suite, options)
    return {program.name: program.command for program in planned}, warnings


def keystore_for_now(path, **options):
    nodes, _ = check_nodes(ROOT / "examples" / "two_sensors.yaml", "demo")
    now = datetime.datetime.now(datetime.timezone.utc)
    store = Keystore(path, new_authority(now=now), 7, now)
    return store.add(suite_rights([node.adapter for node in nodes], "demo", **options))


def test_every_program_has_its_own_enclave(tmp_path, good, monkeypatch):
    set_to(monkeypatch, {})
    options = {"bag": ROOT / "bags" / "demo.mcap"}
    plain, warnings = programs(**options)
    store = keystore_for_now(tmp_path / "keystore", is_played=True)
    set_to(monkeypatch, {**good, "ROS_SECURITY_KEYSTORE": str(store.path)})
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    secured, reported = programs(**options)
    assert reported == warnings
    assert set(plain) == {"ship_attitude", "monitor", "alerts", "play"}
    for name, command in plain.items():
        assert secured[name] == (*enclave_command(f"/demo/{name}"), *command)
    assert enclave_command("/demo/x") == ("/usr/bin/env", "ROS_SECURITY_ENCLAVE_OVERRIDE=/demo/x")


def test_secured_suite_needs_all_enclaves_and_the_authority(tmp_path, good, monkeypatch):
    store = keystore_for_now(tmp_path / "keystore", is_locked=True)
    set_to(monkeypatch, {**good, "ROS_SECURITY_KEYSTORE": str(store.path)})
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert len(programs()[1]) == 1  # the warning that no file is configured
    limits = tmp_path / "ship.yaml"
    limits.write_text(f"machine: {{authority_sha256: '{'0' * 64}'}}\n")
    with pytest.raises(BadInput, match=r"an authority of another ship: .*: not started"):
        programs(limits=limits)
    monkeypatch.setenv("ROS_DOMAIN_ID", "8")
    assert len(programs()[1]) > 1
    monkeypatch.delenv("ROS_SECURITY_KEYSTORE")
    with pytest.raises(BadInput, match=r"ROS_SECURITY_KEYSTORE is not set: not started"):
        programs()
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(store.path))
    shutil.rmtree(store.folder("/demo/monitor"))
    with pytest.raises(BadInput, match=r"/demo/monitor: has no identity_ca"):
        programs()


def test_table_shows_the_worst_first_and_counts_the_rest():
    lines = [CheckLine("disk", Result.OK, "good"), *(CheckLine("disk", Result.WARN, f"{n}") for n in range(20))]
    lines.append(CheckLine("disk", Result.FAIL, "full\nand over", "free some"))
    shown = limit_rows(lines)
    assert (len(shown), shown[0].finding, shown[-1].finding) == (12, "full\nand over", "and 11 more")
    text = table(shown)
    assert text[0].split() == ["check", "result", "found"]
    assert text[1].split(maxsplit=2) == ["disk", "FAIL", "full and over"]
    assert text[2].strip() == "-> free some"


@pytest.mark.parametrize(
    ("results", "code"),
    [([Result.OK], 0), ([Result.OK, Result.WARN, Result.NOT_CHECKED], 0), ([Result.WARN, Result.FAIL], 1)],
)
def test_exit_code(results, code):
    assert exit_code(CheckLine("clock", result, "") for result in results) == code
