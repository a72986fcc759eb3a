"""Files, folders and devices in a suite file: they exist, and this user may use them."""

import os
import pty
from pathlib import Path

import pytest

from ship_bringup.checks.check_line import Result
from ship_bringup.checks.resource_check import PathState, check_files, read_path_states

SUITE = """\
/**/ship_attitude:
  ros__parameters:
    alignment_file: {alignment}
    black_box: {recorder}
/**/nmea_in:
  ros__parameters:
    sources:
      seapath: {{device: {device}, baud: 38400}}
"""


def read_states(tmp_path, black_box=None, **paths):
    given = {"alignment": "''", "recorder": "''", "device": "''"} | paths
    path = tmp_path / "suite.yaml"
    path.write_text(SUITE.format(**given))
    return read_path_states(path, black_box)


def rows(states):
    return [(row.result, row.finding) for row in check_files(states, [])]


def test_missing_file_in_an_existing_folder(tmp_path):
    (state,) = read_states(tmp_path, alignment=tmp_path / "alignment.yaml")
    assert (state.exists, state.writable) == (False, True)
    assert rows([state]) == [
        (Result.OK, f"{tmp_path}/suite.yaml:3: alignment_file {tmp_path}/alignment.yaml: good")
    ]  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["suite.yaml"]


@pytest.mark.parametrize("name", ["alignment", "recorder"])
def test_file_without_folder(tmp_path, name):
    ((result, found),) = rows(read_states(tmp_path, **{name: tmp_path / "none" / "file"}))
    assert result is Result.FAIL
    assert "cannot create it" in found


def test_file_in_a_read_only_folder_fails(tmp_path):
    (state,) = read_states(tmp_path, alignment="/proc/self/status")
    assert (state.exists, state.readable, state.writable) == (True, True, False)
    assert rows([state])[0][0] is Result.FAIL


def test_folder_of_black_boxes_is_created_with_its_parents(tmp_path):
    assert rows(read_states(tmp_path, black_box=tmp_path / "a" / "b"))[0][0] is Result.OK
    assert not (tmp_path / "a").exists()
    assert rows(read_states(tmp_path, black_box=Path("/proc/a/b")))[0][0] is Result.FAIL


def test_existing_and_missing_serial_device(tmp_path):
    first, second = pty.openpty()
    try:
        (state,) = read_states(tmp_path, device=os.ttyname(second))
        assert state.is_device
        assert rows([state])[0][0] is Result.OK
    finally:
        os.close(first)
        os.close(second)
    ((result, found),) = rows(read_states(tmp_path, device="/dev/ttyNONE7"))
    assert result is Result.FAIL
    assert found == f"{tmp_path}/suite.yaml:8: sources.seapath.device /dev/ttyNONE7: is not there"


def test_nmea_out_file_needs_its_folder(tmp_path):
    path = tmp_path / "suite.yaml"
    for log, result in ((tmp_path / "nmea.log", Result.OK), (tmp_path / "none" / "nmea.log", Result.FAIL)):
        path.write_text(f"/**/nmea_out: {{ros__parameters: {{sinks: {{log: {{kind: file, path: {log}}}}}}}}}\n")
        ((found, text),) = rows(read_path_states(path, None))
        assert found is result
        assert text.startswith(f"{path}:1: sinks.log.path {log}: ")


@pytest.mark.parametrize(("key", "found"), [("path", "is a folder"), ("device", "is not a serial device")])
def test_wrong_kinds_of_nmea_out_paths(tmp_path, key, found):
    path = tmp_path / "suite.yaml"
    path.write_text(f"/**/nmea_out: {{ros__parameters: {{sinks: {{log: {{{key}: {tmp_path}}}}}}}}}\n")
    assert rows(read_path_states(path, None)) == [(Result.FAIL, f"{path}:1: sinks.log.{key} {tmp_path}: {found}")]
    path.write_text(f"/**/nmea_out: {{ros__parameters: {{sinks: {{log: {{device: {path}}}}}}}}}\n")
    assert rows(read_path_states(path, None)) == [
        (Result.FAIL, f"{path}:1: sinks.log.device {path}: is not a serial device")
    ]


def test_device_of_another_group_advises_usermod():
    state = PathState(Path("/dev/ttyUSB0"), "suite.yaml:8: device", True, True, False, False)
    (row,) = check_files([state], [])
    assert row.result is Result.FAIL
    assert "may not read and write it" in row.finding
    assert row.advice.startswith("sudo usermod -aG dialout ")


@pytest.mark.parametrize(("readable", "writable"), [(True, False), (False, True)])
def test_file_of_another_user_fails(readable, writable):
    state = PathState(Path("/var/lib/ship/a.yaml"), "suite.yaml:3: alignment_file", False, True, readable, writable)
    assert rows([state])[0][0] is Result.FAIL


def test_node_without_saved_file_is_a_warning():
    (row,) = check_files([], ["suite.yaml: ship_attitude has no alignment_file"])
    assert row.result is Result.WARN


def test_suite_file_without_files_is_ok():
    assert rows([])[0][0] is Result.OK
