"""Ctrl-C in long commands gives one line, exit code 130 and no partial file; a closed output pipe ends a command."""

import errno
import os
import subprocess
import sys

import pytest

from ship_bags.command_line import CommandParser, run_command
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_testing.calibration_sessions import STILL, session, write_session
from ship_testing.hand_made_bags import write_imu_bag
from ship_testing.short_scenario import SHORT

# The runner repeats a command, each time in a new folder. Ctrl-C is sent at the file access (opening, renaming or
# removal in the folder) with the given number, and again at the next access, as by an impatient user.
RUNNER = """
import os, signal, sys
from pathlib import Path
module, moments, *arguments = sys.argv[1:]
main = __import__(module, fromlist=["main"]).main
base = Path.cwd()
moment = count = 0

def hook(event, given):
    global count
    if moment and event in ("open", "os.rename", "os.remove") and isinstance(given[0], str):
        if os.path.abspath(given[0]).startswith(str(Path.cwd())):
            count += 1
            if count in (moment, moment + 1):
                os.kill(os.getpid(), signal.SIGINT)

def run(number):
    global moment, count
    folder = base / f"run_{number}"
    folder.mkdir()
    os.chdir(folder)
    moment, count = number, 0
    try:
        code = main([str(base / a) if (base / a).is_file() else a for a in arguments])
    finally:
        moment = 0
    return code, {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

# A process in the background ignores Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.addaudithook(hook)
code, whole = run(0)
assert code == 0 and whole, code
for number in map(int, moments.split(",")):
    sys.stderr.write(f"at {number}: ")
    code, found = run(number)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    half = [name for name, content in found.items() if whole.get(name) != content]
    sys.stderr.write(f"{code} {half}\\n" if code != 130 or half else "")
"""
# Command: its module, the file accesses at which Ctrl-C is sent (high numbers are in the middle of files), arguments.
CASES = {
    "simulate": ("ship_simulation.simulate_command", "1,2", ["short.yaml", "--out", "out.mcap"]),
    "replay": ("ship_replay.commands.replay", "1,2", ["in.mcap", "--config", "suite.yaml", "--out", "out.mcap"]),
    "calibrate_installation": (
        "ship_studies.installation.calibrate_installation_command",
        "1,2,3,4",
        ["session.mcap", "--out", "alignment.yaml", "--report", "report"],
    ),
    "layout_study": ("ship_studies.layout.layout_study_command", "1,2,11", ["--out", "study"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_ctrl_c_is_one_line_and_leaves_no_partial_file(case, tmp_path):
    module, interrupts, arguments = CASES[case]
    if case == "simulate":
        (tmp_path / "short.yaml").write_text(SHORT)
    elif case == "replay":
        write_imu_bag(tmp_path / "in.mcap")
        (tmp_path / "suite.yaml").write_text("ship_attitude: {ros__parameters: {ins: {frame_id: ins}}}\n")
    elif case == "calibrate_installation":
        write_session(tmp_path / "session.mcap", session(STILL))
    command = [sys.executable, "-c", RUNNER, module, interrupts, *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    text = f"{case}: interrupted\n"
    assert done.stderr == "".join(f"at {number}: {text}" for number in interrupts.split(","))
    assert done.returncode == 0


@pytest.mark.parametrize("unbuffered", ["", "1"], ids=["", "unbuffered"])
@pytest.mark.parametrize("option", [[], ["--json"], ["--suite"]], ids=str)
def test_a_command_whose_reader_is_gone_ends_without_output(option, unbuffered, tmp_path):
    """The command ends as in `info BAG | head -1`."""
    bag = write_imu_bag(tmp_path / "a.mcap", 3, attachments=[(SUITE_ATTACHMENT, "a: 1\n")])
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "ship_bags.commands.info", str(bag), *option]
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


def test_another_broken_pipe_is_reported(capsys):
    def command(_options):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe", "/dev/sensor")

    assert run_command(CommandParser(prog="a"), command, []) == 2
    assert capsys.readouterr().err == "a: /dev/sensor: Broken pipe\n"
