"""Kill of a recorder or of a node with a black box, by SIGKILL at a random time, and the data left on the disk."""

import os
import random
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader
from rclpy.qos import QoSProfile
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import Imu

from ship_bags.errors import BadInput
from ship_bags.live.ros_process import executable, use_dds_profile
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.recover import recover, recovered_path
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_msgs.msg import ShipAttitude
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import LiveFailure

RATE_HZ = 200.0
_TOPIC = "ins/imu"
_ATTITUDE_TOPIC = "ship/attitude"
_EARLIEST_S = 0.3
_LATEST_S = 2.5
_START_S = 30.0
_WARM_UP_S = 0.1
_SUITE = "/**/ship_attitude: {ros__parameters: {ins: {frame_id: ins}}}\n"


@dataclass(frozen=True)
class KillTrial:
    """Result of one kill.

    A recorder must keep the samples sent to it. A node must keep the attitudes that it published, with the samples from
    which these were computed. Samples still in the node's queue need not be kept.

    Attributes:
        sent_count: number of messages before the kill that must be kept.
        kept_count: number of these messages on the disk.
        lost_s: time from the first message that is not on the disk to the last message; 0 if all are on the disk. A
            pause of the node before the kill does not count: the middleware may block the node for hundreds of
            milliseconds when a subscriber joins.
        has_gap: True if a message is missing before one that is on the disk.
        recovered_count: number of messages of all topics that ``rosbags`` reads from the recovered file.
        readable_counts: numbers of messages of all topics that ``read_bag`` reads from the killed file, and that the
            seeking ``mcap`` reader reads from the recovered file.
    """

    sent_count: int
    kept_count: int
    lost_s: float
    has_gap: bool
    recovered_count: int
    readable_counts: tuple[int, int]

    def is_within_flush_period(self, flush_period_s: float) -> bool:
        """True if at most a flush period at the end is lost and both readers can read everything left."""
        whole = set(self.readable_counts) == {self.recovered_count} and self.recovered_count > 0
        return whole and not self.has_gap and self.lost_s <= flush_period_s


def kill_recorder(folder: Path, seed: int, flush_period_s: float) -> KillTrial:
    """Kill the recorder ``record``; return the result.

    Args:
        folder: folder for logs and bags.
        seed: seed of the time of the kill.
        flush_period_s: flush period of the recorder.
    """
    path = folder / f"record_{seed}.mcap"
    options = ["--topics", _TOPIC, "--flush-period-s", str(flush_period_s)]
    command = [*executable("ship_bags", "record"), "--out", str(path), *options]
    return _trial(command, folder, path, seed, None)


def kill_node(folder: Path, seed: int) -> KillTrial:
    """Kill the ship-attitude node while it writes its black box; return the result."""
    path = folder / f"box_{seed}.mcap"
    suite = folder / "suite.yaml"
    suite.write_text(_SUITE, encoding="utf-8")
    # With reliable transport, a message missing on the disk was lost by the black box.
    reliable = ["-p", f"qos_overrides./{_TOPIC}.subscription.reliability:=reliable"]
    arguments = ["--ros-args", "--params-file", str(suite), "-p", f"black_box:={path}", *reliable]
    return _trial([*executable("ship_attitude_star", "ship_attitude"), *arguments], folder, path, seed, _ATTITUDE_TOPIC)


def _trial(command: Sequence[str], folder: Path, path: Path, seed: int, output_topic: str | None) -> KillTrial:
    killed_after_s = random.Random(seed).uniform(_EARLIEST_S, _LATEST_S)
    # A packet lost on the way would delay later packets for seconds, which is not an effect of the disk.
    use_dds_profile()
    domain_id = free_domain_id()
    environment = live_environment(domain_id, folder / "ros")
    with (
        GraphObserver(domain_id) as graph,
        LiveProcess(command, path.with_suffix(".log"), environment) as process,
    ):
        sender = _Sender(graph, output_topic)
        _wait_for_disk(sender, path, process)
        sender.send(killed_after_s)
        shared_memory = _shared_memory(process.pid)
        os.kill(process.pid, signal.SIGKILL)
        if process.wait(_START_S) != -signal.SIGKILL:
            raise LiveFailure(f"{command[1]} ended by itself: {process.log_text()}")
    for left_over in shared_memory:
        left_over.unlink(missing_ok=True)
    with read_bag(path) as bag:
        records = list(bag.records())
    topic = output_topic or _TOPIC
    stamps = {
        ns_from_stamp(record.decode().header.stamp) for record in records if record.topic.lstrip("/") == topic
    }
    expected = sender.attitudes if output_topic else sender.samples
    missing = [number for number, (stamp_ns, _) in enumerate(expected) if stamp_ns not in stamps]
    recovered = recover(path, recovered_path(path)).path
    return KillTrial(
        sent_count=len(expected),
        kept_count=len(expected) - len(missing),
        lost_s=expected[-1][1] - expected[missing[0]][1] + 1.0 / RATE_HZ if missing else 0.0,
        has_gap=bool(missing) and len(expected) - missing[0] > len(missing),
        recovered_count=_count_by_rosbags(recovered),
        readable_counts=(len(records), _count_by_mcap(recovered)),
    )


class _Sender:
    """Publisher of INS samples, and subscriber to the node's attitudes.

    Attributes:
        samples: stamp in ns and steady time in s of each sample, in order.
        attitudes: stamp in ns and steady time in s of each received attitude, in order.
    """

    def __init__(self, graph: GraphObserver, output_topic: str | None) -> None:
        self.samples: list[tuple[int, float]] = []
        self.attitudes: list[tuple[int, float]] = []
        self._graph = graph
        self._publisher = graph.node.create_publisher(Imu, _TOPIC, QoSProfile(depth=1000))
        if output_topic is not None:
            graph.node.create_subscription(ShipAttitude, output_topic, self._receive, QoSProfile(depth=1000))
        self._message = Imu()
        self._message.header.frame_id = "ins"
        self._message.orientation.w = 1.0

    def send(self, duration_s: float) -> None:
        """Send samples at their rate, and receive attitudes meanwhile."""
        start_s = time.monotonic()
        due_s = start_s
        while (now_s := time.monotonic()) - start_s < duration_s:
            time_ns = time.time_ns()
            self._message.header.stamp.sec, self._message.header.stamp.nanosec = divmod(time_ns, NS_PER_S)
            self.samples.append((time_ns, now_s))
            self._publisher.publish(self._message)
            due_s += 1.0 / RATE_HZ
            while (left_s := due_s - time.monotonic()) > 0.0:
                self._graph.executor.spin_once(timeout_sec=left_s)

    def _receive(self, message: ShipAttitude) -> None:
        self.attitudes.append((ns_from_stamp(message.header.stamp), time.monotonic()))


def _shared_memory(pid: int) -> list[Path]:
    """Return the shared-memory files that remain after a process is killed, except ports that others may use."""
    mapped = {line.split(maxsplit=5)[-1] for line in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines()}
    segments = [path for path in mapped if path.startswith("/dev/shm/fast") and "fastrtps_port" not in path]
    return [Path(path + suffix) for path in segments for suffix in ("", "_el")]


def _wait_for_disk(sender: _Sender, path: Path, process: LiveProcess) -> None:
    """Send samples until one is on the disk, which shows that both ends are connected; then forget these samples."""
    deadline_s = time.monotonic() + _START_S
    while not _has_samples(path):
        if process.exit_code is not None or time.monotonic() > deadline_s:
            raise LiveFailure(f"{path}: no data written: {process.log_text()}")
        sender.send(_WARM_UP_S)
    sender.samples.clear()
    sender.attitudes.clear()


def _has_samples(path: Path) -> bool:
    try:
        with read_bag(path) as bag:
            return any(record.topic.lstrip("/") == _TOPIC for record in bag.records())
    except BadInput:
        return False


def _count_by_rosbags(path: Path) -> int:
    with Reader(path) as reader:
        return sum(1 for _ in reader.messages())


def _count_by_mcap(path: Path) -> int:
    with open(path, "rb") as stream:
        return sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
