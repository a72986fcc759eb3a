"""Programs kept running: lines, restarts, order of the end, exit codes, nothing left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ship_bringup.suite.keeper import Keeper, Program, Role
from ship_bringup.suite.restarts import STEADY_S, Restarts, failure_of

FAR_S = 20.0


def program(name, text, role=Role.NODE):
    return Program(name, (sys.executable, "-c", text), role)


def kept(*programs, most_restarts=0):
    lines = []
    return Keeper(programs, most_restarts, lines.append).run(), lines


def test_the_first_restart_is_at_once_and_each_further_one_after_twice_the_time():
    restarts = Restarts(9)
    assert [restarts.delay_s(-9, 3.0) for _ in range(10)] == [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0, None]


def test_a_run_of_a_minute_ends_the_row():
    restarts = Restarts(2)
    assert [restarts.delay_s(1, 1.0), restarts.delay_s(1, 1.0)] == [0.0, 1.0]
    assert restarts.delay_s(1, STEADY_S) == 0.0
    assert [restarts.delay_s(1, 1.0), restarts.delay_s(1, 1.0)] == [1.0, None]


@pytest.mark.parametrize("code", [0, 2, 130, -signal.SIGINT, -signal.SIGTERM])
def test_bad_input_and_an_end_by_wish_are_not_started_again(code):
    assert Restarts(5).delay_s(code, 1.0) is None


@pytest.mark.parametrize(("code", "failure"), [(0, 0), (1, 1), (2, 2), (130, 0), (-15, 0), (-9, 137), (-11, 139)])
def test_the_exit_code_of_a_failure(code, failure):
    assert failure_of(code) == failure


def test_each_line_has_the_name_in_front_and_none_is_lost_at_the_end():
    text = "import sys; print('one'); print('two', file=sys.stderr); sys.stdout.write('no end'); sys.stdout.flush()"
    code, lines = kept(program("talker", text))
    assert code == 0
    assert lines[:3] == ["[talker] one", "[talker] two", "[talker] no end"]


def test_a_line_without_end_is_cut_and_nothing_of_it_lost():
    _, lines = kept(program("long", "print('x' * 300_000)"))
    said = [line.removeprefix("[long] ") for line in lines if line.startswith("[long]")]
    assert len(said) > 1
    assert "".join(said) == "x" * 300_000


def test_a_program_that_dies_is_started_again_up_to_the_limit():
    code, lines = kept(program("mayfly", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"), most_restarts=2)
    assert code == 137
    ends = [line for line in lines if "ended" in line]
    assert len(ends) == 3
    assert ends[0].endswith("signal 9, SIGKILL; started again at once (1 of 2)")
    assert ends[1].endswith("started again in 1 s (2 of 2)")
    assert ends[2].endswith("not started again")


SUCCESSOR = """
import os, signal, sys, time
from ship_node.live.start import WAITS
waited = bool(os.environ.pop(WAITS, ""))
if waited:
    open({mark!r}, "w").close()
def wait_for_reserve():
    end_s = time.monotonic() + 60.0
    while not os.path.exists({mark!r}) and time.monotonic() < end_s:
        time.sleep(0.02)
if waited and not sys.stdin.readline():
    raise SystemExit(7)
print("in reserve" if waited else "from the start", flush=True)
{then}
"""


def test_a_process_in_reserve_succeeds_the_one_that_died(monkeypatch, tmp_path):
    monkeypatch.setattr("ship_bringup.suite.keeper._RESERVE_AFTER_S", 0.2)
    then = "waited or wait_for_reserve()\nos.kill(os.getpid(), signal.SIGKILL)"
    text = SUCCESSOR.format(mark=str(tmp_path / "reserve"), then=then)
    code, lines = kept(Program("node", (sys.executable, "-c", text), has_reserve=True), most_restarts=1)
    assert code == 137
    said = [line for line in lines if line.startswith("[node]")]
    assert said == ["[node] from the start", "[node] in reserve"]
    # It counts from when it was told to begin, and is no death of its own before.
    assert [line.partition(": ")[2] for line in lines if "ended" in line] == [
        "signal 9, SIGKILL; started again at once (1 of 1)",
        "signal 9, SIGKILL; not started again",
    ]


@pytest.mark.slow
def test_a_program_whose_reserve_has_died_is_started_as_before(monkeypatch, tmp_path):
    monkeypatch.setattr("ship_bringup.suite.keeper._RESERVE_AFTER_S", 0.2)
    dies = SUCCESSOR.replace("waited = bool", "if WAITS in os.environ: raise SystemExit(3)\nwaited = bool")
    text = dies.format(mark=str(tmp_path / "reserve"), then="time.sleep(2.0)\nraise SystemExit(1)")
    code, lines = kept(Program("node", (sys.executable, "-c", text), has_reserve=True), most_restarts=1)
    assert code == 1
    assert [line for line in lines if line.startswith("[node]")] == ["[node] from the start"] * 2
    assert lines.count("[suite] node in reserve ended: exit code 3") == 2


def test_a_process_in_reserve_does_not_outlive_its_program(monkeypatch, tmp_path):
    monkeypatch.setattr("ship_bringup.suite.keeper._RESERVE_AFTER_S", 0.2)
    text = SUCCESSOR.format(mark=str(tmp_path / "reserve"), then="wait_for_reserve()")
    text = text.replace("waited = bool", "print(os.getpid())\nwaited = bool")
    _, lines = kept(Program("node", (sys.executable, "-u", "-c", text), has_reserve=True))
    pids = [int(line.split()[1]) for line in lines if line.split()[1].isdecimal()]
    assert len(pids) == 2
    assert all(map(is_gone, pids))


def test_bad_input_is_never_started_again_and_the_others_go_on():
    code, lines = kept(
        program("wrong", "raise SystemExit(2)"),
        program("right", "import time; time.sleep(0.6); print('still here')"),
        program("late", "import time; time.sleep(0.9); raise SystemExit(3)"),
        most_restarts=0,
    )
    assert code == 2  # of the first that failed for good
    assert sum("wrong ended" in line for line in lines) == 1
    assert "[right] still here" in lines


WAITS = (
    "import signal, time\n"
    "def end(*_):\n    print('ends', flush=True)\n    raise SystemExit(0)\n"
    "signal.signal(signal.SIGINT, end)\nprint('ready', flush=True)\ntime.sleep(60)"
)


def test_the_suite_ends_with_its_player_and_in_the_opposite_order():
    code, lines = kept(
        program("first", WAITS),
        program("second", WAITS),
        program("watcher", WAITS, Role.WATCHER),
        program("player", "import time; time.sleep(1.5); raise SystemExit(1)", Role.PLAYER),
        most_restarts=5,
    )
    assert code == 1
    assert [line for line in lines if line.endswith("ends")] == ["[watcher] ends", "[second] ends", "[first] ends"]
    assert any(line.endswith("exit code 1; not started again; the suite ends with it") for line in lines)


def test_who_feeds_the_nodes_ends_before_them_and_they_go_on_without_it():
    code, lines = kept(
        program("node", WAITS),
        program("feeder", WAITS, Role.FEEDER),
        program("broken", "raise SystemExit(2)", Role.FEEDER),
        program("player", "import time; time.sleep(1.5)", Role.PLAYER),
    )
    assert code == 2
    assert any("broken ended" in line and line.endswith("the suite goes on without it") for line in lines)
    assert [line for line in lines if line.endswith("ends")] == ["[feeder] ends", "[node] ends"]


def test_who_watches_ends_before_who_plays():
    """Without the bag all would be silent, and the alerts would say so."""
    code, lines = kept(
        program("node", "import time; time.sleep(1.5)"),
        program("page", WAITS, Role.WATCHER),
        program("alerts", WAITS, Role.WATCHER),
        program("player", WAITS, Role.PLAYER),
    )
    assert code == 0
    assert [line for line in lines if line.endswith("ends")] == ["[alerts] ends", "[page] ends", "[player] ends"]


def test_a_watcher_that_cannot_be_is_missed_by_nobody_and_said():
    code, lines = kept(
        program("node", "import time; time.sleep(1.0)"), program("page", "raise SystemExit(2)", Role.WATCHER)
    )
    assert code == 2
    assert any(line.endswith("exit code 2; not started again; the suite goes on without it") for line in lines)


def test_watchers_do_not_keep_a_suite_without_nodes():
    started_s = time.monotonic()
    code, _ = kept(program("node", "raise SystemExit(2)"), program("page", "import time; time.sleep(60)", Role.WATCHER))
    assert code == 2
    assert time.monotonic() - started_s < FAR_S


def run_keeper(*texts):
    """A keeper as a process of its own, which runs programs and tells their process ids."""
    programs = ", ".join(f"Program('p{i}', (sys.executable, '-c', {text!r}))" for i, text in enumerate(texts))
    code = (
        "import sys\nfrom ship_bringup.suite.keeper import Keeper, Program, say_line\n"
        f"raise SystemExit(Keeper(({programs},), 5, say_line).run())"
    )
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)


TELLS_ITS_ID = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
DEAF = "import os, signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); " + TELLS_ITS_ID


def ids(process, count):
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


def test_nothing_is_left_behind_when_the_suite_itself_is_killed():
    keeper = run_keeper(TELLS_ITS_ID, DEAF)
    pids = ids(keeper, 2)
    keeper.kill()
    keeper.wait()
    wait_until_gone(pids)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_all(number):
    keeper = run_keeper(TELLS_ITS_ID, TELLS_ITS_ID)
    pids = ids(keeper, 2)
    keeper.send_signal(number)
    assert keeper.wait(FAR_S) == 0
    assert all(map(is_gone, pids))


def test_a_second_signal_ends_at_once_what_does_not_want_to():
    keeper = run_keeper(DEAF)
    pids = ids(keeper, 1)
    keeper.send_signal(signal.SIGINT)
    time.sleep(0.3)
    os.kill(pids[0], 0)
    started_s = time.monotonic()
    keeper.send_signal(signal.SIGINT)
    keeper.wait(FAR_S)
    assert time.monotonic() - started_s < 5.0  # not the ten seconds of patience
    assert is_gone(pids[0])
