"""record into rosbag2 folders; full or read-only disks; clock steps."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable

import pytest

from ship_bags.commands.record import MIN_STEP_NS, ClockStepDetector, Recorder, _parser, main
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_testing.rosbag2_folders import information, rosbags_times
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment
from ship_testing.trials.live_run import executable

IMU = "sensor_msgs/msg/Imu"
PERIOD_NS = 10_000_000


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--out", "a.mcap", "--split-mb", "5"], "--split-mb and --split-s need a folder: --out a\n"),
        (["--out", "a", "--split-mb", "0"], "argument --split-mb: 0 is not a positive number"),
        (["--out", "a", "--split-s", "nan"], "argument --split-s: nan is not a positive number"),
    ],
)
def test_split_options_refused_in_one_line(options, expected, capsys):
    with pytest.raises(SystemExit) as left:
        main(options)
    assert left.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert expected.removesuffix("\n") in error


# -- clocks -------------------------------------------------------------------------------------------------------


class TestClockStepDetector:
    def steps(self, offsets_ns, reading_ns=1000):
        detector = ClockStepDetector()
        looks = [(number * 10**8, offset_ns) for number, offset_ns in enumerate(offsets_ns)]
        return [detector.detect_step(steady, steady + offset, steady + reading_ns) for steady, offset in looks]

    def test_a_running_clock_does_not_step(self):
        # Slewed by 500 ppm, the most that adjtime allows: 50 µs in each 100 ms.
        assert self.steps([10**18 + 50_000 * number for number in range(1000)]) == [None] * 1000

    @pytest.mark.parametrize("step_ns", [-3_600_000_000_000, -MIN_STEP_NS - 1, MIN_STEP_NS + 1, 86_400_000_000_000])
    def test_a_step_is_reported_once_with_its_size(self, step_ns):
        assert self.steps([10**18, 10**18, 10**18 + step_ns, 10**18 + step_ns]) == [None, None, step_ns, None]

    def test_a_pause_between_the_two_readings_is_no_step(self):
        detector = ClockStepDetector()
        assert detector.detect_step(0, 10**18, 1000) is None
        # The process slept for 2 s after it read the steady clock.
        assert detector.detect_step(10**8, 10**18 + 10**8 + 2 * 10**9, 10**8 + 2 * 10**9) is None
        assert detector.detect_step(2 * 10**8, 10**18 + 2 * 10**8, 2 * 10**8 + 1000) is None


# -- live ---------------------------------------------------------------------------------------------------------


class Recording:
    """`record` in a domain of its own, with a node that publishes numbered samples."""

    def __init__(self, folder, *options):
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import Imu

        domain_id = free_domain_id()
        self.graph = GraphObserver(domain_id)
        command = [*executable("ship_bags", "record"), *options]
        self.process = LiveProcess(command, folder / "record.log", live_environment(domain_id, folder / "ros"))
        self.publisher = self.graph.node.create_publisher(Imu, "ins/imu", QoSProfile(depth=1000))
        self.kind = Imu
        self.count = 0

    def connect(self):
        assert self.graph.spin_until(
            lambda: self.publisher.get_subscription_count() > 0 or self.process.exit_code is not None, 60
        ), self.process.log_text()

    def send(self, count):
        for _ in range(count):
            message = self.kind()
            message.header.frame_id = "ins"
            message.linear_acceleration.x = float(self.count)
            self.publisher.publish(message)
            self.count += 1
            time.sleep(0.002)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.__exit__(None, None, None)
        self.graph.__exit__(None, None, None)


def sample_numbers(path):
    with read_bag(path) as bag:
        return [round(record.decode().linear_acceleration.x) for record in bag.records() if "imu" in record.topic]


def samples_on_disk(path):
    """Return the number of samples that a running recording has on the disk."""
    try:
        return len(sample_numbers(path))
    except BadInput:
        return 0  # nothing that is whole yet


live = pytest.mark.live


@pytest.fixture(autouse=True)
def this_machine_only(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


class TestLive:
    pytestmark = live

    def test_a_folder_with_split_files(self, tmp_path):
        folder = tmp_path / "voyage"
        with Recording(tmp_path, "--out", str(folder), "--split-mb", "0.01", "--topics", "ins/imu") as recording:
            recording.connect()
            recording.send(1500)
            assert recording.process.end(signal.SIGINT) == 0
        assert sample_numbers(folder) == list(range(1500))
        metadata = information(folder)
        assert len(metadata["relative_file_paths"]) > 3
        assert metadata["message_count"] == len(rosbags_times(folder)) == 1500
        # The publisher's QoS, as far as DDS transmits it.
        profiles = metadata["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]
        # A publisher of the test before may still be known to DDS.
        assert ("reliable", "volatile") in {(profile["reliability"], profile["durability"]) for profile in profiles}

    def test_a_killed_folder_is_recovered(self, tmp_path):
        folder = tmp_path / "voyage"
        with Recording(tmp_path, "--out", str(folder), "--split-mb", "0.01", "--topics", "ins/imu") as recording:
            recording.connect()
            recording.send(1000)
            assert recording.graph.spin_until(lambda: samples_on_disk(folder) > 500)
            os.kill(recording.process.pid, signal.SIGKILL)
            recording.process.wait(10)
        kept = sample_numbers(folder)
        assert kept == list(range(len(kept)))
        assert len(kept) > 500
        assert main(["--recover", str(folder)]) == 0
        assert len(rosbags_times(tmp_path / "voyage.recovered")) == len(kept)

    def test_clock_that_goes_back(self, tmp_path):
        from rosgraph_msgs.msg import Clock

        path = tmp_path / "voyage.mcap"
        options = ("--out", str(path), "--use-sim-time", "--topics", "ins/imu")
        with Recording(tmp_path, *options) as recording:
            recording.connect()
            clock = recording.graph.node.create_publisher(Clock, "/clock", 10)
            assert recording.graph.spin_until(lambda: clock.get_subscription_count() > 0)
            def at_clock(second: int, seen: Callable[[], bool]) -> None:
                """Publish a clock time and samples, which come on two connections, until the effect is seen."""
                message = Clock()
                message.clock.sec = second
                assert recording.graph.spin_until(lambda: clock.publish(message) or recording.send(1) or seen())

            # The first sample on the disk has waited for the first clock; the file itself grows before.
            at_clock(1000, lambda: samples_on_disk(path) > 0)
            at_clock(400, lambda: "stepped by" in recording.process.log_text())
            recording.send(20)
            assert recording.process.end() == 0
            log = recording.process.log_text()
        assert log.count("stepped by") == 1
        assert "/clock stepped by -600.000 s to 1970-01-01T00:06:40.000Z; recording goes on" in log
        with read_bag(path) as bag:
            assert sum(1 for _ in bag.records()) == recording.count
            assert bag.metadata["clock_step_1"] == {
                "clock": "/clock",
                "step_ns": str(-600 * 10**9),
                "to_ns": str(400 * 10**9),
            }

    def test_a_stalled_disk_is_no_timeout(self, tmp_path):
        import rclpy
        from geometry_msgs.msg import Vector3
        from rclpy.parameter import Parameter
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import Imu

        idle_s = 1.5
        sent = []

        def send():
            # The recorder handles the clock before the sample. After the clock alone, the last sample would be too old.
            clock.publish(Clock())
            publisher.publish(Imu(linear_acceleration=Vector3(x=float(len(sent)))))
            sent.append(len(sent))

        class StallingBag(BagWriter):
            """The disk stalls while the second message is on its way; the third comes soon after."""

            def flush(self):
                super().flush()
                if not sent and publisher.get_subscription_count() and clock.get_subscription_count():
                    send()
                elif len(sent) == 1 == sum(recorder.counts.values()):
                    send()
                    time.sleep(1.3 * idle_s)
                    threading.Timer(0.3 * idle_s, send).start()

        with GraphObserver(free_domain_id()) as graph:
            clock = graph.node.create_publisher(Clock, "/clock", 10)
            publisher = graph.node.create_publisher(Imu, "ins/imu", 10)
            simulated = [Parameter("use_sim_time", value=True)]
            node = rclpy.create_node("record", context=graph.node.context, parameter_overrides=simulated)
            options = _parser().parse_args(["--topics", "ins/imu", "--until-idle-s", str(idle_s)])
            recorder = Recorder(node, StallingBag(tmp_path / "voyage.mcap", atomic=False), options)
            recorder.run()
            node.destroy_node()
        assert sample_numbers(tmp_path / "voyage.mcap") == [0, 1, 2]

    @pytest.mark.parametrize("out", ["voyage.mcap", "voyage"])
    def test_a_full_disk(self, tmp_path, out):
        with small_disk(tmp_path / "disk", "size=96k"):
            path = tmp_path / "disk" / out
            with Recording(tmp_path, "--out", str(path), "--topics", "ins/imu", *splits(out)) as recording:
                recording.connect()
                assert recording.graph.spin_until(
                    lambda: recording.send(50) or recording.process.exit_code is not None, timeout_s=60
                )
                assert recording.process.exit_code == 2
                last = recording.process.log_text().splitlines()[-1]
            assert last.startswith(f"record: {path}: recording failed: No space left on device; ")
            assert "use record --recover to finish it" in last
            assert list(path.parent.rglob("*.part")) == []
            kept = sample_numbers(path)
            assert len(kept) > 100
            assert kept == list(range(len(kept)))
            with read_bag(path) as bag:
                assert sum(1 for _ in bag.records()) == len(kept)
                assert not any("damaged:" in line or "is damaged (" in line for line in bag.problems), bag.problems

    @pytest.mark.parametrize("out", ["voyage.mcap", "voyage"])
    def test_a_read_only_disk(self, tmp_path, out):
        with small_disk(tmp_path / "disk", "ro,size=96k"):
            path = tmp_path / "disk" / out
            with Recording(tmp_path, "--out", str(path)) as recording:
                assert recording.process.wait(30) == 2
            (line,) = recording.process.log_text().splitlines()
            assert line.startswith(f"record: {path}: cannot be ")
            assert line.endswith("Read-only file system")


def splits(out):
    return [] if out.endswith(".mcap") else ["--split-mb", "0.02"]


class small_disk:  # noqa: N801 - used like a function
    """A file system of its own in memory; the test is skipped where none can be mounted."""

    def __init__(self, path, options):
        self.path, self.options = path, options

    def __enter__(self):
        self.path.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", self.options, "tmpfs", str(self.path)]
        if os.geteuid() != 0 or subprocess.run(command, check=False, capture_output=True).returncode != 0:
            pytest.skip("a small file system can be mounted by root only")

    def __exit__(self, *_):
        subprocess.run(["umount", "-l", str(self.path)], check=True)
