"""``make demo``: simulated voyages through the real nodes over DDS, recorded, evaluated, drawn.

The first voyage gives the ship's attitude from INS and stars, the second the theodolite's optical axis from two lights.
``--offline`` replays the first bag without nodes (``make quick``).

Exit code 0 done; 1 a process failed or a node published nothing; 2 bad input or usage. Messages lost on a computer that
is too slow for the live nodes are reported, and are no failure; tests check the bounds (test/test_live_replay.py).
"""

import argparse
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import relative_topic
from ship_node.adapters.adapter import Adapter
from ship_node.pages.figure_files import save_figure
from ship_replay.evaluation.bounds import read_bounds
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.figures import attitude_error_figure
from ship_replay.evaluation.tables import attitude_table
from ship_testing.trials.live_run import LiveFailure, LiveRun
from ship_watch.orientations import POINTING, SHIP_ATTITUDE, Orientation
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "demo"


@dataclass(frozen=True)
class DemoRun:
    """One bag through one node.

    Attributes:
        bag: name of the bag.
        adapter: adapter of the node.
        package: package of the node's executable.
        orientation: output of the node, one message for each sample.
        sample_topic: topic of the samples.
        rate: seconds of the bag per second.
        title: title of the figure.
    """

    bag: str
    adapter: type[Adapter]
    package: str
    orientation: Orientation
    sample_topic: str
    rate: float
    title: str

    @property
    def bag_path(self) -> Path:
        """Return the path of the bag."""
        return ROOT / "bags" / f"{self.bag}.mcap"


LEGS = (
    DemoRun(
        bag="demo",
        adapter=ShipAttitudeAdapter,
        package="ship_attitude_star",
        orientation=SHIP_ATTITUDE,
        sample_topic="ins/imu",
        rate=2.0,
        title="Ship attitude: errors and their ±3σ; clouds from 70 s to 90 s",
    ),
    DemoRun(
        bag="theodolite",
        adapter=OpticalAxisAdapter,
        package="theodolite_calib",
        orientation=POINTING,
        sample_topic="theodolite/encoder",
        rate=4.0,
        title="Optical axis: two lights until 80 s (one from 40 s to 50 s), then encoders alone",
    ),
)


def main() -> int:
    """Run the demonstration."""
    parser = CommandParser(
        prog="demo", description="Simulated voyages through the live nodes: play, record, evaluate, draw."
    )
    parser.add_argument(
        "--rate", type=float, default=1.0, metavar="R", help="factor on the speed at which the bags are played (1)"
    )
    parser.add_argument("--offline", action="store_true", help="replay the first bag without nodes, whatever the rate")
    parser.add_argument("--figures", type=Path, default=FOLDER, metavar="DIR", help="folder for the figures")
    return run_command(parser, _demo, None)


def _demo(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    console = Console(width=None if sys.stdout.isatty() else 110)
    options.figures.mkdir(parents=True, exist_ok=True)
    try:
        for leg in LEGS[:1] if options.offline else LEGS:
            begin_s = time.monotonic()
            recorded_path = _replay(leg) if options.offline else _run_live(leg, leg.rate * options.rate, console)
            _require_outputs(leg, recorded_path)
            _show(leg, recorded_path, options.figures, console)
            print(f"{leg.bag}: {time.monotonic() - begin_s:.0f} s\n")
    except LiveFailure as failure:
        print(f"demo: {failure}", file=sys.stderr)
        return EXIT_BOUND_NOT_MET
    return EXIT_DONE


def _replay(leg: DemoRun) -> Path:
    """Replay the bag offline; return the bag of outputs."""
    path = FOLDER / f"{leg.bag}_offline.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    command = [*executable("ship_replay", "replay"), str(leg.bag_path), "--out", str(path), "--force"]
    if (code := subprocess.run(command, check=False).returncode) != 0:
        raise LiveFailure(f"replay ended with exit code {code}")
    return path


def _run_live(leg: DemoRun, rate: float, console: Console) -> Path:
    """Play the bag through the live node and print the lost messages; return the recording."""
    with read_bag(leg.bag_path) as bag:
        length_s = (bag.end_ns - bag.start_ns) / NS_PER_S
    node = leg.adapter.node_name
    print(f"{_short_path(leg.bag_path)}: {length_s:.0f} s, played at {rate:g} times real time to the live node {node}")
    with LiveRun(leg.bag_path, leg.adapter, leg.package, FOLDER / leg.bag) as run:
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task("sailing", total=length_s)
            run.play(rate, report_elapsed=lambda elapsed_s: progress.update(task, completed=elapsed_s * rate))
        recorded_path, played_topics = run.recorded_path, run.played_topics
    _print_losses(leg, recorded_path, played_topics)
    return recorded_path


def _show(leg: DemoRun, recorded_path: Path, figures: Path, console: Console) -> None:
    """Print the table of errors and draw their figure."""
    skip_s = read_bounds(leg.bag_path.with_suffix(".expected.yaml")).skip_s
    evaluation = evaluate(recorded_path, against=leg.bag_path, skip_s=skip_s)
    print(f"after the first {skip_s:g} s:")
    console.print(attitude_table(_node_evaluation(leg, evaluation)))
    whole = _node_evaluation(leg, evaluate(recorded_path, against=leg.bag_path))
    figure_path = figures / f"{leg.bag}.png"
    save_figure(attitude_error_figure(whole.errors, leg.title), figure_path)
    print(f"recorded bag: {_short_path(recorded_path)}")
    print(f"figure of the errors and their ±3σ: {_short_path(figure_path)}")


def _node_evaluation(leg: DemoRun, evaluation: Evaluation) -> Evaluation:
    """Return the part of an evaluation that concerns the node's output."""
    return replace(evaluation, errors=[e for e in evaluation.errors if e.channels == leg.orientation.channels])


def _print_losses(leg: DemoRun, recorded_path: Path, played_topics: list[str]) -> None:
    """Print the number of recorded messages of each topic, and the load of the computer if messages are missing."""
    sent, received = _counts(leg.bag_path), _counts(recorded_path)
    result = leg.orientation.topic
    received[result] = _valid_outputs(recorded_path, result)
    expected = {topic: sent[topic] for topic in played_topics} | {result: sent[leg.sample_topic]}
    print("recorded: " + ", ".join(f"{topic} {received.get(topic, 0)} of {n}" for topic, n in expected.items()))
    lost = [f"{n - received.get(topic, 0)} of {topic}" for topic, n in expected.items() if received.get(topic, 0) < n]
    if lost:
        load, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
        busy = "; it was probably too busy" if load > cores else ""
        print(f"missing or INVALID: {', '.join(lost)}; load of this computer {load:.1f}, {cores} cores{busy}")


def _require_outputs(leg: DemoRun, recorded_path: Path) -> None:
    """Raise an error if the node published no valid output."""
    if not _valid_outputs(recorded_path, leg.orientation.topic):
        raise LiveFailure(f"{leg.adapter.node_name} published nothing on {leg.orientation.topic} that is valid")


def _valid_outputs(path: Path, topic: str) -> int:
    """Return the number of published messages that are not INVALID; in these bags, one for each sample is expected."""
    with read_bag(path) as bag:
        names = [name for name in bag.topics if relative_topic(name) == topic]
        messages = [record.decode() for record in bag.records(names)]
    return sum(message.status != message.INVALID for message in messages)


def _counts(path: Path) -> dict[str, int]:
    counts: dict[str, int] = {}
    with read_bag(path) as bag:
        for record in bag.records():
            topic = relative_topic(record.topic) or record.topic
            counts[topic] = counts.get(topic, 0) + 1
    return counts


def _short_path(path: Path) -> Path:
    """Return the path relative to the current folder if the path is within this folder."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


if __name__ == "__main__":
    raise SystemExit(main())
