"""Without the requested DDS security a node does not start. Selection of the Fast DDS profile."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ship_bags.errors import BadInput
from ship_bags.live.ros_process import (
    DDS_PROFILE,
    ENABLE,
    PROFILE_VARIABLE,
    QOS_FROM_PROFILE_VARIABLE,
    STRATEGY,
    dds_has_security,
    is_security_requested,
    loaded_libraries,
    security_environment,
    use_dds_profile,
)
from ship_testing.places import RELAY_PROGRAM

RELAY = [sys.executable, RELAY_PROGRAM]
WITHOUT = b"\x00_ZN15MessageReceiver37process_data_message_without_securityEb\x00"
WITH = WITHOUT + b"\x00_ZN15MessageReceiver34process_data_message_with_securityEb\x00"


def library(folder: Path, content: bytes, name: str = "libfastrtps.so.2.14") -> list[Path]:
    path = folder / name
    path.write_bytes(b"\x7fELF" + content)
    return [folder / "not_looked_at.so", path]


def test_security_is_detected_by_the_exported_symbols(tmp_path: Path) -> None:
    assert dds_has_security(library(tmp_path, WITHOUT)) is False
    assert dds_has_security(library(tmp_path, WITH)) is True
    assert dds_has_security(library(tmp_path, b"neither")) is None
    assert dds_has_security(library(tmp_path, WITH, "libddsc.so.0")[:1]) is None


def test_security_of_the_installed_dds_is_detected() -> None:
    """A Jazzy installation of Ubuntu has security, the wheels do not: both are detected."""
    assert dds_has_security(loaded_libraries()) is not None


@pytest.mark.parametrize("spelling", ["", " ", "false", "False", "FALSE", "0", "no", "off"])
def test_clear_negations_request_no_security(spelling: str) -> None:
    assert not is_security_requested({ENABLE: spelling, STRATEGY: "Enforce"})
    assert not is_security_requested({STRATEGY: "Enforce"})


@pytest.mark.parametrize("strategy", ["", "Permissive", "Enforce", "enforce", "nonsense"])
@pytest.mark.parametrize("spelling", ["true", "TRUE", "True", "1", "yes", "on", " true ", "2", "ture"])
def test_any_other_spelling_requests_security(spelling: str, strategy: str) -> None:
    demand = {ENABLE: spelling, STRATEGY: strategy}
    assert is_security_requested(demand)
    with pytest.raises(BadInput, match="requests DDS security, and this installation's DDS was built without"):
        security_environment(demand, has_security=False)
    enforced = strategy in ("Enforce", "enforce")
    # ROS accepts only these spellings as a request for security.
    spelled = {ENABLE: "true", STRATEGY: "Enforce"} if enforced else {ENABLE: "true"}
    assert security_environment(demand, has_security=True) == spelled
    if enforced:
        assert security_environment(demand, has_security=None) == spelled
    else:
        with pytest.raises(BadInput, match=r"this DDS has it: set ROS_SECURITY_STRATEGY=Enforce"):
            security_environment(demand, has_security=None)


@pytest.mark.parametrize(("spelling", "strategy"), [("true", "Permissive"), ("1", "Enforce"), ("true", "Enforce")])
def test_a_node_refuses_in_one_line(spelling: str, strategy: str) -> None:
    if dds_has_security(loaded_libraries()):
        pytest.skip("this DDS has security: it then starts, or refuses for want of keys")
    environment = os.environ | {ENABLE: spelling, STRATEGY: strategy}
    result = subprocess.run(RELAY, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1), result.stderr
    assert result.stderr.startswith(f"relay: {ENABLE}={spelling} requests DDS security")


OWN = str(DDS_PROFILE)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, (OWN, "1")),
        ({PROFILE_VARIABLE: OWN}, (OWN, "1")),
        ({PROFILE_VARIABLE: "/etc/ship/dds.xml"}, ("/etc/ship/dds.xml", None)),
        ({QOS_FROM_PROFILE_VARIABLE: "0"}, (OWN, "0")),
    ],
)
def test_the_suite_profile_applies_unless_the_user_sets_another(
    monkeypatch: pytest.MonkeyPatch, before: dict[str, str], after: tuple[str, str | None]
) -> None:
    for name in (PROFILE_VARIABLE, QOS_FROM_PROFILE_VARIABLE):
        monkeypatch.setenv(name, "")  # what the function sets is taken back after the test
        monkeypatch.delenv(name)
    for name, value in before.items():
        monkeypatch.setenv(name, value)
    use_dds_profile()
    assert (os.environ[PROFILE_VARIABLE], os.environ.get(QOS_FROM_PROFILE_VARIABLE)) == after
