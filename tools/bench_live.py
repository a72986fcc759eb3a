"""Cost of the live node relative to a bare relay of the same messages: round-trip time, processor time, lost messages.

This program publishes Imu messages and receives responses: from the node its ``ship/imu``, from the relay the forwarded
messages. The cost of the relay is the minimum cost of any node. All programs share one ROS domain, which no other
program uses, and the suite's DDS profile.
"""

import math
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from bench_rows import WITH_INTEGRITY, Row, alternate, median_ratio, process_cpu_s
from ship_bags.live.ros_process import executable, use_dds_profile
from ship_bags.stamps import NS_PER_S, stamp_fields
from ship_testing.trials.live_process import LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import LiveFailure

SUITE = Path(__file__).resolve().parents[1] / "examples" / "theodolite.yaml"
"""Parameters of the node, for a ship with two star sensors, whose messages are absent here."""

ROUNDS = 4
USUAL_HZ, USUAL_S = 100.0, 5.0
FAST_HZ, FAST_S = 1000.0, 4.0
MOST_MEDIAN, MOST_99, MOST_CPU, MOST_FAST_CPU = (most * WITH_INTEGRITY for most in (1.5, 1.6, 1.5, 1.5))

_DEPTH = 2000
_START_S, _DRAIN_S, _LOOK_S = 30.0, 3.0, 0.02
_SWELL_RAD, _SWELL_PER_S = math.radians(4.0), 2.0 * math.pi / 11.0
_STAMP_AT = 4
"""Byte of a message at which its stamp begins."""

_BARE = "a bare relay"
_BARE_PROGRAM = f"""
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu
rclpy.init()
node = rclpy.create_node("relay")
publisher = node.create_publisher(Imu, "relay/out", QoSProfile(depth={_DEPTH}))
subscription = node.create_subscription(Imu, "relay/in", publisher.publish, QoSProfile(depth={_DEPTH}))
rclpy.spin(node)
"""


class RoundTripResult(NamedTuple):
    """Result of some messages: round-trip times, us, number of lost messages, and the program's processor time, s."""

    times_us: list[float]
    lost_count: int
    cpu_s: float

    @property
    def median_us(self) -> float:
        """Return the median of the round-trip times, us."""
        return float(np.median(self.times_us))

    @property
    def percentile_99_us(self) -> float:
        """Return the time that one message in a hundred exceeds, us."""
        return float(np.quantile(self.times_us, 0.99))


def live_cost() -> list[Row]:
    """Measure the node and the relay alternately, at the rate of an INS and at ten times that rate."""
    use_dds_profile()
    with tempfile.TemporaryDirectory() as folder, _Ends(Path(folder)) as ends:
        node = _RoundTrips(ends, "ins/imu", "ship/imu", ends.start(_node_command(), "ship_attitude"))
        bare = _RoundTrips(ends, "relay/in", "relay/out", ends.start([sys.executable, "-c", _BARE_PROGRAM], "relay"))
        for trips in (node, bare):
            trips.run(USUAL_HZ, 1.0)
        usual = alternate(ROUNDS, lambda: node.run(USUAL_HZ, USUAL_S), lambda: bare.run(USUAL_HZ, USUAL_S))
        fast = alternate(ROUNDS, lambda: node.run(FAST_HZ, FAST_S), lambda: bare.run(FAST_HZ, FAST_S))
    return [*_usual_rows(*usual), *_fast_rows(*fast)]


def _node_command() -> list[str]:
    arguments = ["--ros-args", "--params-file", str(SUITE), "-p", "reliable_inputs:=true"]
    return [*executable("ship_attitude_star", "ship_attitude"), *arguments]


def _usual_rows(node: list[RoundTripResult], bare: list[RoundTripResult]) -> list[Row]:
    there_and_back = f"Imu there and back at {USUAL_HZ:g} Hz"
    medians = [one.median_us for one in node], [one.median_us for one in bare]
    most = [one.percentile_99_us for one in node], [one.percentile_99_us for one in bare]
    cpu = [one.cpu_s for one in node], [one.cpu_s for one in bare]
    return [
        Row(f"{there_and_back} by {_BARE}: median", float(np.median(medians[1])), "us"),
        Row(f"{there_and_back} by ship_attitude: median", float(np.median(medians[0])), "us"),
        Row("ratio: ship_attitude / relay, median", median_ratio(*medians), "x", MOST_MEDIAN, _BARE),
        Row("ratio: ship_attitude / relay, 99 %", median_ratio(*most), "x", MOST_99, _BARE),
        Row(f"{_BARE} at {USUAL_HZ:g} Hz, of a core: median", _core_share(cpu[1], USUAL_S), "%"),
        Row("ratio: ship_attitude / relay, processor time", median_ratio(*cpu), "x", MOST_CPU, _BARE),
    ]


def _fast_rows(node: list[RoundTripResult], bare: list[RoundTripResult]) -> list[Row]:
    cpu = [one.cpu_s for one in node], [one.cpu_s for one in bare]
    lost = sum(one.lost_count for one in node)
    sent = lost + sum(len(one.times_us) for one in node)
    what = f"ratio: ship_attitude / relay at {FAST_HZ:g} Hz, processor time"
    return [
        Row(f"lost at {FAST_HZ:g} Hz by ship_attitude, reliable, of {sent}", lost, "messages", 0),
        Row(f"lost at {FAST_HZ:g} Hz by {_BARE}", sum(one.lost_count for one in bare), "messages"),
        Row(f"{_BARE} at {FAST_HZ:g} Hz, of a core: median", _core_share(cpu[1], FAST_S), "%"),
        Row(what, median_ratio(*cpu), "x", MOST_FAST_CPU, _BARE),
    ]


def _core_share(cpu_s: list[float], duration_s: float) -> float:
    return float(np.median(cpu_s)) / duration_s * 100.0


class _Ends:
    """ROS node of this program, and the programs under test; for a ``with`` statement.

    Args:
        folder: folder of the logs.
    """

    def __init__(self, folder: Path) -> None:
        domain_id = free_domain_id()
        self._folder = folder
        self._environment = live_environment(domain_id, folder / "ros")
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = rclpy.create_node("bench", context=self._context)
        self._running = ExitStack()

    def start(self, command: list[str], name: str) -> LiveProcess:
        """Start a program."""
        process = LiveProcess(command, self._folder / f"{name}.log", self._environment)
        return self._running.enter_context(process)

    def executor(self) -> EventsExecutor:
        """Return the executor of the node's callbacks."""
        executor = EventsExecutor(context=self._context)
        executor.add_node(self.node)
        return executor

    def __enter__(self) -> "_Ends":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._running.close()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


class _RoundTrips:
    """Messages to a program and its responses.

    Args:
        ends: node of this program.
        there: topic to which the program subscribes.
        back: topic of the program's responses, each with the stamp of the received message.
        process: the program under test.
    """

    def __init__(self, ends: _Ends, there: str, back: str, process: LiveProcess) -> None:
        self._ends, self._process = ends, process
        self._publisher = ends.node.create_publisher(Imu, there, QoSProfile(depth=_DEPTH))
        self._subscription = ends.node.create_subscription(Imu, back, self._receive, QoSProfile(depth=_DEPTH), raw=True)
        self._message = Imu()
        self._message.header.frame_id = "ins"
        self._sent: dict[bytes, int] = {}
        self._times_us: list[float] = []
        deadline_s = time.monotonic() + _START_S
        while not (self._publisher.get_subscription_count() and ends.node.count_publishers(back)):
            if process.exit_code is not None or time.monotonic() > deadline_s:
                raise LiveFailure(f"{there}: no subscriber; the log of the program:\n{process.log_text()}")
            time.sleep(_LOOK_S)

    def run(self, rate_hz: float, duration_s: float) -> RoundTripResult:
        """Publish for some time, then wait for the messages still in transit."""
        self._sent, self._times_us = {}, []
        executor, before_s = self._ends.executor(), process_cpu_s(self._process.pid)
        count, begin_s = round(rate_hz * duration_s), time.monotonic()
        for number in range(count):
            due_s = begin_s + number / rate_hz
            while (left_s := due_s - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left_s)
            self._send()
        drained_s = time.monotonic() + _DRAIN_S
        while self._sent and time.monotonic() < drained_s:
            executor.spin_once(timeout_sec=_LOOK_S)
        executor.remove_node(self._ends.node)
        executor.shutdown()
        return RoundTripResult(self._times_us, len(self._sent), process_cpu_s(self._process.pid) - before_s)

    def _send(self) -> None:
        """Publish the attitude of a ship that rolls in a swell."""
        message, time_ns = self._message, time.time_ns()
        phase = _SWELL_PER_S * (time_ns / NS_PER_S)
        roll = _SWELL_RAD * math.sin(phase)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp = stamp_fields(time_ns)
        message.orientation.x, message.orientation.w = math.sin(0.5 * roll), math.cos(0.5 * roll)
        message.angular_velocity.x = _SWELL_RAD * _SWELL_PER_S * math.cos(phase)
        self._sent[_stamp_bytes(*stamp)] = time.perf_counter_ns()
        self._publisher.publish(message)

    def _receive(self, data: bytes) -> None:
        now_ns = time.perf_counter_ns()
        sent_ns = self._sent.pop(data[_STAMP_AT : _STAMP_AT + 8], None)
        if sent_ns is not None:
            self._times_us.append((now_ns - sent_ns) * 1e-3)


def _stamp_bytes(second: int, nanosecond: int) -> bytes:
    """Return a stamp as it is encoded in a message."""
    return second.to_bytes(4, "little") + nanosecond.to_bytes(4, "little")
