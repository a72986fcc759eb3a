"""``record``: records live topics into a crash-safe bag; recovers damaged bags.

Messages are recorded unchanged, and flushed in short periods.
"""

import argparse
import sys
import time
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_DONE, CommandParser
from ship_bags.errors import BadInput, one_line
from ship_bags.live.installed_types import installed_class
from ship_bags.live.recorded_graph import (
    DEPTH,
    STATUS_TYPES,
    ParameterCollector,
    adapted_qos,
    is_activity,
    offered_topics,
    qos_texts,
)
from ship_bags.live.ros_process import call_on_end_signals, command_node, positive_number, run_ros_command
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.mcap.recover import recover, recovered_path
from ship_bags.message_store import use_installed_definition
from ship_bags.output_files import add_force_option, check_file
from ship_bags.provenance import COMMIT_RECORD, commit_record
from ship_bags.stamps import NS_PER_S, utc_text

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

_DISCOVERY_PERIOD_S = 0.1
# Maximum times at the end for messages that had arrived before, and for answers about parameters.
_DRAIN_S = 1.0
_PARAMETER_WAIT_S = 1.0
# A flush begins after this ratio of its period, so that it is finished within the period.
_FLUSH_SHARE = 0.7
# Maximum number of messages kept before the first /clock; above it the oldest are lost.
_MAX_BEFORE_CLOCK = 50_000
# Minimum clock step that is recorded. A slewed clock (at most 500 ppm) changes by less between two readings, and a
# smaller step disturbs no filter.
MIN_STEP_NS = 50_000_000
# Maximum time between the readings of both clocks for a valid comparison.
_MAX_READING_NS = 5_000_000


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
    with command_node("record", ros_arguments, parsed.use_sim_time) as node:
        bag = _open_bag(parsed)
        recorder = Recorder(node, bag, parsed)
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


class Recorder:
    """Recorder of the topics in a node's graph.

    The log time is the node's time at reception (bag time with ``use_sim_time``); the publish time is the publisher's.
    The idle time runs since the last message that shows activity (:func:`is_activity`), or since the last message of
    any kind if only status reports are recorded. Times of the options are steady.

    Args:
        node: subscribing node; :meth:`run` spins it.
        bag: crash-safe writer; :meth:`run` closes it.
        options: parsed arguments of the command.

    Attributes:
        counts: topic → number of messages recorded.
        lost: topic → number of messages lost on the way, or dropped because too many waited for the first /clock.
    """

    def __init__(self, node: Node, bag: BagWriter | FolderWriter, options: argparse.Namespace) -> None:
        self.counts: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self._node, self._bag, self._options = node, bag, options
        self._stopped = False
        self._known: set[str] = set()
        self._has_only_status = True
        self._before_clock: deque[tuple[str, str, bytes, int]] = deque()
        self._last_activity_s: float | None = None
        self._last_log_ns = 0
        self._is_simulated_time = bool(node.get_parameter("use_sim_time").value)
        self._step_detector = ClockStepDetector()
        self._step_count = 0
        self._parameters = ParameterCollector(node, lambda text: bag.add_attachment(SUITE_ATTACHMENT, text))

    @property
    def unanswered(self) -> list[str]:
        """Nodes that did not report their parameters."""
        return self._parameters.unanswered

    def stop(self) -> None:
        """End soon; for signal handlers."""
        self._stopped = True

    def run(self) -> None:
        """Record until the end, then finish the file.

        Raises:
            BadInput: the disk is full or fails; the file is complete up to the last flush.
        """
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        try:
            self._spin(executor)
            self._bag.close()
        except OSError as problem:
            self._bag.truncate()
            raise BadInput(
                f"recording failed: {problem.strerror}; the file is complete up to the last flush, "
                f"{self._bag.flushed_bytes} bytes: use record --recover to finish it",
                file=self._bag.path,
            ) from problem
        finally:
            executor.shutdown()

    def _spin(self, executor: SingleThreadedExecutor) -> None:
        start_s = time.monotonic()
        next_flush_s = next_discovery_s = start_s
        while not self._stopped and not self._is_over(start_s, executor):
            now_s = time.monotonic()
            if now_s >= next_discovery_s:
                self._discover()
                self._parameters.update()
                next_discovery_s = now_s + _DISCOVERY_PERIOD_S
            if now_s >= next_flush_s:
                self._check_clock()
                self._bag.flush()
                # If a flush takes longer than its period, as much time must be left for reception.
                spent_s = time.monotonic() - now_s
                next_flush_s = now_s + max(_FLUSH_SHARE * self._options.flush_period_s, 2.0 * spent_s)
            executor.spin_once(timeout_sec=max(0.0, min(next_discovery_s, next_flush_s) - now_s))
        self._drain(executor)
        self._wait_for_parameters(executor)
        if self._before_clock:
            self._warn(f"no /clock received: {len(self._before_clock)} messages get their publishers' time")
            for topic, type_name, data, sent_ns in self._before_clock:
                self._bag.write_raw(topic, type_name, data, sent_ns, sent_ns)

    def _is_over(self, start_s: float, executor: SingleThreadedExecutor) -> bool:
        duration_s: float | None = self._options.duration_s
        if duration_s is not None and time.monotonic() - start_s >= duration_s:
            return True
        if self._is_idle():
            # A slow disk must not look like a timeout: process the messages received meanwhile first.
            self._drain(executor)
        return self._is_idle()

    def _is_idle(self) -> bool:
        idle_s: float | None = self._options.until_idle_s
        last_s = self._last_activity_s
        return idle_s is not None and last_s is not None and time.monotonic() - last_s >= idle_s

    def _drain(self, executor: SingleThreadedExecutor) -> None:
        """Process the messages that had arrived before the end."""
        deadline_s = time.monotonic() + _DRAIN_S
        before = -1
        while before != sum(self.counts.values()) and time.monotonic() < deadline_s:
            before = sum(self.counts.values())
            for _ in range(2 * len(self._known) + 1):
                executor.spin_once(timeout_sec=0.0)

    def _wait_for_parameters(self, executor: SingleThreadedExecutor) -> None:
        """Wait at most _PARAMETER_WAIT_S for the parameters that were requested from nodes."""
        deadline_s = time.monotonic() + _PARAMETER_WAIT_S
        while self._parameters.is_pending and time.monotonic() < deadline_s:
            executor.spin_once(timeout_sec=_DISCOVERY_PERIOD_S)
            self._parameters.update()
        self._parameters.close()

    def _discover(self) -> None:
        for topic, endpoints in offered_topics(self._node, self._options.topics).items():
            if topic not in self._known:
                self._known.add(topic)
                self._subscribe(topic, endpoints[0].topic_type, adapted_qos(endpoints), qos_texts(endpoints))

    def _subscribe(self, topic: str, type_name: str, qos: QoSProfile, qos_profiles: str) -> None:
        latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        try:
            kind = installed_class(type_name)
            use_installed_definition(type_name)
        except BadInput as problem:
            self._warn(f"topic '{topic}' is not recorded: {problem}")
            return
        self._bag.add_topic(topic, type_name, latched, qos_profiles)
        if self._has_only_status and type_name not in STATUS_TYPES:
            # Status reports do not count as activity from now on, and earlier status reports do not count either.
            self._has_only_status, self._last_activity_s = False, None
        events = SubscriptionEventCallbacks(
            message_lost=lambda info: self.lost.update({topic: info.total_count_change})
        )

        def take_all(data: bytes, info: dict[str, int]) -> None:
            # The executor checks every entity of the node for each message. Taking the rest of the queue here allows
            # ten times the rate, and keeps the log time near the reception.
            taken: tuple[bytes, dict[str, int]] | None = (data, info)
            count = 0
            while taken is not None and count < DEPTH:
                if self._options.until_idle_s is not None and (
                    self._has_only_status or is_activity(type_name, kind, taken[0])
                ):
                    self._last_activity_s = time.monotonic()
                self._receive(topic, type_name, *taken)
                count += 1
                with subscription.handle:
                    taken = subscription.handle.take_message(kind, True)

        subscription = self._node.create_subscription(kind, topic, take_all, qos, raw=True, event_callbacks=events)

    def _receive(self, topic: str, type_name: str, data: bytes, info: dict[str, int]) -> None:
        self.counts[topic] += 1
        now_ns = self._node.get_clock().now().nanoseconds
        if now_ns == 0:
            # With use_sim_time there is no time before the first /clock: messages wait for it and get its time.
            if len(self._before_clock) == _MAX_BEFORE_CLOCK:
                oldest = self._before_clock.popleft()[0]
                self.counts[oldest] -= 1
                self.lost[oldest] += 1
            self._before_clock.append((topic, type_name, data, info["source_timestamp"]))
            return
        if self._is_simulated_time and now_ns < self._last_log_ns:
            self._record_step("/clock", now_ns - self._last_log_ns, now_ns)
        self._last_log_ns = now_ns
        self._write_pending(now_ns)
        self._bag.write_raw(topic, type_name, data, now_ns, info["source_timestamp"])

    def _write_pending(self, now_ns: int) -> None:
        for topic, type_name, data, sent_ns in self._before_clock:
            self._bag.write_raw(topic, type_name, data, now_ns, sent_ns)
        self._before_clock.clear()

    def _check_clock(self) -> None:
        before_ns, clock_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        step_ns = self._step_detector.detect_step(before_ns, clock_ns, after_ns)
        if step_ns is not None:
            self._record_step("the system clock", step_ns, clock_ns)

    def _record_step(self, clock: str, step_ns: int, now_ns: int) -> None:
        """Log a clock step and record it in the bag; later times are by the new clock."""
        self._step_count += 1
        self._warn(f"{clock} stepped by {step_ns / NS_PER_S:+.3f} s to {utc_text(now_ns)}; recording goes on")
        entries = {"clock": clock, "step_ns": str(step_ns), "to_ns": str(now_ns)}
        self._bag.add_metadata(f"clock_step_{self._step_count}", entries)

    def _warn(self, line: str) -> None:
        self._node.get_logger().warning(line)


class ClockStepDetector:
    """Detector of steps of the system clock against the steady clock.

    A clock steps when it is set by hand, by NTP after a long outage, or to the time of a bag.
    """

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def detect_step(self, steady_before_ns: int, clock_ns: int, steady_after_ns: int) -> int | None:
        """Return the step of the clock since the last call, ns; None if there was no step.

        Args:
            steady_before_ns: steady clock read before the system clock.
            clock_ns: system clock.
            steady_after_ns: steady clock read after the system clock; readings with a long pause in between are not
                used.
        """
        if steady_after_ns - steady_before_ns > _MAX_READING_NS:
            return None
        offset_ns = clock_ns - steady_before_ns
        step_ns = 0 if self._offset_ns is None else offset_ns - self._offset_ns
        self._offset_ns = offset_ns
        return step_ns if abs(step_ns) > MIN_STEP_NS else None


if __name__ == "__main__":
    raise SystemExit(main())
