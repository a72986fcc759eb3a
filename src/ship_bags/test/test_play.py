"""play with a real node, unusual bags and a terminal: resets by loops, latched messages, split folders, keys."""

import contextlib
import itertools
import os
import pty
import subprocess
import termios
import time

import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import serialize
from ship_testing.hand_made_bags import PERIOD_NS, START_NS, imu, vector, write_imu_bag
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import executable

pytestmark = pytest.mark.live

SUITE = "ship_attitude: {ros__parameters: {use_sim_time: true, ins: {frame_id: ins}}}\n"


class Domain:
    """ROS domain with an observer, and processes that end with the test."""

    def __init__(self, folder):
        domain_id = free_domain_id()
        self.folder = folder
        self.environment = live_environment(domain_id, folder / "ros")
        self.graph = GraphObserver(domain_id)
        self.processes = []

    def start(self, package, name, *arguments):
        log_path = self.folder / f"{len(self.processes)}_{name}.log"
        command = [*executable(package, name), *map(str, arguments)]
        self.processes.append(LiveProcess(command, log_path, self.environment))
        return self.processes[-1]

    def listen(self, topic, kind, **qos):
        from rclpy.qos import QoSProfile

        received = []
        self.graph.node.create_subscription(kind, topic, received.append, QoSProfile(depth=10_000, **qos))
        return received

    def play(self, *arguments):
        player = self.start("ship_bags", "play", *arguments)
        assert self.graph.spin_until(lambda: player.exit_code is not None, 60), player.log_text()
        return player


@pytest.fixture
def domain(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made = Domain(tmp_path)
    yield made
    for process in made.processes:
        process.__exit__(None, None, None)
    made.graph.__exit__(None, None, None)


def test_each_loop_is_one_clean_reset_of_a_node(domain, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray

    from ship_msgs.msg import ShipAttitude

    bag = write_imu_bag(tmp_path / "in.mcap", count=300)
    (tmp_path / "suite.yaml").write_text(SUITE)
    node = domain.start("ship_attitude_star", "ship_attitude", "--ros-args", "--params-file", tmp_path / "suite.yaml")
    attitudes = domain.listen("ship/attitude", ShipAttitude)
    received = domain.listen("/diagnostics", DiagnosticArray)
    assert domain.graph.wait_for(publishers={"/ship/attitude": 1}, unless=lambda: node.exit_code is not None)
    player = domain.play(bag, "--loop", "3", "--wait-for-subscribers", "ins/imu", "/clock")
    assert player.exit_code == 0, player.log_text()

    def clock_jumps():
        return [
            value.value
            for array in received
            for status in array.status
            for value in status.values
            if value.key == "clock jumps back"
        ]

    assert domain.graph.spin_until(lambda: "2" in clock_jumps())
    # Between the jump and the first sample the node publishes INVALID.
    attitudes = [message for message in attitudes if message.status != ShipAttitude.INVALID]
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in attitudes]
    jumps = [number for number, (earlier, later) in enumerate(itertools.pairwise(stamps), 1) if later <= earlier]
    assert len(jumps) == 2
    # Each loop begins again with the first sample and gives the same outputs as the first loop.
    laps = [attitudes[start:end] for start, end in itertools.pairwise([0, *jumps, len(attitudes)])]
    assert [stamps[start] - START_NS for start in (0, *jumps)] == [0, 0, 0]
    shared = min(len(lap) for lap in laps)
    assert shared > 200
    for lap in laps[1:]:
        assert [message.heading for message in lap[:shared]] == [message.heading for message in laps[0][:shared]]
        assert [list(message.covariance) for message in lap[:shared]] == [
            list(message.covariance) for message in laps[0][:shared]
        ]
    assert node.log_text().count("clock went back by") == 2
    # No third reset comes afterwards.
    time.sleep(1.2)
    domain.graph.spin_until(lambda: False, 0.3)
    assert set(clock_jumps()) <= {"0", "1", "2"}


def test_a_start_offset_keeps_earlier_latched_messages(domain, tmp_path):
    from geometry_msgs.msg import Vector3
    from rclpy.qos import DurabilityPolicy
    from sensor_msgs.msg import Imu

    with BagWriter(tmp_path / "in.mcap") as bag:
        bag.add_topic("ship/calibration", "geometry_msgs/msg/Vector3", latched=True)
        for number in range(100):
            if number in (0, 10):
                bag.write("ship/calibration", vector(x=float(number)), START_NS + number * PERIOD_NS)
            bag.write("ship/lever", vector(x=float(number)), START_NS + number * PERIOD_NS)
            bag.write("ins/imu", imu(START_NS + number * PERIOD_NS), START_NS + number * PERIOD_NS)
    calibrations = domain.listen("ship/calibration", Vector3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    levers = domain.listen("ship/lever", Vector3)
    samples = domain.listen("ins/imu", Imu)
    player = domain.play(tmp_path / "in.mcap", "--start-offset", "0.5", "--loop", "2", "--rate", "2")
    assert player.exit_code == 0, player.log_text()
    assert domain.graph.spin_until(lambda: len(samples) == 100)
    # Each loop publishes the last of the two latched messages; other messages before the start are not published.
    assert [message.x for message in calibrations] == [10.0, 10.0]
    assert [message.x for message in levers] == [float(number) for number in range(50, 100)] * 2


def test_a_folder_of_split_files_is_played_through(domain, tmp_path):
    from sensor_msgs.msg import Imu

    bag = FolderWriter(tmp_path / "voyage", SplitLimits(size_bytes=3000))
    for number in range(200):
        stamp_ns = START_NS + number * PERIOD_NS
        bag.write_raw("ins/imu", "sensor_msgs/msg/Imu", serialize(imu(stamp_ns)), stamp_ns)
        if number % 10 == 9:
            bag.flush()
    bag.close()
    assert len(bag.files) > 2
    samples = domain.listen("ins/imu", Imu)
    player = domain.play(tmp_path / "voyage", "--rate", "4")
    assert player.exit_code == 0, player.log_text()
    assert domain.graph.spin_until(lambda: len(samples) == 200)
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in samples]
    assert stamps == [START_NS + number * PERIOD_NS for number in range(200)]


def test_two_types_under_one_name_are_refused(domain, tmp_path):
    with BagWriter(tmp_path / "in.mcap") as bag:
        bag.write("ins/imu", imu(START_NS), START_NS)
        bag.write("ship/lever", vector(), START_NS)
    player = domain.play(tmp_path / "in.mcap", "--remap", "ship/lever:=a/b", "ins/imu:=a/b")
    assert player.exit_code == 2
    (line,) = player.log_text().splitlines()
    assert "in.mcap: topics 'ins/imu' and 'ship/lever' cannot both be read as 'a/b'" in line


@contextlib.contextmanager
def on_a_terminal(domain, *command):
    """Start a process on a new pseudo-terminal; yield the process, the end for the keys, and the process's end."""
    keys, terminal = pty.openpty()
    with open(domain.folder / "terminal.log", "wb") as log:
        process = subprocess.Popen(
            ["setsid", "--ctty", *map(str, command)],
            stdin=terminal,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=domain.environment,
        )
    try:
        yield process, keys, terminal
    finally:
        process.kill()
        process.wait()
        os.close(keys)
        os.close(terminal)


def test_keys_on_a_terminal_step_speed_up_and_pause(domain, tmp_path):
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu

    samples, times = domain.listen("ins/imu", Imu), domain.listen("/clock", Clock)
    # At this rate the bag, one second long, takes 17 minutes: without the keys the test would not end.
    options = ("--paused", "--rate", "0.001", "--wait-for-subscribers", "ins/imu", "/clock")
    command = [*executable("ship_bags", "play"), write_imu_bag(tmp_path / "in.mcap", count=100), *options]

    def is_clock_stopped():
        """Return True if the clock was published again with the same time."""
        seen = len(times)
        assert domain.graph.spin_until(lambda: len(times) >= seen + 3)
        return times[-1].clock == times[-3].clock

    with on_a_terminal(domain, *command) as (process, keys, terminal):
        before = termios.tcgetattr(terminal)
        assert domain.graph.spin_until(lambda: not termios.tcgetattr(terminal)[3] & termios.ICANON)
        os.write(keys, b"sxs")
        assert domain.graph.spin_until(lambda: len(samples) == 2)
        assert domain.graph.spin_until(is_clock_stopped)
        assert len(samples) == 2
        os.write(keys, b" " + 8 * b"+")
        assert domain.graph.spin_until(lambda: len(samples) > 10)
        os.write(keys, b" ")
        assert domain.graph.spin_until(is_clock_stopped)
        reached = len(samples)
        assert domain.graph.spin_until(is_clock_stopped)
        assert len(samples) == reached < 100
        os.write(keys, 4 * b"+" + b" ")
        assert domain.graph.spin_until(lambda: process.poll() is not None)
        assert process.returncode == 0
        assert domain.graph.spin_until(lambda: len(samples) == 100)
        assert termios.tcgetattr(terminal) == before
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in samples]
    assert stamps == [START_NS + number * PERIOD_NS for number in range(100)]


def test_ctrl_c_on_a_terminal_ends_it_and_gives_the_terminal_back(domain, tmp_path):
    play = [*executable("ship_bags", "play"), write_imu_bag(tmp_path / "in.mcap"), "--paused", "--wait-timeout", "0"]
    with on_a_terminal(domain, *play) as (process, keys, terminal):
        before = termios.tcgetattr(terminal)
        assert domain.graph.spin_until(lambda: not termios.tcgetattr(terminal)[3] & termios.ICANON)
        os.write(keys, b"\x03")
        assert domain.graph.spin_until(lambda: process.poll() is not None)
        assert process.returncode == 0
        assert termios.tcgetattr(terminal) == before


def test_a_background_job_does_not_change_its_terminal(domain, tmp_path):
    # Changing the terminal would stop the job for ever (SIGTTOU).
    play = [*executable("ship_bags", "play"), write_imu_bag(tmp_path / "in.mcap", count=20), "--wait-timeout", "0"]
    with on_a_terminal(domain, "bash", "-c", 'set -m; "$@" & wait $!', "shell", *play) as (process, _, _):
        assert domain.graph.spin_until(lambda: process.poll() is not None)
        assert process.returncode == 0
    assert "play: 20 messages" in (domain.folder / "terminal.log").read_text()
