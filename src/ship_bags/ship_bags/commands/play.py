"""``play``: publishes the messages of a bag live, byte for byte, and the bag's time on /clock."""

import argparse
import itertools
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser
from ship_bags.errors import BadInput
from ship_bags.live.installed_types import installed_class
from ship_bags.live.playback_clock import PlaybackClock, add_services, keyboard_control, serve_in_thread
from ship_bags.live.ros_process import call_on_end_signals, command_node, positive_number, run_ros_command
from ship_bags.mcap.bag_reader import Bag, BagRecord, read_bag, with_bag_progress
from ship_bags.stamps import NS_PER_S
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

CLOCK_PERIOD_NS = 10_000_000
"""Period of /clock in bag time, ns; /clock is behind the last message by at most this time."""

# Steady time for which /clock runs before the first message, so that every subscriber's clock is set (or has jumped
# back, in a loop) when the first message arrives.
_CLOCK_LEAD_S = 0.1
# Maximum lead in bag time: at a high rate the lead would be days of the bag and millions of /clock messages. Sending
# the /clock messages of one minute takes about _CLOCK_LEAD_S.
_LONGEST_LEAD_S = 60.0
# Maximum rate at which all ticks of /clock are sent. At a higher rate more than 100 000 ticks per second of steady time
# would be needed.
_FASTEST_WITH_ALL_TICKS = 1000.0
# Time without a new match after which no subscribers are expected for the topics that have none. Discovery on one
# computer takes 0.06 s to 1.6 s.
_SETTLING_TIME_S = 2.0
_POLL_S = 0.01
_ACKNOWLEDGE_S = 10.0
# A message that a reader missed must still exist when the reader requests it: this suffices for 1 kHz at the default
# heartbeat of Fast DDS (3 s).
_DEPTH = 5000

# Topics that the playing node itself publishes; recorded messages would contradict them.
_OWN_TOPICS = ("/clock", "/rosout", "/parameter_events")


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
    clock = PlaybackClock(parsed.rate, parsed.paused)
    with command_node("play", ros_arguments) as node:
        player = Player(node, parsed, clock)
        add_services(node, clock)
        call_on_end_signals(clock.stop)
        with serve_in_thread(node, clock, player.publish_clock), keyboard_control(clock):
            message_count, latest_s, unacknowledged = player.run()
    print(f"play: {message_count} messages, largest delay {latest_s * 1e3:.1f} ms")
    if unacknowledged:
        print(f"play: not acknowledged by every subscriber: {', '.join(unacknowledged)}", file=sys.stderr)
        return EXIT_BOUND_NOT_MET
    return EXIT_DONE


class Player:
    """Player of one bag, in the order and at the times of its log.

    Args:
        node: publishing node; the caller spins it.
        options: parsed arguments of the command.
        clock: bag time; other threads pause, step and stop it.

    Raises:
        BadInput: the bag cannot be read, a named topic is not in it, the start offset is past its end, or nothing in it
            can be played.
    """

    def __init__(self, node: Node, options: argparse.Namespace, clock: PlaybackClock) -> None:
        self._node, self._options, self._clock = node, options, clock
        self._clock_publisher = node.create_publisher(Clock, "/clock", _DEPTH)
        self.clock_ns = 0
        self._publishers: dict[str, Publisher] = {}
        with read_bag(options.bag) as bag:
            self.start_ns = bag.start_ns + round(options.start_offset * NS_PER_S)
            if self.start_ns > bag.end_ns:
                length_s = (bag.end_ns - bag.start_ns) / NS_PER_S
                raise BadInput(
                    f"a start offset of {options.start_offset} s is past its end at {length_s:.3f} s", file=options.bag
                )
            for topic, why in bag.skipped_topics.items():
                self._warn(f"topic '{topic}' is not played: {why}")
            self._create_publishers(bag)

    def run(self) -> tuple[int, float, list[str]]:
        """Wait for the subscribers, then play all loops, or until the clock is stopped.

        Returns:
            Number of messages, their largest delay, s, and the topics not fully acknowledged in the last complete loop.
        """
        self._wait_for_subscribers()
        message_count, latest_s = 0, 0.0
        problems: list[str] = []
        unacknowledged: list[str] = []
        laps = itertools.count() if self._options.loop == 0 else range(self._options.loop)
        for _ in laps:
            if self._clock.is_stopped:
                break
            with read_bag(self._options.bag) as bag:
                for record in self._timed_records(with_bag_progress(self._records_from_start(bag), bag)):
                    self._publishers[record.topic].publish(bytes(record.data))
                    message_count += 1
                    latest_s = max(latest_s, self._clock.behind_s(record.log_time_ns))
                problems = bag.problems
            # This wait also ensures that no message arrives after the clock has jumped back for the next loop.
            if not self._clock.is_stopped:
                unacknowledged = self._wait_for_acknowledgements()
        for problem in problems:
            self._warn(problem)
        return message_count, latest_s, unacknowledged

    def publish_clock(self) -> None:
        """Publish the time again, for subscribers that appear while the playback is paused."""
        if self.clock_ns:
            self._send_clock(self.clock_ns)

    def _records_from_start(self, bag: Bag) -> Iterator[BagRecord]:
        """Yield messages from the start on; before them the last earlier message of each latched topic."""
        earlier: dict[str, BagRecord] = {}
        for record in bag.records(self._publishers):
            if record.log_time_ns >= self.start_ns:
                yield from earlier.values()
                earlier.clear()
                yield record
            elif record.topic in bag.latched_topics:
                earlier[record.topic] = replace(record, log_time_ns=self.start_ns)

    def _timed_records(self, records: Iterable[BagRecord]) -> Iterator[BagRecord]:
        """Yield each record when it is due; publish /clock in between."""
        lead_s = min(_CLOCK_LEAD_S * self._clock.rate, _LONGEST_LEAD_S)
        lead_ns = max(CLOCK_PERIOD_NS, round(lead_s * NS_PER_S))
        self._clock.start_at(self.start_ns - lead_ns)
        started = False

        def stride() -> int:
            """Return n: every n-th tick between messages is sent, so that a high rate is possible; 0 counts as 1."""
            return round(self._clock.rate / _FASTEST_WITH_ALL_TICKS) if started else 1

        for time_ns, record in add_ticks(records, self.start_ns - lead_ns, stride):
            started = started or record is not None
            if not self._clock.wait_until(time_ns, is_message=record is not None):
                return
            if record is not None:
                yield record
            else:
                self._send_clock(time_ns)

    def _send_clock(self, time_ns: int) -> None:
        self.clock_ns = time_ns
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time_ns, NS_PER_S)
        self._clock_publisher.publish(message)

    def _wait_for_acknowledgements(self) -> list[str]:
        """Wait ``_ACKNOWLEDGE_S`` at most until every reliable subscriber has acknowledged; return the other topics."""
        deadline_s = time.monotonic() + _ACKNOWLEDGE_S
        return [
            topic
            for topic, publisher in {"/clock": self._clock_publisher, **self._publishers}.items()
            if not publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline_s - time.monotonic())))
        ]

    def _create_publishers(self, bag: Bag) -> None:
        in_bag = {topic: bag.recorded_names.get(topic, topic) for topic in bag.topics}
        for name in self._options.topics:
            if name not in in_bag.values():
                raise BadInput(
                    f"has no topic '{name}' to play; it has {', '.join(sorted(in_bag.values()))}",
                    file=bag.path,
                )
        for topic, type_name in bag.topics.items():
            if in_bag[topic] not in self._options.topics and (self._options.topics or topic in _OWN_TOPICS):
                continue
            try:
                kind = installed_class(type_name)
            except BadInput as problem:
                self._warn(f"topic '{topic}' is not played: {problem}")
                continue
            if bag.differences.get(type_name):
                # Subscribers would read the bytes by the installed definition.
                self._warn(f"topic '{topic}' is not played: {'; '.join(bag.differences[type_name])}")
                continue
            durability = (
                DurabilityPolicy.TRANSIENT_LOCAL if topic in bag.latched_topics else DurabilityPolicy.VOLATILE
            )
            qos = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
            self._publishers[topic] = self._node.create_publisher(kind, topic, qos)
        if not self._publishers:
            raise BadInput("none of its topics can be played", file=bag.path)

    def _wait_for_subscribers(self) -> None:
        """Return when every topic has its subscribers, or no more are expected.

        A topic has its subscribers when the requested number and every subscriber in the graph are matched. If no topic
        is requested by name, the number is one for each topic, but zero for /clock and truth topics. No more
        subscribers are expected after the timeout. If no topic is requested by name and at least one topic has
        subscribers, no more are expected either when _SETTLING_TIME_S have passed since the last match.

        Raises:
            BadInput: a topic requested by name is not played or has too few subscribers.
        """
        by_name = {p.topic_name: p for p in (self._clock_publisher, *self._publishers.values())}
        requested = {self._node.resolve_topic_name(name): n for name, n in self._options.wait_for_subscribers}
        for name in requested.keys() - by_name.keys():
            raise BadInput(f"topic '{name}' is not played, so there are no subscribers to wait for")
        wanted = requested or {name: 1 for name in by_name if name != "/clock" and "truth" not in name.split("/")}
        deadline_s = time.monotonic() + self._options.wait_timeout
        matches, settled_s = [0], deadline_s
        while missing := [
            name
            for name, p in by_name.items()
            if p.get_subscription_count() < max(wanted.get(name, 0), self._node.count_subscribers(name))
        ]:
            if self._clock.is_stopped:
                return
            counts = [p.get_subscription_count() for p in by_name.values()]
            if counts != matches:
                matches, settled_s = counts, time.monotonic() + _SETTLING_TIME_S
            unwanted = [name for name in missing if not by_name[name].get_subscription_count()]
            taken = any(name in wanted for name in by_name.keys() - set(unwanted))
            if not requested and taken and unwanted == missing and time.monotonic() >= settled_s:
                self._warn(f"no subscriber of {', '.join(sorted(unwanted))}; playing nevertheless")
                return
            if time.monotonic() >= deadline_s:
                names = ", ".join(sorted(missing))
                text = f"no match after {self._options.wait_timeout} s with the subscribers of {names}"
                if requested:
                    raise BadInput(text)
                self._warn(f"{text}; playing nevertheless")
                return
            time.sleep(_POLL_S)

    def _warn(self, line: str) -> None:
        self._node.get_logger().warning(line)


def add_ticks(
    records: Iterable[BagRecord], first_tick_ns: int, stride: Callable[[], int] = lambda: 1
) -> Iterator[tuple[int, BagRecord | None]]:
    """Yield records with their log times, and ticks (None) of /clock on a regular grid, in order of time.

    The tick before a record is less than a period older; one more tick follows the last record.

    Args:
        records: records of the bag.
        first_tick_ns: start of the grid.
        stride: returns n: between two records every n-th tick and the last tick are published.
    """
    tick_ns = first_tick_ns
    for record in records:
        while tick_ns <= record.log_time_ns:
            yield tick_ns, None
            steps_to_record = (record.log_time_ns - tick_ns) // CLOCK_PERIOD_NS
            tick_ns += CLOCK_PERIOD_NS * max(1, min(stride(), steps_to_record))
        yield record.log_time_ns, record
    yield tick_ns, None


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
