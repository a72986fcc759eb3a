"""``monitor_terminal``: view of a suite in a terminal, over ssh."""

import argparse
import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence

from ship_bags.command_line import CommandParser, run_command
from ship_bags.errors import BadInput
from ship_monitor.commands.display_options import add_display_options
from ship_monitor.live.live_suite import LiveSuite
from ship_monitor.terminal.app import TerminalApp
from ship_watch.safety.limits import Limits, read_limits

_DESCRIPTION = """\
Shows a suite in a terminal of 80 by 24 or more, also over ssh: heading, pitch, roll, azimuth and elevation with their
95 % accuracy; SAFE, CAUTION or UNSAFE; the sources, OUT first, the events, the alerts. Unlike the page of monitor it
can acknowledge alerts. Key ? explains the terms. Colours are not needed (NO_COLOR=1 switches them off). A terminal
whose locale is not UTF-8 gets ASCII: deg for °, " for ″, +- for ±. ROS_DOMAIN_ID sets the ROS domain.
"""
_EPILOG = (
    "exit code: 0 left by key q; 1 ended by an error; 130 by Ctrl-C, SIGTERM or SIGHUP; 2 bad input or usage, or no "
    "terminal"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``monitor_terminal``; returns the exit code."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_monitor",
        prog="monitor_terminal",
        example="--namespace demo --limits limits.yaml --theme night",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the suite (none)")
    add_display_options(parser, "colours at the start (day)")
    parser.add_argument(
        "--characters",
        choices=("auto", "utf8", "ascii"),
        default="auto",
        help="characters of the terminal (auto: by locale)",
    )
    return parser


def _run(parsed: argparse.Namespace) -> int:
    limits = Limits() if parsed.limits is None else read_limits(parsed.limits)
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise BadInput("stdin or stderr is not a terminal; over ssh use ssh -t")
    is_ascii = parsed.characters == "ascii" or (parsed.characters == "auto" and not is_utf8_locale(os.environ))
    with _stderr_deferred_to_exit():
        suite = LiveSuite("monitor_terminal", parsed.namespace, limits)
        try:
            exit_code = TerminalApp(suite, parsed.theme, is_ascii=is_ascii, zone=parsed.time_zone).run()
        finally:
            suite.close()
    # The exit code is None if textual ended after an exception, which textual has displayed.
    return 1 if exit_code is None else exit_code


@contextlib.contextmanager
def _stderr_deferred_to_exit() -> Iterator[None]:
    """Defer the stderr of libraries to the end: ROS and DDS would write across the display."""
    terminal_fd, drawn_on = os.dup(2), sys.__stderr__
    with tempfile.TemporaryFile() as kept, os.fdopen(terminal_fd, "w", encoding="utf-8", closefd=False) as terminal:
        os.dup2(kept.fileno(), 2)
        sys.__stderr__ = terminal  # type: ignore[misc]  # textual draws on this stream
        try:
            yield
        finally:
            sys.__stderr__ = drawn_on  # type: ignore[misc]
            os.dup2(terminal_fd, 2)
            kept.seek(0)
            sys.stderr.write(kept.read().decode(errors="replace"))
    os.close(terminal_fd)


def is_utf8_locale(environment: Mapping[str, str]) -> bool:
    """True if the locale of an environment uses UTF-8.

    LC_CTYPE=C.UTF-8 is ignored: Python itself sets it if the locale is C (PEP 538).
    """
    ctype = environment.get("LC_CTYPE", "")
    named = environment.get("LC_ALL") or (ctype if ctype != "C.UTF-8" else "") or environment.get("LANG", "")
    return "utf" in named.lower()
