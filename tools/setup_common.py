"""Paths, progress lines, commands and stamps shared by the steps of setup."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
SRC = ROOT / "src"
BUILD = ROOT / "build"
INSTALL = ROOT / "install"
SETUP_LOG = VENV / "setup.log"
CORES = len(os.sched_getaffinity(0))


class SetupError(Exception):
    """Setup cannot continue; the text is one line with the action needed."""


def print_progress(text: str) -> None:
    """Print one line of progress, unbuffered."""
    print(f"setup: {text}", flush=True)


@contextmanager
def step(what: str) -> Iterator[None]:
    """Print a step with its duration when it is done."""
    begin_s = time.monotonic()
    yield
    print_progress(f"{what}: {time.monotonic() - begin_s:.0f} s")


_running: set[subprocess.Popen[str]] = set()
_ended = threading.Event()


def run(command: list[str], env: dict[str, str] | None = None, cwd: Path = ROOT) -> str:
    """Run a command with its output appended to the log; return the output.

    Raises:
        CalledProcessError: the command failed; the error contains the output.
        SetupError: :func:`end_commands` was called before.
    """
    if _ended.is_set():
        raise SetupError("another step failed")
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, cwd=cwd, env=env, text=True, start_new_session=True, **pipes) as process:
        _running.add(process)
        output, _ = process.communicate()
        _running.discard(process)
    with SETUP_LOG.open("a") as file:
        file.write(f"$ {' '.join(command)}\n{output}\n")
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command, output)
    return output


def end_commands() -> None:
    """End the running commands and their children, so that a failed step does not wait for other steps."""
    _ended.set()
    for process in list(_running):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)


def read_stamp(path: Path) -> str:
    """Return the content of a stamp; empty if the step was never finished."""
    try:
        return path.read_text()
    except OSError:
        return ""


def last_line(text: str, containing: str = "") -> str:
    """Return the last line that is not empty and contains ``containing``; "no output" if there is none."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and containing in line]
    return lines[-1] if lines else "no output"


def wheels_environment() -> dict[str, str]:
    """Return the environment in which the Python of the wheels does not start itself again."""
    return {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
