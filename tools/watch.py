"""``make watch``: a simulated voyage with all devices, repeated through the live suite, and its live page.

The bag is simulated the first time, from ``bags/scenarios/everything.yaml``: the bags in ``bags/`` contain the ship or
the theodolite, not both. All files are in ``build/watch``. Ctrl-C ends the voyage.

Exit code 0 ended by Ctrl-C; 2 bad input, or the port is in use; otherwise the exit code of the suite.
"""

import argparse
import os
import socket
import sys
from pathlib import Path

from ship_bags.command_line import CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bringup.commands.suite import main as suite
from ship_simulation.simulate_command import main as simulate

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "bags" / "scenarios" / "everything.yaml"
FOLDER = ROOT / "build" / "watch"
ADDRESS, PORT = "127.0.0.1", 5006


def main() -> int:
    """Run the suite, its page and the simulated voyage."""
    parser = CommandParser(prog="watch", description="A simulated voyage through the live suite, with its page.")
    parser.add_argument("--port", type=int, default=PORT, metavar="PORT", help=f"of the page ({PORT})")
    parser.add_argument("--rate", default="1", metavar="R", help="seconds of the voyage per second (1)")
    return run_command(parser, _watch, None)


def _watch(parsed: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_LOG_DIR", str(FOLDER / "ros"))
    _check_port(parsed.port)
    bag = _bag()
    # The page prints its address again when it is ready.
    print(f"\n  In a moment: http://{ADDRESS}:{parsed.port}/ in a browser. Ctrl-C ends all.\n", flush=True)
    return suite(["--bag", str(bag), "--loop", "0", "--rate", parsed.rate, "--monitor", "--port", str(parsed.port)])


def _check_port(port: int) -> None:
    """Raise an error if the port is in use, because the page of this voyage would not be visible."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((ADDRESS, port))
        except (OSError, OverflowError) as problem:
            reason = problem.strerror if isinstance(problem, OSError) else str(problem)
            raise BadInput(f"port {port} of {ADDRESS}: {reason}: use another, make watch PORT={port + 1}") from problem


def _bag() -> Path:
    """Return the path of the bag; simulate the voyage if the bag is missing or older than the scenario."""
    path = FOLDER / "everything.mcap"
    if not path.exists() or path.stat().st_mtime < SCENARIO.stat().st_mtime:
        FOLDER.mkdir(parents=True, exist_ok=True)
        print("watch: simulating a voyage of five minutes", flush=True)
        part = path.with_name("part.mcap")
        code = simulate([str(SCENARIO), "--out", str(part), "--seed", "1", "--force"])
        if code:
            sys.exit(code)
        part.replace(path)
    return path


if __name__ == "__main__":
    raise SystemExit(main())
