"""Lines of a suite that stdout does not accept: a reader that has ended or does not read, a full disk."""

import contextlib
import os
import subprocess
import sys
import time

import pytest

from ship_bringup.suite.supervisor import SuiteLog, log_path


@pytest.fixture
def pipe():
    reader, writer = os.pipe()
    yield reader, writer
    for number in (reader, writer):
        with contextlib.suppress(OSError):
            os.close(number)


def test_lines_are_written_to_stdout(tmp_path, pipe):
    reader, writer = pipe
    SuiteLog(tmp_path / "suite.log", writer).write("one ″")
    assert os.read(reader, 100) == "one ″\n".encode()
    assert list(tmp_path.iterdir()) == []


def test_lines_are_written_to_the_file_without_reader(tmp_path, pipe):
    reader, writer = pipe
    os.close(reader)
    log = SuiteLog(tmp_path / "logs" / "suite.log", writer)
    for line in ("one", "two"):
        log.write(line)
    kept = (tmp_path / "logs" / "suite.log").read_text().splitlines()
    assert kept == ["[suite] lines continue here, because stdout does not accept them: Broken pipe", "one", "two"]


def test_lines_are_written_to_the_file_on_a_full_disk(tmp_path):
    full = os.open("/dev/full", os.O_WRONLY)
    SuiteLog(tmp_path / "suite.log", full).write("one")
    os.close(full)
    assert (tmp_path / "suite.log").read_text().splitlines()[0].endswith("No space left on device")


def test_line_is_lost_if_neither_accepts_it(tmp_path, pipe):
    reader, writer = pipe
    os.close(reader)
    SuiteLog(tmp_path, writer).write("a folder of that name is there")
    SuiteLog(tmp_path / ("n" * 300), writer).write("no such name")
    assert list(tmp_path.iterdir()) == []


def test_blocked_reader_delays_nothing(tmp_path, pipe):
    reader, writer = pipe
    log = SuiteLog(tmp_path / "suite.log", writer)
    began_s = time.monotonic()
    for number in range(3000):
        log.write(f"{number:099d}")  # 300 kB into 64 kB
    assert time.monotonic() - began_s < 5.0
    got = b""
    while len(got) < 60_000:
        got += os.read(reader, 65536)
    log.write("last")
    got += os.read(reader, 65536)
    *lines, notice, last = got.decode().splitlines()
    missed = int(notice.split()[1])
    kept = (tmp_path / "suite.log").read_text().splitlines()[1:]
    assert [int(line) for line in [*lines, *kept]] == list(range(3000))
    assert notice == f"[suite] {missed} lines that were not accepted here are in {tmp_path}/suite.log"
    assert (len(kept), last) == (missed, "last")


def test_file_size_is_bounded(tmp_path, pipe, monkeypatch):
    monkeypatch.setattr("ship_bringup.suite.supervisor.LARGEST_FILE_BYTES", 1000)
    os.close(pipe[0])
    log = SuiteLog(tmp_path / "suite.log", pipe[1])
    for number in range(500):
        log.write(f"{number:019d}")
    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(sizes) == {"suite.log", "suite.log.1"}
    assert max(sizes.values()) <= 1020
    assert sum(sizes.values()) > 1000


def test_lines_of_stdout_and_stderr_share_a_file_without_loss(tmp_path, pipe, monkeypatch):
    monkeypatch.setattr("ship_bringup.suite.supervisor.LARGEST_FILE_BYTES", 1000)
    os.close(pipe[0])
    output, errors = (SuiteLog(tmp_path / "suite.log", pipe[1]) for _ in range(2))
    errors.write("first error")
    for number in range(60):
        output.write(f"{number:019d}")
    errors.write("second error")
    kept = [line for name in ("suite.log.1", "suite.log") for line in (tmp_path / name).read_text().splitlines()]
    lines = [f"{number:019d}" for number in range(60)]
    assert [line for line in kept if "stdout does not accept" not in line] == ["first error", *lines, "second error"]


def test_file_is_in_the_log_folder_of_ros(monkeypatch, tmp_path):
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    assert log_path("") == tmp_path / "log" / "suite.log"
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "other"))
    assert log_path("fleet/aurora") == tmp_path / "other" / "suite_fleet_aurora.log"


SUPERVISOR = """
import sys
from pathlib import Path
from ship_bringup.suite.supervisor import SuiteLog, Supervisor
from ship_bringup.suite.program import Program
text = "import os, time\\nopen({pid!r}, 'w').write(str(os.getpid()))\\n"
text += "while True: print('x', flush=True); time.sleep(.1)"
raise SystemExit(Supervisor([Program("p", (sys.executable, "-c", text))], SuiteLog(Path({log!r})).write).run())
"""


@pytest.mark.parametrize("stdout", ["closed pipe", "/dev/full"])
def test_suite_continues_without_stdout(tmp_path, stdout):
    pid, log = tmp_path / "pid", tmp_path / "suite.log"
    command = [sys.executable, "-c", SUPERVISOR.format(pid=str(pid), log=str(log))]
    with open("/dev/full", "wb") as full:
        supervisor = subprocess.Popen(command, stdout=subprocess.PIPE if stdout == "closed pipe" else full)
    if supervisor.stdout:
        supervisor.stdout.readline()
        supervisor.stdout.close()
    deadline_s = time.monotonic() + 20.0
    while not log.exists() or log.stat().st_size < 200:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    assert supervisor.poll() is None
    os.kill(int(pid.read_text()), 0)
    supervisor.terminate()
    assert supervisor.wait(20.0) == 0
