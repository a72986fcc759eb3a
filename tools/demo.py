"""``make demo``: simulated voyages through the real nodes over DDS, recorded, evaluated, drawn.

First the ship's attitude from INS and stars, then the theodolite's optical axis from the lights of two drones.

Exit code 0 done; 1 a process failed, a message was lost or a bound was not met; 2 bad input or usage.
"""

import argparse
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import relative_topic
from ship_node.edge.adapter import Adapter
from ship_replay.evaluation.bounds import judge, read_bounds
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.figures import attitude_error_figure, save_figure
from ship_replay.evaluation.tables import attitude_table
from ship_replay.trials.live_run import LiveFailure, LiveRun
from ship_watch.orientations import POINTING, SHIP_ATTITUDE, Orientation
from theodolite_calib.ros.optical_axis_adapter import OpticalAxisAdapter

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "demo"


@dataclass(frozen=True)
class Leg:
    """One bag through one node.

    Attributes:
        bag: its name.
        adapter: of the node.
        package: of the node's executable.
        orientation: what the node publishes, one for each sample.
        sample_topic: where these come.
        rate: seconds of the bag per second.
        title: of the figure.
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
        """The bag."""
        return ROOT / "bags" / f"{self.bag}.mcap"


LEGS = (
    Leg(
        bag="demo",
        adapter=ShipAttitudeAdapter,
        package="ship_attitude_star",
        orientation=SHIP_ATTITUDE,
        sample_topic="ins/imu",
        rate=2.0,
        title="Ship attitude live: errors and their ±3σ; clouds from 70 s to 90 s",
    ),
    Leg(
        bag="theodolite",
        adapter=OpticalAxisAdapter,
        package="theodolite_calib",
        orientation=POINTING,
        sample_topic="theodolite/encoder",
        rate=4.0,
        title="Optical axis live: two lights until 80 s (one from 40 s to 50 s), then encoders alone",
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
    parser.add_argument("--figures", type=Path, default=FOLDER, metavar="DIR", help="folder for the figures")
    return run_command(parser, _demo, None)


def _demo(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    console = Console(width=None if sys.stdout.isatty() else 110)
    options.figures.mkdir(parents=True, exist_ok=True)
    complaints: list[str] = []
    try:
        for leg in LEGS:
            complaints += _sail_and_judge(leg, options, console)
    except LiveFailure as failure:
        complaints.append(str(failure))
    for complaint in complaints:
        print(f"demo: {complaint}", file=sys.stderr)
    return EXIT_BOUND_NOT_MET if complaints else EXIT_DONE


def _sail_and_judge(leg: Leg, options: argparse.Namespace, console: Console) -> list[str]:
    """One leg with its table and figure; returns what was wrong, one line each."""
    recorded_path, played_topics = _sail(leg, leg.rate * options.rate, console)
    complaints = _losses(leg, recorded_path, played_topics)
    bounds_path = leg.bag_path.with_suffix(".expected.yaml")
    bounds = read_bounds(bounds_path)
    evaluation = evaluate(recorded_path, against=leg.bag_path, skip_s=bounds.skip_s)
    print(f"after the first {bounds.skip_s:g} s:")
    console.print(attitude_table(_about(leg, evaluation)))
    whole = _about(leg, evaluate(recorded_path, against=leg.bag_path))
    figure_path = options.figures / f"{leg.bag}.png"
    save_figure(attitude_error_figure(whole.errors, leg.title), figure_path)
    print(f"recorded bag: {_shown(recorded_path)}")
    print(f"figure of the errors and their ±3σ: {_shown(figure_path)}")
    judged = judge(evaluation.flat(), bounds, str(bounds_path))
    return complaints + [bound.line for bound in judged if not bound.met]


def _sail(leg: Leg, rate: float, console: Console) -> tuple[Path, list[str]]:
    """Play the bag through the live node; returns the recording, and the topics played."""
    with read_bag(leg.bag_path) as bag:
        length_s = ((bag.end_ns or 0) - (bag.start_ns or 0)) / NS_PER_S
    node = leg.adapter.node_name
    print(f"{_shown(leg.bag_path)}: {length_s:.0f} s, played at {rate:g} times their speed through the live {node}")
    with LiveRun(leg.bag_path, leg.adapter, leg.package, FOLDER / leg.bag) as run:
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task("sailing", total=length_s)
            run.play(rate, watch=lambda elapsed_s: progress.update(task, completed=elapsed_s * rate))
        return run.recorded_path, run.played_topics


def _about(leg: Leg, evaluation: Evaluation) -> Evaluation:
    """The part of an evaluation that is about what the node publishes."""
    return replace(evaluation, errors=[e for e in evaluation.errors if e.channels == leg.orientation.channels])


def _losses(leg: Leg, recorded_path: Path, played_topics: list[str]) -> list[str]:
    """One line for each topic of which messages were lost on the way."""
    sent, received = _counts(leg.bag_path), _counts(recorded_path)
    result = leg.orientation.topic
    received[result] = _claims(recorded_path, result)
    expected = {topic: sent[topic] for topic in played_topics} | {result: sent[leg.sample_topic]}
    print("recorded: " + ", ".join(f"{topic} {received.get(topic, 0)} of {n}" for topic, n in expected.items()))
    return [
        f"{topic}: {received.get(topic, 0)} messages were recorded, {count} expected"
        for topic, count in expected.items()
        if received.get(topic, 0) != count
    ]


def _claims(path: Path, topic: str) -> int:
    """How many of the published messages claim something: one for each sample, in these bags for all of them."""
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


def _shown(path: Path) -> Path:
    """The path from here where that is shorter."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


if __name__ == "__main__":
    raise SystemExit(main())
