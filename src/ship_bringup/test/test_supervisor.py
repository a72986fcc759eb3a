"""Supervised programs: lines, restarts, heartbeats, order of the end, exit codes, no process left behind."""

import errno
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ship_bringup.suite import process as process_module
from ship_bringup.suite.program import STEADY_S, Program, Restarts, Role, exit_code_of
from ship_bringup.suite.supervisor import Supervisor

FAR_S = 20.0


def program(name, text, role=Role.NODE):
    return Program(name, (sys.executable, "-c", text), role)


def run_suite(*programs, until="", count=1, **limits):
    """Return exit code and lines of a suite; SIGINT ends the suite at the ``count``-th line with ``until``."""
    lines = []

    def write(line):
        lines.append(line)
        if until and sum(until in each for each in lines) == count and until in line:
            signal.raise_signal(signal.SIGINT)

    return Supervisor(programs, write, **limits).run(), lines


def test_restart_delays_double_up_to_30_s():
    restarts = Restarts()
    assert [restarts.delay_s(3.0) for _ in range(9)] == [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0]
    assert [restarts.delay_s(3.0) for _ in range(5000)] == [30.0] * 5000


def test_run_of_a_minute_resets_the_delays():
    restarts = Restarts()
    assert [restarts.delay_s(1.0), restarts.delay_s(1.0)] == [0.0, 1.0]
    assert restarts.delay_s(STEADY_S) == 0.0
    assert [restarts.delay_s(1.0), restarts.delay_s(1.0)] == [1.0, 2.0]


@pytest.mark.parametrize(("code", "failure"), [(0, 0), (1, 1), (2, 2), (130, 0), (-15, 0), (-9, 137), (-11, 139)])
def test_exit_code_of_a_program(code, failure):
    assert exit_code_of(code) == failure


def test_lines_have_the_name_as_prefix_and_none_is_lost():
    text = "import sys; print('one'); print('two', file=sys.stderr); sys.stdout.write('no end'); sys.stdout.flush()"
    _, lines = run_suite(program("talker", text), until="talker ended")
    assert lines[:3] == ["[talker] one", "[talker] two", "[talker] no end"]


def test_line_without_end_is_cut_without_loss():
    _, lines = run_suite(program("long", "print('x' * 300_000)"), until="long ended")
    printed = [line.removeprefix("[long] ") for line in lines if line.startswith("[long]")]
    assert len(printed) > 1
    assert "".join(printed) == "x" * 300_000


@pytest.mark.slow
@pytest.mark.parametrize("code", [0, 1, 2, 130, -signal.SIGKILL, -signal.SIGTERM])
def test_ended_program_is_started_again(code):
    text = f"import os; os.kill(os.getpid(), {-code})" if code < 0 else f"raise SystemExit({code})"
    lives = program("lives", WAITS)
    ended, lines = run_suite(program("mayfly", text), lives, until="mayfly ended", count=4)
    assert ended == exit_code_of(code)  # mayfly was down when SIGINT ended the suite
    ends = [line for line in lines if "mayfly ended" in line]
    assert ends[0].endswith("; started again at once (restart 1 in a row)")
    assert ends[3].endswith("; started again in 4 s (restart 4 in a row)")


WAITS = (
    "import signal, time\n"
    "def end(*_):\n    print('ends', flush=True)\n    raise SystemExit(0)\n"
    "signal.signal(signal.SIGINT, end)\nprint('ready', flush=True)\ntime.sleep(60)"
)


def test_suite_ends_with_its_player_in_the_opposite_order():
    code, lines = run_suite(
        program("first", WAITS),
        program("second", WAITS),
        program("watcher", WAITS, Role.WATCHER),
        program("player", "import time; time.sleep(1.5); raise SystemExit(1)", Role.PLAYER),
    )
    assert code == 1
    assert [line for line in lines if line.endswith("ends")] == ["[watcher] ends", "[second] ends", "[first] ends"]
    assert any(line.endswith("exit code 1; not started again; the suite ends with it") for line in lines)


def test_another_end_sends_no_second_request_to_a_slow_program():
    """A second SIGINT may interrupt a program while it saves its state."""
    slow = (
        "import signal, time\n"
        "signal.signal(signal.SIGINT, lambda *_: print('requested', flush=True))\nprint('ready', flush=True)\n"
        "signal.pause()\ntime.sleep(3.0)\nprint('ends', flush=True)"
    )
    _, lines = run_suite(
        program("node", "import time; print('runs', flush=True); time.sleep(4.0)"),
        program("slow", slow, Role.WATCHER),
        program("player", "import time; time.sleep(2.0)", Role.PLAYER),
    )
    assert [line for line in lines if line.startswith("[slow]")] == ["[slow] ready", "[slow] requested", "[slow] ends"]


def test_time_without_a_heartbeat_does_not_shorten_the_restart_delay(monkeypatch):
    monkeypatch.setattr("ship_bringup.suite.program.STEADY_S", 0.2)
    _, lines = run_suite(program("node", "import time; time.sleep(0.5)"), until="node ended", count=2)
    assert lines[-1].endswith("; started again in 1 s (restart 2 in a row)")


def test_feeder_ends_before_the_nodes():
    code, lines = run_suite(
        program("node", WAITS),
        program("feeder", WAITS, Role.FEEDER),
        program("broken", "raise SystemExit(2)", Role.FEEDER),
        program("player", "import time; time.sleep(1.5)", Role.PLAYER),
    )
    assert code == 2
    assert any("broken ended" in line and "started again" in line for line in lines)
    assert [line for line in lines if line.endswith("ends")] == ["[feeder] ends", "[node] ends"]


def test_watcher_ends_before_the_player():
    """If the player ended first, all inputs would time out, and the alerts would report the timeouts."""
    code, lines = run_suite(
        program("node", "import time; time.sleep(1.5)"),
        program("page", WAITS, Role.WATCHER),
        program("alerts", WAITS, Role.WATCHER),
        program("player", WAITS, Role.PLAYER),
        until="node ended",
    )
    assert code == 0
    assert [line for line in lines if line.endswith("ends")] == ["[alerts] ends", "[page] ends", "[player] ends"]


def test_bad_input_of_one_program_at_the_start_is_retried():
    code, lines = run_suite(
        program("wrong", "raise SystemExit(2)"),
        program("page", "raise SystemExit(2)", Role.WATCHER),
        program("right", WAITS),
        until="wrong ended",
        count=3,
    )
    assert code == 2  # exit code of the first program that was down at the end
    assert any(re.fullmatch(r".*page ended .*: exit code 2; started again at once .*", line) for line in lines)
    assert "[right] ends" in lines


def test_bad_input_of_all_nodes_at_the_start_ends_the_suite():
    started_s = time.monotonic()
    code, lines = run_suite(
        program("one", "import time; time.sleep(0.3); raise SystemExit(2)"),
        program("other", "raise SystemExit(2)"),
        program("page", "import time; time.sleep(60)", Role.WATCHER),
    )
    assert code == 2
    assert time.monotonic() - started_s < FAR_S
    assert any(line.endswith("exit code 2; bad input at the start: the suite ends") for line in lines)


BEATS = """
import os, signal, sys, time
from ship_bags.live.ros_process import heartbeat
def beat_for(time_s):
    end_s = time.monotonic() + time_s
    while time.monotonic() < end_s:
        heartbeat().beat(time.monotonic_ns())
        time.sleep(0.02)
"""


def test_bad_input_of_a_node_that_has_run_is_retried():
    """The suite restarts the node until the input is corrected, for example a parameter file changed at sea."""
    text = BEATS + "beat_for(0.5)\nraise SystemExit(2)"
    code, lines = run_suite(program("node", text), until="node ended", count=3)
    assert code == 2
    assert sum("started again" in line for line in lines) == 3


def kill_time_s(line: str) -> int:
    """Return the time without a heartbeat, s, from the line that reports the kill; a busy machine checks later."""
    killed = re.fullmatch(r"\[suite\] node sent no heartbeat for (\d) s: killed", line)
    assert killed, line
    return int(killed[1])


@pytest.mark.slow
@pytest.mark.parametrize("how", ["os.kill(os.getpid(), signal.SIGSTOP)", "time.sleep(60)", "while True: pass"])
def test_frozen_program_is_reported_killed_and_restarted(how):
    text = BEATS + f"print('starts', flush=True)\nbeat_for(1.5)\n{how}"
    started_s = time.monotonic()
    code, lines = run_suite(
        program("node", text), until="[node] starts", count=2, frozen_report_s=2.0, frozen_restart_s=4.0
    )
    assert code == 0  # node ran when SIGINT ended the suite
    assert time.monotonic() - started_s < FAR_S
    own = [line for line in lines if line.startswith("[suite]")]
    times = re.fullmatch(r"\[suite\] node is frozen: no heartbeat for (\d) s, .*started again in (\d) s", own[0])
    assert times, own
    # A busy machine checks later; both times are from the same check.
    frozen_s, left_s = map(int, times.groups())
    assert frozen_s in (2, 3)
    assert frozen_s + left_s == 4
    assert kill_time_s(own[1]) in (4, 5)
    assert re.fullmatch(r"\[suite\] node ended .* signal 9, SIGKILL; started again at once .*", own[2])


@pytest.mark.slow
def test_recovered_program_is_not_killed():
    text = BEATS + "beat_for(1.0)\ntime.sleep(4.0)\nbeat_for(60.0)"
    code, lines = run_suite(program("node", text), until="works again", frozen_report_s=2.0, frozen_restart_s=10.0)
    assert code == 0
    assert [line for line in lines if "ended" in line] == []
    assert re.search(r"node works again after [3-5] s without a heartbeat", "\n".join(lines))


@pytest.mark.slow
def test_program_without_first_heartbeat_is_restarted(monkeypatch):
    monkeypatch.setattr("ship_bringup.suite.supervisor._MAX_START_S", 2.0)
    code, lines = run_suite(program("node", "import time; time.sleep(60)"), until="node ended", frozen_restart_s=1.0)
    assert code == 137
    assert kill_time_s(lines[0]) in (2, 3)


@pytest.mark.slow
def test_standstill_of_the_supervisor_does_not_count():
    """Supervisor and program are stopped and continued together, as on a suspended computer."""
    supervisor = start_supervisor(BEATS + "print(os.getpid(), flush=True)\nbeat_for(60.0)", limits="2.0, 4.0")
    pid = read_pids(supervisor, 1)[0]
    time.sleep(1.5)
    for number in (signal.SIGSTOP, signal.SIGCONT):
        os.kill(supervisor.pid, number)
        os.kill(pid, number)
        if number == signal.SIGSTOP:
            time.sleep(8.0)
    time.sleep(3.0)
    supervisor.send_signal(signal.SIGINT)
    output = supervisor.communicate(timeout=FAR_S)[0]
    assert supervisor.returncode == 0
    assert "[suite]" not in output


@pytest.mark.slow
def test_program_without_processor_time_is_not_frozen():
    """Three processes on the program's core have together a thousand times its scheduling weight."""
    core = str(min(os.sched_getaffinity(0)))
    hog_text = f"import os\nos.sched_setaffinity(0, [{core}])\nwhile True: pass"
    hogs = [subprocess.Popen([sys.executable, "-c", hog_text]) for _ in range(3)]
    try:
        text = BEATS + (
            f"os.sched_setaffinity(0, [{core}])\nbeat_for(1.0)\nos.sched_setscheduler(0, os.SCHED_IDLE, "
            "os.sched_param(0))\nwhile True:\n    heartbeat().beat(time.monotonic_ns())\n    sum(range(20_000_000))"
        )
        supervisor = start_supervisor("print('runs', flush=True)\n" + text, limits="1.0, 6.0")
        time.sleep(12.0)
        supervisor.send_signal(signal.SIGINT)
        output = supervisor.communicate(timeout=FAR_S)[0]
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
    assert not re.search(r"sent no heartbeat for \d+ s: killed", output), output


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN])
@pytest.mark.parametrize("where", ["subprocess.Popen", "os.pidfd_open"])
def test_failed_start_is_retried(monkeypatch, number, where):
    holder, name = (process_module.subprocess, "Popen") if "Popen" in where else (process_module.os, "pidfd_open")
    real, left = getattr(holder, name), [2]

    def failing(*arguments, **options):
        if left[0]:
            left[0] -= 1
            raise OSError(number, os.strerror(number))
        return real(*arguments, **options)

    monkeypatch.setattr(holder, name, failing)
    before = set(os.listdir("/proc/self/fd"))
    code, lines = run_suite(
        program("node", "import time; print('runs', flush=True); time.sleep(60)"), until="[node] runs"
    )
    assert code == 0
    assert lines[0] == f"[suite] node cannot be started: {os.strerror(number)}; tried again in 1 s"
    assert set(os.listdir("/proc/self/fd")) <= before


@pytest.mark.slow
def test_restart_without_file_descriptors_is_retried():
    """A running supervisor's limit of file descriptors is lowered below the number in use, and later restored."""
    text = BEATS + "heartbeat().beat(time.monotonic_ns())\nprint(os.getpid(), flush=True)\nbeat_for(60.0)"
    supervisor = start_supervisor(text, text)
    first, other = read_pids(supervisor, 2)
    before = resource.prlimit(supervisor.pid, resource.RLIMIT_NOFILE)
    resource.prlimit(supervisor.pid, resource.RLIMIT_NOFILE, (4, before[1]))
    os.kill(first, signal.SIGKILL)
    lines = [supervisor.stdout.readline() for _ in range(4)]
    assert "started again at once" in lines[0]
    assert all(re.search(r"cannot be started: Too many open files; tried again in [124] s", each) for each in lines[1:])
    assert supervisor.poll() is None
    os.kill(other, 0)
    resource.prlimit(supervisor.pid, resource.RLIMIT_NOFILE, before)
    while (line := supervisor.stdout.readline()).startswith("[suite]"):
        pass
    assert re.match(r"\[p[01]\] \d+", line)
    supervisor.send_signal(signal.SIGTERM)
    assert supervisor.wait(FAR_S) == 0


def test_exception_in_the_supervisor_ends_nothing(monkeypatch):
    failures = [MemoryError("none left"), OSError(errno.EIO, "Input/output error")]
    real = Supervisor._wait

    def wait(self):
        if failures:
            raise failures.pop()
        real(self)

    monkeypatch.setattr(Supervisor, "_wait", wait)
    code, lines = run_suite(
        program("node", "import time; print('runs', flush=True); time.sleep(60)"), until="[node] runs"
    )
    assert code == 0
    assert "MemoryError: none left" in "\n".join(lines)


def start_supervisor(*texts, limits=""):
    """Start a supervisor in a process of its own, with one program for each text."""
    programs = ", ".join(f"Program('p{i}', (sys.executable, '-c', {text!r}))" for i, text in enumerate(texts))
    code = (
        "import sys\nfrom pathlib import Path\nfrom ship_bringup.suite.supervisor import Program, SuiteLog, Supervisor"
        "\n"
        f"raise SystemExit(Supervisor(({programs},), SuiteLog(Path('/dev/null')).write, {limits}).run())"
    )
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)


PRINTS_ITS_ID = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
IGNORES_SIGINT = "import os, signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); " + PRINTS_ITS_ID


def read_pids(process, count):
    return [int(process.stdout.readline().split()[1]) for _ in range(count)]


def is_gone(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def wait_until_gone(pids):
    deadline_s = time.monotonic() + FAR_S
    while not all(map(is_gone, pids)):
        assert time.monotonic() < deadline_s, f"still there: {[pid for pid in pids if not is_gone(pid)]}"
        time.sleep(0.02)


def test_programs_end_when_the_suite_is_killed():
    supervisor = start_supervisor(PRINTS_ITS_ID, IGNORES_SIGINT)
    pids = read_pids(supervisor, 2)
    supervisor.kill()
    supervisor.wait()
    wait_until_gone(pids)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_all_programs(number):
    supervisor = start_supervisor(PRINTS_ITS_ID, PRINTS_ITS_ID)
    pids = read_pids(supervisor, 2)
    supervisor.send_signal(number)
    assert supervisor.wait(FAR_S) == 0
    assert all(map(is_gone, pids))


def test_second_signal_kills_at_once():
    supervisor = start_supervisor(IGNORES_SIGINT)
    pids = read_pids(supervisor, 1)
    supervisor.send_signal(signal.SIGINT)
    time.sleep(0.3)
    os.kill(pids[0], 0)
    started_s = time.monotonic()
    supervisor.send_signal(signal.SIGINT)
    supervisor.wait(FAR_S)
    assert time.monotonic() - started_s < 5.0  # not the timeout of ten seconds
    assert is_gone(pids[0])
