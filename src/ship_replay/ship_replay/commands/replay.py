"""``replay``: offline replay of a bag through the adapters of the suite's nodes, or of a black box as recorded."""

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag, with_bag_progress
from ship_bags.output_files import add_force_option, check_file, check_folder, write_atomically
from ship_bags.topic_names import add_bag_name_options
from ship_replay.offline.replay import ADAPTERS, replay
from ship_replay.offline.replay_summary import ReplaySummary
from ship_replay.verification.black_box_identity import is_black_box
from ship_replay.verification.black_box_replay import replay_black_box
from ship_replay.verification.verification import Verification, verify_bag

_with_progress = partial(with_bag_progress, doing="replaying")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="replay",
        example="bags/demo.mcap --out out.mcap --report report",
        epilog="exit code: 0 replayed, with --verify: and all numbers equal to the last bit; 1 --verify found another "
        "number or could not compare all; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description=f"Replay a bag through the nodes that the configuration has sections for "
        f"({', '.join(adapter.node_name for adapter in ADAPTERS)}; outputs are inputs of the nodes after them), in "
        "process and as fast as possible; the same bag and configuration give the same output. Topics truth/* are "
        "copied. A node's black box is replayed with its ticks, parameter changes, service calls and files, in the "
        "order of use.",
    )
    parser.add_argument("bag", type=Path, metavar="IN.mcap", help=".mcap file or rosbag2 folder, or a black box")
    parser.add_argument("--out", type=Path, metavar="OUT.mcap", help="bag to write; optional with --verify")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    add_bag_name_options(parser)
    parser.add_argument(
        "--arrival",
        choices=("log", "stamps"),
        default="log",
        help="arrival time of a message: its log time (default), or its stamp, for a bag whose recorder stalled",
    )
    parser.add_argument(
        "--one-by-one",
        action="store_true",
        help="process each message by itself, as a live node does; by default messages are processed in blocks where "
        "possible, with the same output in less time",
    )
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="folder for OUT.html, as report writes it, and "
        "OUT.json with the numbers of evaluate"
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="compare with the outputs in IN.mcap, except diagnostics and health; prints the first difference: topic, "
        "stamp (UTC and ns), field, both values (SI units, rad). Equality is guaranteed for a black box, with the "
        "version of the suite and on the kind of machine that wrote it",
    )
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.out is None and (not options.verify or options.report is not None):
        raise BadInput("--out is missing: it is optional only with --verify and without --report")
    by_stamps = options.arrival == "stamps"
    if by_stamps and options.verify:
        raise BadInput("--arrival stamps and --verify contradict each other: recorded outputs follow log time")
    if options.out is not None and options.out.resolve() == options.bag.resolve():
        raise BadInput("the output would overwrite the input", file=options.out)
    if options.out is not None:
        check_file(options.out, options.force)
    if options.report is not None:
        check_folder(options.report, _report_names(options), options.force)
    with read_bag(options.bag) as bag:
        verification = None
        is_box = is_black_box(bag)
        if is_box and by_stamps:
            raise BadInput("a black box has its own order of arrival: omit --arrival stamps", file=options.bag)
        if is_box:
            verification = replay_black_box(bag, ADAPTERS, options.config, options.out, _with_progress)
        elif options.verify:
            verification = verify_bag(bag, ADAPTERS, options.config, options.namespace, _with_progress)
    if options.out is not None and not is_box:
        arrival = by_stamps, options.one_by_one
        _print_summary(
            replay(options.bag, options.out, ADAPTERS, options.config, options.namespace, _with_progress, *arrival)
        )
    if options.report is not None:
        _report(options)
    return EXIT_DONE if verification is None else _print_verification(verification, options.verify)


def _report_names(options: argparse.Namespace) -> tuple[str, str]:
    """Return the file names of a report: page and values."""
    return f"{options.out.stem}.html", f"{options.out.stem}.json"


def _report(options: argparse.Namespace) -> None:
    # Importing the figure libraries is slow.
    from ship_replay.report.page import page
    from ship_replay.report.recording import has_truth, read_report_data

    # Only the input bag contains sensor data; if it contains a truth, the report evaluates these data too.
    truth = options.bag if has_truth(options.bag, options.namespace) else None
    report_data = read_report_data(options.out, truth, namespace=options.namespace)
    options.report.mkdir(parents=True, exist_ok=True)
    page_path, values_path = (options.report / name for name in _report_names(options))
    write_atomically(page_path, page(report_data))
    write_atomically(values_path, report_data.evaluation.json_text())
    print(f"report: {page_path}, {values_path}")


def _print_summary(summary: ReplaySummary) -> None:
    print(f"in:  {_counts(summary.inputs)}")
    print(f"out: {_counts(summary.outputs)}")
    for topic, reasons in sorted(summary.rejected.items()):
        print(f"rejected: {topic}: {_counts(reasons)}")
    for topic, reasons in sorted(summary.accepted_with_note.items()):
        print(f"noted: {topic}: {_counts(reasons)}")
    for topic, count in sorted(summary.undecodable.items()):
        print(f"not decodable: {topic}: {count}")
    if summary.absent:
        print(f"not in the bag: {', '.join(summary.absent)}")
    for problem in summary.problems:
        print(f"warning: {problem}")
    irregularity = summary.log_delays.irregularity_text()
    if irregularity:
        print(f"warning: {irregularity}; --arrival stamps uses the stamps as arrival times")
    rate = summary.duration_s / summary.elapsed_s
    print(f"{summary.duration_s:.1f} s of data in {summary.elapsed_s:.1f} s ({rate:.0f} x real time)")
    for line in [*summary.status_lines(), *summary.reasons]:
        print(line)


def _print_verification(verification: Verification, is_requested: bool) -> int:
    """Print the result of a comparison and return the exit code, which depends on the result only with --verify."""
    print(f"used:  {_counts(verification.input_counts)}")
    print(f"equal: {_counts(verification.equal_counts)}")
    for note in verification.notes:
        print(f"note: {note}")
    if verification.incomplete_reason:
        print(f"verified up to this point: {verification.incomplete_reason}")
    if verification.text_difference is not None:
        print(f"other texts: {_counts(verification.other_texts)}; the first: {verification.text_difference.line}")
    if verification.difference is not None:
        print(f"first difference: {verification.difference.line}")
    elif verification.is_verified:
        numbers = "the numbers of " if verification.other_texts else ""
        print(f"verified: {numbers}{verification.equal_counts.total()} outputs are equal to the last bit")
    return EXIT_DONE if verification.is_verified or not is_requested else EXIT_BOUND_NOT_MET


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "none"
