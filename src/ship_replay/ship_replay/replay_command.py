"""``replay``: a bag through the ship_attitude node's adapter, offline."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_replay.command_line import EXIT_DONE, CommandParser, run_command
from ship_replay.progress import watched
from ship_replay.replay import ReplaySummary, replay


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="replay",
        epilog="exit code: 0 replayed; 2 bad input or usage, with one line that says which",
        description="Replay a bag through the ship_attitude node, in process and as fast as it goes; the same bag "
        "and configuration give the same output. Topics truth/* are copied.",
    )
    parser.add_argument("bag", type=Path, metavar="IN.mcap", help=".mcap file or rosbag2 folder")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT.mcap", help="bag to write")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    parser.add_argument("--namespace", default="", help="namespace of the ship's topics in the bag")
    parser.add_argument("--report", type=Path, metavar="DIR", help="folder for figures (errors in arcsec) and JSON")
    return parser


def _run(options: argparse.Namespace) -> int:
    summary = replay(options.bag, options.out, ShipAttitudeAdapter, options.config, options.namespace, watch=watched)
    _print(summary)
    if options.report is not None:
        # Loading the figures' libraries takes longer than many a replay.
        from ship_replay.evaluate import evaluate
        from ship_replay.figures import evaluation_figure, save_figure

        evaluation = evaluate(options.out, against=options.bag, namespace=options.namespace)
        options.report.mkdir(parents=True, exist_ok=True)
        figure_path = options.report / f"{options.out.stem}.png"
        save_figure(evaluation_figure(evaluation, options.out.name), figure_path)
        values_path = options.report / f"{options.out.stem}.json"
        values_path.write_text(evaluation.json_text(), encoding="utf-8")
        print(f"report: {figure_path}, {values_path}")
    return EXIT_DONE


def _print(summary: ReplaySummary) -> None:
    print(f"in:  {_counts(summary.inputs)}")
    print(f"out: {_counts(summary.outputs)}")
    for topic, reasons in sorted(summary.refused.items()):
        print(f"refused or noted: {topic}: {_counts(reasons)}")
    for topic, count in sorted(summary.undecodable.items()):
        print(f"not decodable: {topic}: {count}")
    if summary.absent:
        print(f"not in the bag: {', '.join(summary.absent)}")
    for problem in summary.problems:
        print(f"warning: {problem}")
    rate = summary.duration_s / summary.elapsed_s
    print(f"{summary.duration_s:.1f} s of data in {summary.elapsed_s:.1f} s ({rate:.0f} x real time)")


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "nothing"
