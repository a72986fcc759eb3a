"""``record``: records live topics into a crash-safe bag; recovers damaged bags."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_DONE, CommandParser
from ship_bags.errors import BadInput, one_line
from ship_bags.live.record import Recorder, RecordOptions
from ship_bags.live.ros_process import call_on_end_signals, command_node, positive_number, run_ros_command
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.mcap.recover import recover, recovered_path
from ship_bags.output_files import add_force_option, check_file
from ship_bags.suite_commit import COMMIT_RECORD, commit_record

_DESCRIPTION = """\
Records live topics into one MCAP file or a rosbag2 folder, byte for byte, with definitions and quality of service as
ros2 bag does. A crash loses one flush period at most. New topics are recorded as they appear; subscriptions adapt to
the publishers' QoS (reliable, latched). Log time is the node's clock at reception, publish time the publisher's. The
parameters of the nodes on the network are attached as suite.yaml, which replay uses. Ctrl-C or SIGTERM ends it. ROS
arguments may follow after --ros-args (namespace, use_sim_time, remaps).

With --recover it records nothing, but recovers each named bag: it writes every readable message to FILE.recovered.mcap
next to it (FOLDER.recovered for a folder), and reports the time range of damaged chunks. Two other readers read the
whole result back before it gets its name; the original is not changed.
"""
_EPILOG = "exit code: 0 recorded or recovered; 2 bad input or usage, or the disk failed"
_BYTES_PER_MB = 1_000_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``record`` and return the exit code."""
    parser = _parser()
    return run_ros_command(parser, lambda parsed, ros: _run(parser, parsed, ros), arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="record",
        example="--out voyage.mcap",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--out", type=Path, metavar="BAG", help="bag to write: BAG.mcap is one file, any other name a rosbag2 folder"
    )
    add_force_option(parser)
    parser.add_argument(
        "--recover", type=Path, nargs="+", metavar="FILE", help="recover damaged or unfinished bags"
    )
    parser.add_argument(
        "--split-mb", type=positive_number, metavar="MB", help="folder: a new file after MB megabytes (never)"
    )
    parser.add_argument(
        "--split-s", type=positive_number, metavar="S", help="folder: a new file after S seconds of real time (never)"
    )
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="only these (all except hidden topics and /clock)"
    )
    parser.add_argument(
        "--flush-period-s",
        type=positive_number,
        default=0.1,
        metavar="S",
        help="flush and fsync every S seconds (0.1)",
    )
    parser.add_argument("--duration-s", type=positive_number, metavar="S", help="end after S seconds (never)")
    parser.add_argument(
        "--until-idle-s",
        type=positive_number,
        metavar="S",
        help="end S seconds after the last measurement or valid result (never); messages that nodes publish without "
        "input (diagnostics, health, budgets, INVALID, /rosout) count only if no others are recorded",
    )
    parser.add_argument("--use-sim-time", action="store_true", help="take the log time from /clock")
    return parser


def _run(parser: CommandParser, parsed: argparse.Namespace, ros_arguments: list[str]) -> int:
    if parsed.recover:
        if parsed.out is not None and len(parsed.recover) > 1:
            parser.error("--out names one result, but --recover names several bags")
        return _recover(parsed.recover, parsed.out, parsed.force)
    if parsed.out is None:
        parser.error("the following arguments are required: --out")
    if parsed.out.suffix == ".mcap" and (parsed.split_mb or parsed.split_s):
        parser.error(f"--split-mb and --split-s need a folder: --out {parsed.out.with_suffix('')}")
    return _record(parsed, ros_arguments)


def _recover(sources: list[Path], target: Path | None, force: bool) -> int:
    """Recover each bag; a failure does not stop the others."""
    exit_code = EXIT_DONE
    for source in sources:
        try:
            recovery = recover(source, recovered_path(source) if target is None else target, force)
        except (BadInput, OSError) as problem:
            print(f"record: {one_line(str(problem))}", file=sys.stderr)
            exit_code = EXIT_BAD_INPUT
            continue
        for line in recovery.problems:
            print(f"record: {line}")
        print(
            f"record: {recovery.path}: {sum(recovery.counts.values())} messages on {len(recovery.counts)} topics, "
            "all read back by mcap and rosbags"
        )
    return exit_code


def _open_bag(parsed: argparse.Namespace) -> BagWriter | FolderWriter:
    if parsed.out.suffix == ".mcap":
        check_file(parsed.out, parsed.force)
        # A program that has opened the former file can continue to read this file.
        parsed.out.unlink(missing_ok=True)
        bag: BagWriter | FolderWriter = BagWriter(parsed.out, atomic=False)
    else:
        size_bytes = None if parsed.split_mb is None else round(parsed.split_mb * _BYTES_PER_MB)
        bag = FolderWriter(parsed.out, SplitLimits(size_bytes, parsed.split_s))
    if commit := commit_record():
        bag.add_metadata(COMMIT_RECORD, commit)
    return bag


def _record(parsed: argparse.Namespace, ros_arguments: list[str]) -> int:
    options = RecordOptions(
        topics=tuple(parsed.topics),
        flush_period_s=parsed.flush_period_s,
        duration_s=parsed.duration_s,
        until_idle_s=parsed.until_idle_s,
    )
    with command_node("record", ros_arguments, parsed.use_sim_time) as node:
        bag = _open_bag(parsed)
        recorder = Recorder(node, bag, options)
        call_on_end_signals(recorder.stop)
        print(f"record: recording to {parsed.out}", flush=True)
        recorder.run()
    for name in sorted(recorder.unanswered):
        print(f"record: {name} did not report its parameters: they are not in the recording")
    for topic in sorted(recorder.counts):
        lost = f", {recorder.lost[topic]} lost on the way" if recorder.lost[topic] else ""
        print(f"record: {topic}: {recorder.counts[topic]} messages{lost}")
    print(f"record: {sum(recorder.counts.values())} messages in {parsed.out}")
    return EXIT_DONE


if __name__ == "__main__":
    raise SystemExit(main())
