"""Memory of a live node over a voyage that is played faster than real time: its growth is bounded.

The node is a separate process that receives simulated data over DDS. Its resident memory is sampled periodically. Exit
code 0 within the bounds; 1 the growth or the memory is too large, or a process failed; 2 bad input or usage.
"""

import argparse
import dataclasses
import os
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.live.ros_process import executable
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_msgs.msg import AlignmentState
from ship_simulation.scenario.scenario import start_time_ns
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
from ship_simulation.suite_file import suite_yaml
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import LiveFailure

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "bags" / "scenarios" / "paper.yaml"
MOST_MB, MOST_GROWTH_MB = 130.0, 1.0

_START_S = 30.0
_LOOK_S = 2.0
_BEGIN_SHARE = 0.05
"""Fraction of the span at the beginning, and at the end, over which the compared medians are computed."""
_MOST_MISSED_S = 60.0
_STATM_RESIDENT = 1
_LINES = 12


def main() -> int:
    """Run the node and check its memory."""
    parser = CommandParser(prog="live_memory", description=__doc__, epilog="times are of the simulated ship")
    parser.add_argument("--hours", type=float, default=24.0, metavar="H", help="length of the voyage, h (24)")
    parser.add_argument("--settled-h", type=float, default=1.0, metavar="H", help="growth counts from here, h (1)")
    parser.add_argument("--rate", type=float, default=10.0, metavar="R", help="seconds of the voyage per second (10)")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "live_memory", help="folder of bag and logs")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if not 0.0 <= options.settled_h < options.hours:
        print("live_memory: --settled-h must be less than --hours", file=sys.stderr)
        return 2
    options.folder.mkdir(parents=True, exist_ok=True)
    try:
        hours, resident_mb = node_memory(options.folder, options.hours, options.rate)
    except LiveFailure as failure:
        print(f"live_memory: {failure}", file=sys.stderr)
        return EXIT_BOUND_NOT_MET
    growth_mb, most_mb = growth(hours, resident_mb, options.settled_h), float(resident_mb.max())
    _print_table(hours, resident_mb)
    print(f"growth after {options.settled_h:g} h: {growth_mb:.2f} MB (at most {MOST_GROWTH_MB:g})")
    print(f"most: {most_mb:.1f} MB (at most {MOST_MB:g})")
    return EXIT_DONE if growth_mb <= MOST_GROWTH_MB and most_mb <= MOST_MB else EXIT_BOUND_NOT_MET


def growth(hours: np.ndarray, resident_mb: np.ndarray, settled_h: float) -> float:
    """Return the growth of the resident memory, MB: median of the last twentieth of a span minus that of the first.

    Args:
        hours: hours since the start of the voyage, increasing, shape (n,).
        resident_mb: resident memory at these times, MB, shape (n,).
        settled_h: start of the span, h.
    """
    share_h = _BEGIN_SHARE * (hours[-1] - settled_h)
    begin = (hours >= settled_h) & (hours <= settled_h + share_h)
    return float(np.median(resident_mb[hours >= hours[-1] - share_h]) - np.median(resident_mb[begin]))


def node_memory(folder: Path, length_h: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the hours of the voyage, and the node's resident memory at these times, MB.

    Args:
        folder: folder of bag, configuration and logs.
        length_h: length of the voyage, h.
        rate: seconds of the voyage per second.

    Raises:
        LiveFailure: a process failed.
    """
    scenario = dataclasses.replace(load_scenario(SCENARIO), duration_s=3600.0 * length_h)
    bag, suite = folder / "voyage.mcap", folder / "suite.yaml"
    write_bag(scenario, 1, bag, SCENARIO.read_bytes())
    suite.write_text(suite_yaml(scenario), encoding="utf-8")
    domain_id = free_domain_id()
    environment = live_environment(domain_id, folder / "ros")
    node_command = [*executable("ship_attitude_star", ShipAttitudeAdapter.node_name), "--ros-args"]
    node_command += ["--params-file", str(suite), "-p", "use_sim_time:=true", "-p", "reliable_inputs:=true"]
    inputs = ["ins/imu", *(f"star/{key}/horizon_attitude" for key in scenario.star_sensors)]
    play_command = [*executable("ship_bags", "play"), str(bag), "--rate", str(rate), "--topics", *inputs]
    play_command += ["--wait-for-subscribers", *(f"{topic}=1" for topic in inputs)]
    with GraphObserver(domain_id) as observer, LiveProcess(node_command, folder / "node.log", environment) as node:
        there = {"/ship/attitude": 1}
        if not observer.wait_for(there, timeout_s=_START_S, unless=lambda: node.exit_code is not None):
            raise LiveFailure(f"the node does not start:\n{node.log_text()}")
        with LiveProcess(play_command, folder / "play.log", environment) as player:
            samples, last_ns = _sample_memory(node, player, observer, rate)
        if player.exit_code != 0:
            raise LiveFailure(f"play ended with exit code {player.exit_code}:\n{player.log_text()}")
    missed_s = scenario.duration_s - (last_ns - start_time_ns(scenario.start_utc)) / NS_PER_S
    if missed_s > _MOST_MISSED_S:
        raise LiveFailure(f"the node published its last alignment {missed_s:.0f} s before the voyage's end")
    return np.array([hours for hours, _ in samples]), np.array([resident_mb for _, resident_mb in samples])


def _sample_memory(
    node: LiveProcess, player: LiveProcess, observer: GraphObserver, rate: float
) -> tuple[list[tuple[float, float]], int]:
    """Return pairs of hour of the voyage and node's memory, MB, until the player ends, and the node's last stamp."""
    samples, last_ns = [], 0

    def note(message: AlignmentState) -> None:
        nonlocal last_ns
        last_ns = ns_from_stamp(message.header.stamp)

    observer.node.create_subscription(AlignmentState, "ship/alignment", note, 10)
    begin_s = time.monotonic()
    while player.exit_code is None:
        if node.exit_code is not None:
            raise LiveFailure(f"the node ended with exit code {node.exit_code}:\n{node.log_text()}")
        samples.append((rate * (time.monotonic() - begin_s) / 3600.0, _resident_mb(node.pid)))
        observer.spin_until(lambda: False, _LOOK_S)
    return samples, last_ns


def _resident_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[_STATM_RESIDENT])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _print_table(hours: np.ndarray, resident_mb: np.ndarray) -> None:
    console = Console(width=80)
    for row in np.unique(np.linspace(0, len(hours) - 1, _LINES).astype(int)):
        console.print(f"{hours[row]:6.2f} h {resident_mb[row]:8.1f} MB")


if __name__ == "__main__":
    sys.exit(main())
