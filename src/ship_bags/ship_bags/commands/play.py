"""``play``: publishes a bag's messages live, with its time on /clock."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser
from ship_bags.live.play import Player, PlayOptions
from ship_bags.live.playback_clock import PlaybackClock, add_services, keyboard_control, serve_in_thread
from ship_bags.live.ros_process import call_on_end_signals, command_node, positive_number, run_ros_command
from ship_bags.topic_names import add_remap_option

_DESCRIPTION = """\
Publishes the messages of a bag live, byte for byte, at the times of its log, and that time every 10 ms on /clock.
Publishers are reliable; latched topics are latched again. It starts when every topic has a subscriber, or two seconds
after the last match if some topics have none, which it reports. It ends when every reliable subscriber has acknowledged
the last message, and cleanly on Ctrl-C. On a terminal: space pauses and resumes, s plays the next message while
paused, + doubles the rate and - halves it. Services of the node: ~/pause, ~/resume, ~/toggle_paused, ~/play_next
(std_srvs/Trigger).
ROS arguments may follow after --ros-args (namespace, remaps).
"""
_EPILOG = "exit code: 0 played; 1 a subscriber did not acknowledge messages; 2 bad input or usage"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``play``; returns the exit code."""
    return run_ros_command(_parser(), _play, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="play",
        example="bags/demo.mcap --rate 2",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, help="bag to play: .mcap file or rosbag2 folder")
    parser.add_argument(
        "--rate",
        type=positive_number,
        default=1.0,
        metavar="R",
        help="seconds of the bag per second (1); 1e9 is as fast as it goes",
    )
    parser.add_argument(
        "--loop", type=_count, default=1, metavar="N", help="play it N times, 0 without end (1)"
    )
    parser.add_argument(
        "--start-offset",
        type=_seconds,
        default=0.0,
        metavar="S",
        help="leave out the first S seconds of the bag (0)",
    )
    parser.add_argument("--paused", action="store_true", help="start paused")
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="play only these topics, named as in the bag"
    )
    add_remap_option(parser)
    parser.add_argument(
        "--wait-for-subscribers",
        nargs="+",
        type=_expectation,
        default=[],
        metavar="TOPIC[=COUNT]",
        help="start when these topics, named as played, have COUNT subscribers each (1), and fail if they do not; "
        "default: wait for one subscriber of every topic except truth, and play in any case after the timeout",
    )
    parser.add_argument(
        "--wait-timeout",
        type=_seconds,
        default=10.0,
        metavar="S",
        help="wait S seconds for subscribers (10)",
    )
    return parser


def _play(parsed: argparse.Namespace, ros_arguments: list[str]) -> int:
    options = PlayOptions(
        start_offset_s=parsed.start_offset,
        loop_count=parsed.loop,
        topics=tuple(parsed.topics),
        wait_for=dict(parsed.wait_for_subscribers),
        wait_timeout_s=parsed.wait_timeout,
    )
    clock = PlaybackClock(parsed.rate, parsed.paused)
    with command_node("play", ros_arguments) as node:
        player = Player(node, parsed.bag, options, clock)
        add_services(node, clock)
        call_on_end_signals(clock.stop)
        with serve_in_thread(node, clock, player.publish_clock), keyboard_control(clock):
            summary = player.run()
    print(f"play: {summary.message_count} messages, largest delay {summary.latest_s * 1e3:.1f} ms")
    if summary.unacknowledged:
        print(
            f"play: not acknowledged by every subscriber: {', '.join(summary.unacknowledged)}",
            file=sys.stderr,
        )
        return EXIT_BOUND_NOT_MET
    return EXIT_DONE


def _seconds(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value >= 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a time in seconds, zero or more")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is not a number of times, zero or more")
    return value


def _expectation(text: str) -> tuple[str, int]:
    topic, separator, count = text.partition("=")
    if not topic or (separator and not count.isdigit()):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form TOPIC or TOPIC=COUNT")
    return topic, int(count) if separator else 1


if __name__ == "__main__":
    raise SystemExit(main())
