"""``record``: live topics go into a crash-safe MCAP file."""

import argparse
import math
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from ship_replay.command_line import EXIT_DONE, CommandParser, run_command
from ship_replay.errors import BadInput
from ship_replay.record import Recorder, RecordOptions
from ship_replay.ros_arguments import split_ros_arguments

_DESCRIPTION = """\
Records live topics into one MCAP file, byte for byte, with definitions and quality of service as ros2 bag does.
A crash costs one flush period at most. New topics are taken as they appear; subscriptions follow what publishers offer
(reliable, latched). Log time is the node's clock at receipt, publish time the publisher's. Ctrl-C or SIGTERM ends it.
ROS arguments may follow after --ros-args (namespace, use_sim_time, remaps).
"""
_EPILOG = "exit code: 0 recorded; 2 bad input or usage, or the disk failed"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``record``; returns the exit code."""
    command_line = sys.argv[1:] if arguments is None else list(arguments)
    own, ros = split_ros_arguments(command_line)
    return run_command(_parser(), lambda parsed: _record(parsed, ros), own)


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="record",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="BAG.mcap", help="file to write")
    parser.add_argument("--overwrite", action="store_true", help="write over a file that is there")
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="only these (all but hidden ones and /clock)"
    )
    parser.add_argument(
        "--flush-period-s",
        type=_positive,
        default=0.1,
        metavar="S",
        help="flush and fsync every S seconds (0.1)",
    )
    parser.add_argument("--duration-s", type=_positive, metavar="S", help="end after S seconds (never)")
    parser.add_argument(
        "--until-idle-s", type=_positive, metavar="S", help="end S seconds after the last message (never)"
    )
    parser.add_argument("--use-sim-time", action="store_true", help="log time is that of /clock")
    return parser


def _record(parsed: argparse.Namespace, ros_arguments: list[str]) -> int:
    if parsed.out.exists() and not parsed.overwrite:
        raise BadInput(f"{parsed.out}: is there already: --overwrite, or another name")
    options = RecordOptions(
        topics=tuple(parsed.topics),
        flush_period_s=parsed.flush_period_s,
        duration_s=parsed.duration_s,
        until_idle_s=parsed.until_idle_s,
    )
    rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        overrides = [Parameter("use_sim_time", value=True)] if parsed.use_sim_time else []
        node = rclpy.create_node("record", parameter_overrides=overrides)
        recorder = Recorder(node, parsed.out, options)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: recorder.stop())
        print(f"record: recording to {parsed.out}", flush=True)
        recorder.run()
    finally:
        rclpy.try_shutdown()
    for topic in sorted(recorder.counts):
        lost = f", {recorder.lost[topic]} lost on the way" if recorder.lost[topic] else ""
        print(f"record: {topic}: {recorder.counts[topic]} messages{lost}")
    print(f"record: {sum(recorder.counts.values())} messages in {parsed.out}")
    return EXIT_DONE


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


if __name__ == "__main__":
    raise SystemExit(main())
