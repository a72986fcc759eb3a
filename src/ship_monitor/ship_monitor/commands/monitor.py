"""``monitor``: live page of a suite."""

import argparse
import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.live.ros_process import call_on_end_signals, heartbeat
from ship_bags.topic_names import add_remap_option
from ship_monitor.commands.display_options import add_display_options
from ship_monitor.live.live_suite import LiveSuite
from ship_monitor.page.app import PageSource, page_maker
from ship_monitor.page.bag_playback import BagPlayback, RecordedSuite
from ship_monitor.page.server import PageServer
from ship_monitor.web.foxglove_server import FoxgloveServer
from ship_watch.safety.limits import Limits, read_limits

FOXGLOVE_PORT = 8765
"""Default port of Foxglove."""

_DESCRIPTION = """\
Serves the live page of a suite: heading, pitch, roll, azimuth and elevation with their 95 % accuracy; SAFE, CAUTION or
UNSAFE; the sources that are IN and OUT, the alerts, the last ten minutes; below them plots. It is read-only: estimators
never wait for it, and nothing can be changed from the page. One reader of topics serves all browsers. Without --address
only browsers on this machine can open it; over ssh, open a tunnel: ssh -L 5006:localhost:5006 SHIP.

With --foxglove it also serves the suite's topics by websocket to Foxglove or Lichtblick ("Open connection", "Foxglove
WebSocket"), with all messages of the subscribed topics. Nothing can be published that way. Web pages of other sites,
except Foxglove's own, are refused.

With --bag the same page shows a bag or a black box: a slider under the top bar sets the time, space plays, arrows move
by 10 s (with shift by a minute), Home and End go to its ends. Each browser has its own time.

Ctrl-C or SIGTERM ends it. ROS_DOMAIN_ID sets the ROS domain.
"""
_EPILOG = "exit code: 0 ended by a signal; 2 bad input or usage, or the port is in use"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``monitor``; returns the exit code."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_monitor",
        prog="monitor",
        example="--namespace demo --limits limits.yaml --theme dusk",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the suite (none)")
    parser.add_argument("--bag", type=Path, metavar="BAG", help="show a bag or black box, with a time slider")
    add_remap_option(parser, is_by_suite=True)
    parser.add_argument("--address", default="127.0.0.1", help="address to listen on; 0.0.0.0 is all (127.0.0.1)")
    parser.add_argument(
        "--allow-host",
        action="append",
        default=[],
        metavar="NAME",
        help="also answer requests to this host name, and with --foxglove web pages from it; may be repeated (with "
        "--address the machine's own name and addresses, else localhost)",
    )
    parser.add_argument("--port", type=_port, default=5006, metavar="N", help="TCP port; 0 takes a free one (5006)")
    parser.add_argument(
        "--foxglove",
        type=_port,
        nargs="?",
        const=FOXGLOVE_PORT,
        metavar="N",
        help=f"also serve the topics to Foxglove, on this TCP port; 0 takes a free one ({FOXGLOVE_PORT})",
    )
    add_display_options(parser, "theme of page addresses without one (day)")
    return parser


def _port(text: str) -> int:
    port = int(text)
    if not 0 <= port <= 65535:
        raise argparse.ArgumentTypeError(f"{text} is not a port: expected 0 to 65535")
    return port


def _run(parsed: argparse.Namespace) -> int:
    limits = Limits() if parsed.limits is None else read_limits(parsed.limits)
    if parsed.bag is not None:
        return _serve_bag(parsed, limits)
    with contextlib.ExitStack() as left_open:
        foxglove = None
        if parsed.foxglove is not None:
            name = parsed.namespace.strip("/") or "ship"
            foxglove = FoxgloveServer(name, parsed.address, parsed.foxglove, parsed.allow_host)
            left_open.callback(foxglove.close)
        suite = LiveSuite("monitor", parsed.namespace, limits, foxglove)
        left_open.callback(suite.close)
        return _serve(parsed, lambda: suite, suite.tick, suite.location, foxglove)


def _serve_bag(parsed: argparse.Namespace, limits: Limits) -> int:
    if parsed.foxglove is not None:
        raise BadInput(f"--foxglove serves a live suite: Foxglove opens {parsed.bag} by itself")
    suite = RecordedSuite(parsed.bag, parsed.namespace)
    try:
        for note in suite.notes:
            print(f"monitor: {note}", flush=True)
        return _serve(parsed, lambda: BagPlayback(suite, limits), lambda: None, str(suite.path))
    finally:
        suite.close()


def _serve(
    parsed: argparse.Namespace,
    open_source: Callable[[], PageSource],
    tick: Callable[[], None],
    description: str,
    foxglove: FoxgloveServer | None = None,
) -> int:
    def tick_and_beat() -> None:
        heartbeat().beat(time.monotonic_ns())
        tick()

    make = page_maker(open_source, parsed.theme, parsed.time_zone)
    server = PageServer(make, parsed.address, parsed.port, tick_and_beat, parsed.allow_host)
    call_on_end_signals(server.stop)
    if foxglove is not None:
        print(f"monitor: {foxglove.address} for Foxglove", flush=True)
    print(f"monitor: {server.address} ({description})", flush=True)
    server.run()
    return EXIT_DONE


if __name__ == "__main__":
    raise SystemExit(main())
