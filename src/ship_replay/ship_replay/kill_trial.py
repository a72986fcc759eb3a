"""One kill −9 at a random moment of a recorder or of a node with its black box, and what was left on the disk."""

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

from ship_replay.bag_reader import read_bag
from ship_replay.errors import BadInput
from ship_replay.live_graph import GraphObserver
from ship_replay.live_process import LiveProcess, free_domain_id, live_environment
from ship_replay.live_run import LiveFailure, executable
from ship_replay.recover import recover, recovered_path
from ship_replay.times import NS_PER_S

RATE_HZ = 200.0
_TOPIC = "ins/imu"
_EARLIEST_S = 0.3
_LATEST_S = 2.5
_START_S = 30.0
_WARM_UP_PERIOD_S = 0.05
_SUITE = "ship_attitude: {ros__parameters: {ins: {frame_id: ins}}}\n"


@dataclass(frozen=True)
class KillTrial:
    """What one kill cost.

    Attributes:
        killed_after_s: from the first message sent to the kill.
        sent: messages sent before the kill.
        kept: of these, the ones on the disk.
        lost_s: from the sending of the first message that is not on the disk to the kill; 0 where all are.
        has_gap: whether a message is missing before one that is there.
        recovered: messages of all topics in the recovered file, by ``rosbags``.
        readable: messages of all topics in the killed file, and in the recovered one by the seeking ``mcap`` reader.
    """

    killed_after_s: float
    sent: int
    kept: int
    lost_s: float
    has_gap: bool
    recovered: int
    readable: tuple[int, int]

    def keeps(self, flush_period_s: float) -> bool:
        """Whether no more than a flush period is lost and everything left can be read by both readers."""
        whole = set(self.readable) == {self.recovered} and self.recovered > 0
        return whole and not self.has_gap and self.lost_s <= flush_period_s


def kill_recorder(folder: Path, seed: int, flush_period_s: float) -> KillTrial:
    """Kill `record`.

    Args:
        folder: takes logs and bags.
        seed: of the moment.
        flush_period_s: of the recorder.
    """
    path = folder / f"record_{seed}.mcap"
    options = ["--topics", _TOPIC, "--flush-period-s", str(flush_period_s)]
    command = [*executable("ship_replay", "record"), "--out", str(path), *options]
    return _trial(command, folder, path, seed)


def kill_node(folder: Path, seed: int) -> KillTrial:
    """Kill the ship-attitude node, which writes its black box."""
    path = folder / f"box_{seed}.mcap"
    suite = folder / "suite.yaml"
    suite.write_text(_SUITE, encoding="utf-8")
    # Nothing may be lost on the way: what is missing on the disk must be the box's doing.
    reliable = ["-p", f"qos_overrides./{_TOPIC}.subscription.reliability:=reliable"]
    arguments = ["--ros-args", "--params-file", str(suite), "-p", f"black_box:={path}", *reliable]
    return _trial([*executable("ship_attitude_star", "ship_attitude"), *arguments], folder, path, seed)


def _trial(command: Sequence[str], folder: Path, path: Path, seed: int) -> KillTrial:
    killed_after_s = random.Random(seed).uniform(_EARLIEST_S, _LATEST_S)
    domain_id = free_domain_id()
    environment = live_environment(domain_id, folder / "ros")
    with (
        GraphObserver(domain_id) as graph,
        LiveProcess(command, path.with_suffix(".log"), environment) as process,
    ):
        sender = _Sender(graph)
        _wait_for_disk(sender, path, process)
        sent_s = sender.send(killed_after_s)
        os.kill(process.pid, signal.SIGKILL)
        killed_s = time.monotonic()
        if process.wait(_START_S) != -signal.SIGKILL:
            raise LiveFailure(f"{command[1]} ended by itself: {process.log()}")
    with read_bag(path) as bag:
        records = list(bag.records())
    kept = {
        round(record.decode().linear_acceleration.x) for record in records if record.topic.lstrip("/") == _TOPIC
    }
    kept.discard(-1)
    missing = [number for number in range(len(sent_s)) if number not in kept]
    recovered = recover(path, recovered_path(path)).path
    return KillTrial(
        killed_after_s=killed_after_s,
        sent=len(sent_s),
        kept=len(kept),
        lost_s=killed_s - sent_s[missing[0]] if missing else 0.0,
        has_gap=bool(missing) and missing[0] < max(kept, default=0),
        recovered=_count_by_rosbags(recovered),
        readable=(len(records), _count_by_mcap(recovered)),
    )


class _Sender:
    """Sends INS samples that are numbered in a field which the node does not use."""

    def __init__(self, graph: GraphObserver) -> None:
        self._publisher = graph.node.create_publisher(Imu, _TOPIC, QoSProfile(depth=1000))
        self._message = Imu()
        self._message.header.frame_id = "ins"
        self._message.orientation.w = 1.0

    def send_one(self, number: int) -> None:
        """Send a sample of now."""
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.time_ns(), NS_PER_S)
        self._message.linear_acceleration.x = float(number)
        self._publisher.publish(self._message)

    def send(self, duration_s: float) -> list[float]:
        """Send samples numbered from zero; returns the steady time of each."""
        start_s = time.monotonic()
        sent_s: list[float] = []
        while (now_s := time.monotonic()) - start_s < duration_s:
            sent_s.append(now_s)
            self.send_one(len(sent_s) - 1)
            time.sleep(max(0.0, start_s + len(sent_s) / RATE_HZ - time.monotonic()))
        return sent_s


def _wait_for_disk(sender: _Sender, path: Path, process: LiveProcess) -> None:
    """Send samples numbered -1 until one is on the disk: then both ends of the connection are up."""
    deadline_s = time.monotonic() + _START_S
    while not _has_samples(path):
        if process.exit_code is not None or time.monotonic() > deadline_s:
            raise LiveFailure(f"{path}: nothing is written: {process.log()}")
        sender.send_one(-1)
        time.sleep(_WARM_UP_PERIOD_S)


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
