"""Progress on stderr: periodic lines in a file, one rewritten line on a terminal, none after Ctrl-C."""

import contextlib
import os
import pty
import subprocess
import sys

import pytest

from ship_bags.command_line import Progress, progress_text, with_count, with_progress

# A command that works for three seconds; with the argument "interrupted" it is interrupted at the end.
COMMAND = """
import sys, time
from ship_bags.command_line import CommandParser, run_command
from ship_bags.command_line import with_count

def work(_options):
    kept = with_count(range(30), "night.mcap", 30)
    for number in kept:
        time.sleep(0.1)
        if number == 28 and sys.argv[1] == "interrupted":
            raise KeyboardInterrupt
    print("done")
    return 0

sys.exit(run_command(CommandParser(prog="work"), work, []))
"""


def shown_text(capsys, shares, seconds_between):
    """Return the lines on a stderr that is no terminal, for work that advances uniformly."""
    times = iter([0.0, *(seconds_between * (number + 1) for number in range(len(shares)))])
    with Progress("night.mcap", lambda: next(times)) as progress:
        for share in shares:
            progress.show(share)
    return capsys.readouterr().err.splitlines()


def test_a_file_gets_a_line_every_ten_seconds(capsys):
    assert shown_text(capsys, [0.1 * part for part in range(1, 10)], 4.0) == [
        "night.mcap: 30 %, 28 s left", "night.mcap: 60 %, 16 s left", "night.mcap: 90 %, 4 s left",
    ]


def test_short_work_writes_nothing(capsys):
    assert shown_text(capsys, [0.5, 1.0], 1.0) == []


@pytest.mark.parametrize(
    ("share", "elapsed_s", "text"),
    [(0.0, 12.0, "a: 0 %, 12 s so far"), (0.25, 30.0, "a: 25 %, 1 min 30 s left"),
     (0.1, 800.0, "a: 10 %, 2 h 00 min left"),
     (1.2, 5.0, "a: 100 %, 0 s left"), (-0.5, 5.0, "a: 0 %, 5 s so far")],
)
def test_the_time_left_follows_from_the_share(share, elapsed_s, text):
    assert progress_text("a", share, elapsed_s) == text


def test_all_items_pass():
    assert list(with_progress([3, 5, 9], "a", 3, 9, float)) == [3, 5, 9]
    assert list(with_count(iter("abc"), "a", 3)) == ["a", "b", "c"]
    assert list(with_progress([], "a", 0, 0, float)) == []


@pytest.mark.parametrize(("how", "code", "last"), [("whole", 0, "done"), ("interrupted", 130, "work: interrupted")])
def test_a_terminal_has_one_line_that_is_erased(how, code, last):
    ours, theirs = pty.openpty()
    process = subprocess.Popen([sys.executable, "-c", COMMAND, how], stdout=theirs, stderr=theirs)
    os.close(theirs)
    text = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while part := os.read(ours, 4096):
            text += part
    os.close(ours)
    assert process.wait() == code
    *states, end = text.decode().split("\r\x1b[K")
    assert len(states) > 1
    assert all(state.startswith("night.mcap: ") and state.endswith(" left") for state in states[1:])
    assert end == f"{last}\r\n"
