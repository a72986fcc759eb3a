"""record into rosbag2 folders; disks that are full or read-only; clocks that step."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from ship_bags.commands.record import main
from ship_bags.errors import BadInput
from ship_bags.live.record import STEP_NS, ClockWatch, Recorder, RecordOptions
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import serialize
from ship_replay.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment
from ship_replay.trials.live_run import executable
from ship_testing.hand_made_bags import START_NS, imu

IMU = "sensor_msgs/msg/Imu"
PERIOD_NS = 10_000_000


def information(folder):
    return yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def write(bag, numbers, topic="/ins/imu"):
    for number in numbers:
        bag.write_raw(topic, IMU, serialize(imu(START_NS + number * PERIOD_NS)), START_NS + number * PERIOD_NS)


def rosbags_times(path):
    with Reader(path) as reader:
        return [time_ns for _, time_ns, _ in reader.messages()]


# -- folders ------------------------------------------------------------------------------------------------------


def test_a_new_file_begins_by_size_and_rosbags_reads_them_as_one(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(size_bytes=3000))
    bag.add_topic("/ins/imu", IMU)
    bag.add_topic("/ship/calibration", "geometry_msgs/msg/Vector3", latched=True)
    for part in range(20):
        write(bag, range(part * 10, part * 10 + 10))
        bag.flush()
    bag.close()
    told = information(tmp_path / "voyage")
    names = told["relative_file_paths"]
    assert len(names) > 2
    assert names == [f"voyage_{number}.mcap" for number in range(len(names))]
    # A file goes beyond the limit by one flush at most, and by its summary.
    assert all((tmp_path / "voyage" / name).stat().st_size < 3000 + 6000 for name in names)
    assert (told["version"], told["storage_identifier"], told["message_count"]) == (9, "mcap", 200)
    assert told["starting_time"]["nanoseconds_since_epoch"] == START_NS
    assert told["duration"]["nanoseconds"] == 199 * PERIOD_NS
    assert sum(file["message_count"] for file in told["files"]) == 200
    imu_topic, latched_topic = told["topics_with_message_count"]
    assert (imu_topic["topic_metadata"]["name"], imu_topic["message_count"]) == ("/ins/imu", 200)
    assert latched_topic["topic_metadata"]["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert imu_topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    expected = [START_NS + number * PERIOD_NS for number in range(200)]
    assert rosbags_times(tmp_path / "voyage") == expected
    # Each file alone, by the seeking reader, with its own definitions.
    alone = []
    for name in names:
        with open(tmp_path / "voyage" / name, "rb") as stream:
            for schema, _, message in make_reader(stream, validate_crcs=True).iter_messages():
                assert b"MSG: geometry_msgs/Quaternion" in schema.data
                alone.append(message.log_time)
    assert alone == expected
    with AnyReader([tmp_path / "voyage"]) as reader:
        connection, _, data = next(reader.messages())
        assert reader.deserialize(data, connection.msgtype).header.frame_id == "ins"


def test_a_new_file_begins_by_time(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(time_s=0.2))
    for number in range(3):
        write(bag, [number])
        bag.flush()
        time.sleep(0.25)
        bag.flush()
    bag.close()
    counts = [file["message_count"] for file in information(tmp_path / "voyage")["files"]]
    # The last file was begun when the third message's time was over.
    assert counts == [1, 1, 1, 0]
    assert len(rosbags_times(tmp_path / "voyage")) == 3


def test_nothing_written_is_no_reason_for_a_new_file(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(time_s=1e-6))
    for _ in range(5):
        bag.flush()
    bag.close()
    assert information(tmp_path / "voyage")["relative_file_paths"] == ["voyage_0.mcap"]


def test_the_information_is_there_and_names_every_file_while_recording(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(size_bytes=3000))
    for part in range(12):
        write(bag, range(part * 10, part * 10 + 10))
        bag.flush()
        there = sorted(path.name for path in (tmp_path / "voyage").glob("*.mcap"))
        assert sorted(information(tmp_path / "voyage")["relative_file_paths"]) == there
        with read_bag(tmp_path / "voyage") as running:
            assert sum(1 for _ in running.records()) == part * 10 + 10
    bag.close()


def test_a_folder_that_is_there_is_not_touched(tmp_path):
    with pytest.raises(BadInput, match="cannot be made: File exists"):
        FolderWriter(tmp_path, SplitLimits())


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
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert expected.removesuffix("\n") in said


# -- clocks -------------------------------------------------------------------------------------------------------


class TestClockWatch:
    def steps(self, offsets_ns, reading_ns=1000):
        watch = ClockWatch()
        looks = [(number * 10**8, offset_ns) for number, offset_ns in enumerate(offsets_ns)]
        return [watch.look(steady, steady + offset, steady + reading_ns) for steady, offset in looks]

    def test_a_running_clock_does_not_step(self):
        # Slewed by 500 ppm, the most that adjtime allows: 50 µs in each 100 ms.
        assert self.steps([10**18 + 50_000 * number for number in range(1000)]) == [None] * 1000

    @pytest.mark.parametrize("step_ns", [-3_600_000_000_000, -STEP_NS - 1, STEP_NS + 1, 86_400_000_000_000])
    def test_a_step_is_told_once_with_its_size(self, step_ns):
        assert self.steps([10**18, 10**18, 10**18 + step_ns, 10**18 + step_ns]) == [None, None, step_ns, None]

    def test_sleep_between_the_two_readings_is_no_step(self):
        watch = ClockWatch()
        assert watch.look(0, 10**18, 1000) is None
        # The process slept for 2 s after it read the steady clock.
        assert watch.look(10**8, 10**18 + 10**8 + 2 * 10**9, 10**8 + 2 * 10**9) is None
        assert watch.look(2 * 10**8, 10**18 + 2 * 10**8, 2 * 10**8 + 1000) is None


# -- live ---------------------------------------------------------------------------------------------------------


class Recording:
    """`record` in a domain of its own, beside a node that publishes numbered samples."""

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
        ), self.process.log()

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


def has_sample(path):
    """Whether a recording that goes on has one on the disk."""
    try:
        return bool(sample_numbers(path))
    except BadInput:
        return False  # nothing that is whole yet


live = [pytest.mark.live, pytest.mark.xdist_group("dds")]


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
        told = information(folder)
        assert len(told["relative_file_paths"]) > 3
        assert told["message_count"] == len(rosbags_times(folder)) == 1500
        # What the publisher offered, as far as DDS tells it.
        profiles = told["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]
        # A publisher of the test before may still be known to DDS.
        assert ("reliable", "volatile") in {(profile["reliability"], profile["durability"]) for profile in profiles}

    def test_a_killed_folder_is_recovered(self, tmp_path):
        folder = tmp_path / "voyage"
        with Recording(tmp_path, "--out", str(folder), "--split-mb", "0.01", "--topics", "ins/imu") as recording:
            recording.connect()
            recording.send(1000)
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
                """Publish a clock and samples until its effect is seen: they come on two connections."""
                message = Clock()
                message.clock.sec = second
                assert recording.graph.spin_until(lambda: clock.publish(message) or recording.send(1) or seen())

            # The first sample on the disk has waited for the first clock; the file itself grows before.
            at_clock(1000, lambda: has_sample(path))
            at_clock(400, lambda: "stepped by" in recording.process.log())
            recording.send(20)
            assert recording.process.end() == 0
            said = recording.process.log()
        assert said.count("stepped by") == 1
        assert "/clock stepped by -600.000 s to 1970-01-01T00:06:40.000Z; recording goes on" in said
        with read_bag(path) as bag:
            assert sum(1 for _ in bag.records()) == recording.count
            assert bag.metadata["clock_step_1"] == {
                "clock": "/clock",
                "step_ns": str(-600 * 10**9),
                "to_ns": str(400 * 10**9),
            }

    def test_a_disk_that_stalls_is_no_silence(self, tmp_path):
        import rclpy
        from geometry_msgs.msg import Vector3
        from rclpy.parameter import Parameter
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import Imu

        idle_s = 1.5
        sent = []

        def send():
            # The clock is taken first, and with it alone nothing would have come for long.
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
            options = RecordOptions(topics=("ins/imu",), until_idle_s=idle_s)
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
                last = recording.process.log().splitlines()[-1]
            assert last.startswith(f"record: {path}: recording ended: No space left on device; ")
            assert "record --recover finishes it" in last
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
            (line,) = recording.process.log().splitlines()
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
