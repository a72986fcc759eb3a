"""``make demo``: a simulated voyage through the real node over DDS, recorded, evaluated, drawn.

Exit code 0 done; 1 a process failed, a message was lost or a bound was not met; 2 bad input or usage.
"""

import argparse
import os
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_replay.bag_reader import read_bag
from ship_replay.bounds import judge, read_bounds
from ship_replay.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_replay.evaluate import evaluate
from ship_replay.evaluation_tables import attitude_table
from ship_replay.figures import attitude_error_figure, save_figure
from ship_replay.live_run import LiveFailure, LiveRun
from ship_replay.times import NS_PER_S
from ship_replay.topic_names import relative_topic

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / "bags" / "demo.mcap"
FOLDER = ROOT / "build" / "demo"
INS_TOPIC = "ins/imu"
# One for each INS sample from which an attitude could be claimed: in this bag for all of them.
RESULT_TOPIC = "ship/imu"


def main() -> int:
    """Run the demonstration."""
    parser = CommandParser(prog="demo", description="A simulated voyage through the live node: play, record, evaluate.")
    parser.add_argument("--rate", type=float, default=2.0, metavar="R", help="seconds of the bag per second (2)")
    parser.add_argument("--figure", type=Path, default=FOLDER / "errors.png", metavar="FILE.png", help="figure to draw")
    return run_command(parser, _demo, None)


def _demo(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    console = Console(width=None if sys.stdout.isatty() else 110)
    try:
        recorded_path, played_topics = _sail(options.rate, console)
    except LiveFailure as failure:
        print(f"demo: {failure}", file=sys.stderr)
        return EXIT_BOUND_NOT_MET
    complaints = _losses(recorded_path, played_topics)
    bounds_path = BAG.with_suffix(".expected.yaml")
    bounds = read_bounds(bounds_path)
    evaluation = evaluate(recorded_path, against=BAG, skip_s=bounds.skip_s)
    print(f"after the first {bounds.skip_s:g} s:")
    console.print(attitude_table(evaluation))
    options.figure.parent.mkdir(parents=True, exist_ok=True)
    whole = evaluate(recorded_path, against=BAG)
    save_figure(attitude_error_figure(whole.errors, "Ship attitude live: errors inside their ±3σ"), options.figure)
    print(f"recorded bag: {_shown(recorded_path)}")
    print(f"figure of the errors inside their ±3σ: {_shown(options.figure)}")
    judged = judge(evaluation.flat(), bounds, str(bounds_path))
    complaints += [bound.line for bound in judged if not bound.met]
    for complaint in complaints:
        print(f"demo: {complaint}", file=sys.stderr)
    return EXIT_BOUND_NOT_MET if complaints else EXIT_DONE


def _sail(rate: float, console: Console) -> tuple[Path, list[str]]:
    """Play the bag through the live node; returns the recording, and the topics played."""
    with read_bag(BAG) as bag:
        length_s = ((bag.end_ns or 0) - (bag.start_ns or 0)) / NS_PER_S
    print(f"{_shown(BAG)}: {length_s:.0f} s, played at {rate:g} times their speed through the live ship_attitude")
    with LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", FOLDER) as run:
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task("sailing", total=length_s)
            run.play(rate, watch=lambda elapsed_s: progress.update(task, completed=elapsed_s * rate))
        return run.recorded_path, run.played_topics


def _losses(recorded_path: Path, played_topics: list[str]) -> list[str]:
    """One line for each topic of which messages were lost on the way."""
    sent, received = _counts(BAG), _counts(recorded_path)
    expected = {topic: sent[topic] for topic in played_topics} | {RESULT_TOPIC: sent[INS_TOPIC]}
    print("recorded: " + ", ".join(f"{topic} {received.get(topic, 0)} of {n}" for topic, n in expected.items()))
    return [
        f"{topic}: {received.get(topic, 0)} messages were recorded, {count} expected"
        for topic, count in expected.items()
        if received.get(topic, 0) != count
    ]


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
