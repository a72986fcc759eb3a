"""play and record as processes over DDS: no loss, no change, control and clean end."""

import itertools
import os
import resource
import signal
import struct
import sys
import time

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import get_types_from_msg

from ship_bags.commands.play import CLOCK_PERIOD_NS, add_ticks
from ship_bags.live.recorded_graph import is_activity
from ship_bags.live.ros_process import dds_has_security, executable, loaded_libraries
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_factory import message_class
from ship_bags.message_store import RosbagsFactory, message_store
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

pytestmark = pytest.mark.live

START_NS = 1_700_000_000 * 10**9
LATENCY_NS = 3_000_000
PERIOD_NS = 10_000_000
PLAY = [sys.executable, "-m", "ship_bags.commands.play"]
RECORD = [sys.executable, "-m", "ship_bags.commands.record"]


class Live:
    """ROS domain with processes and an observer."""

    def __init__(self, folder, domain_id):
        self.folder = folder
        self.environment = live_environment(domain_id, folder)
        self.observer = GraphObserver(domain_id)
        self.node = self.observer.node
        self._processes = []

    def start(self, *command):
        process = LiveProcess(command, self.folder / f"{len(self._processes)}.log", self.environment)
        self._processes.append(process)
        return process

    def start_recorder(self, path, *options):
        recorder = self.start(*RECORD, "--out", str(path), *options)
        assert self.observer.spin_until(lambda: "recording to" in recorder.log_text())
        return recorder

    def play(self, path, *options):
        """Play to the end; return the printed text."""
        player = self.start(*PLAY, str(path), *options)
        assert self.observer.spin_until(lambda: player.exit_code is not None, 60), player.log_text()
        assert player.exit_code == 0, player.log_text()
        return player.log_text()

    def close(self):
        for process in self._processes:
            process.__exit__(None, None, None)
        self.observer.__exit__(None, None, None)


@pytest.fixture
def live(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    fixture = Live(tmp_path, free_domain_id())
    yield fixture
    fixture.close()


def imu(factory, number):
    """Return an Imu with its number; the other fields reveal a shift by one byte."""
    time_ns = START_NS + number * PERIOD_NS
    stamp = factory.make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    vector = factory.make("geometry_msgs/msg/Vector3", x=float(number), y=0.1 * number, z=-1.0 / 3.0)
    return factory.make(
        "sensor_msgs/msg/Imu",
        header=factory.make("std_msgs/msg/Header", stamp=stamp, frame_id="ins"),
        orientation=factory.make("geometry_msgs/msg/Quaternion", x=0.1, y=0.2, z=0.3, w=0.4),
        orientation_covariance=np.arange(9.0),
        angular_velocity=vector,
        angular_velocity_covariance=np.arange(9.0),
        linear_acceleration=vector,
        linear_acceleration_covariance=np.arange(9.0),
    )


def make_bag(path, count):
    """Write `count` Imu at 100 Hz, and every tenth of them as truth."""
    factory = RosbagsFactory()
    with BagWriter(path) as bag:
        for number in range(count):
            log_time_ns = START_NS + number * PERIOD_NS + LATENCY_NS
            bag.write("ins/imu", imu(factory, number), log_time_ns)
            if number % 10 == 0:
                bag.write("truth/imu", imu(factory, number), log_time_ns)
    return path


def contents(path):
    """Return topic, without its leading slash → [(log time, payload)]; and the problems of the bag."""
    found = {}
    with read_bag(path) as bag:
        for record in bag.records():
            found.setdefault(record.topic.lstrip("/"), []).append((record.log_time_ns, bytes(record.data)))
        return found, bag.problems


def payloads(path, topic):
    return [data for _, data in contents(path)[0].get(topic, [])]


def subscribe(live, topic, kind, received, **qos):
    from rclpy.qos import QoSProfile

    return live.node.create_subscription(kind, topic, received.append, QoSProfile(depth=10_000, **qos))


def ns(message):
    return message.clock.sec * 10**9 + message.clock.nanosec


def call(live, name):
    from std_srvs.srv import Trigger

    client = live.node.create_client(Trigger, f"/play/{name}")
    assert live.observer.spin_until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    assert live.observer.spin_until(future.done)
    return future.result()


# -- whole way ------------------------------------------------------------------------------------------------


@pytest.mark.smoke
def test_a_thousand_messages_at_ten_times_100_hz_arrive_unchanged(live, tmp_path):
    source = make_bag(tmp_path / "in.mcap", 1000)
    recorder = live.start_recorder(tmp_path / "out.mcap", "--use-sim-time", "--topics", "ins/imu", "truth/imu")
    live.play(source, "--rate", "10", "--wait-for-subscribers", "ins/imu", "truth/imu")
    assert recorder.end(signal.SIGINT) == 0
    sent, _ = contents(source)
    got, problems = contents(tmp_path / "out.mcap")
    assert problems == []
    for topic in ("ins/imu", "truth/imu"):
        assert [data for _, data in got[topic]] == [data for _, data in sent[topic]], topic
    # Log time is the bag's time, not that of the computer.
    assert all(START_NS - 10**9 < time_ns < START_NS + 20 * 10**9 for time_ns, _ in got["ins/imu"])
    assert "/ins/imu: 1000 messages\n" in recorder.log_text()
    assert "1100 messages in" in recorder.log_text()


def test_a_recording_carries_what_rosbag2_reads(live, tmp_path):
    source = make_bag(tmp_path / "in.mcap", 20)
    recorder = live.start_recorder(tmp_path / "out.mcap", "--topics", "ins/imu")
    live.play(source, "--wait-for-subscribers", "ins/imu")
    assert recorder.end(signal.SIGTERM) == 0
    from mcap.reader import make_reader

    with open(tmp_path / "out.mcap", "rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        rows = list(reader.iter_messages())
    schema, channel, _ = rows[0]
    assert {row[1].topic for row in rows} == {"/ins/imu"}
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/Imu", "ros2msg")
    assert b"MSG: geometry_msgs/Quaternion" in schema.data
    assert channel.message_encoding == "cdr"
    assert "durability: volatile" in channel.metadata["offered_qos_profiles"]
    # The type hash has the format of those that Jazzy nodes announce.
    info = live.node.get_publishers_info_by_topic("/rosout")
    assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
    assert info == [] or str(info[0].topic_type_hash).startswith("RIHS01_")
    # The publisher's time is that of the computer: less than ten minutes from now, whereas the bag's time is years ago.
    assert all(abs(row[2].publish_time - time.time_ns()) < 600 * 10**9 for row in rows)


def test_a_latched_message_from_before_is_recorded_and_played_latched(live, tmp_path):
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = live.node.create_publisher(String, "calibration", latched)
    publisher.publish(String(data="from before"))
    recorder = live.start_recorder(tmp_path / "out.mcap", "--topics", "calibration")
    assert live.observer.spin_until(lambda: publisher.get_subscription_count() == 1)
    assert live.observer.spin_until(lambda: (tmp_path / "out.mcap").stat().st_size > 400)
    assert recorder.end() == 0
    live.node.destroy_publisher(publisher)
    assert len(payloads(tmp_path / "out.mcap", "calibration")) == 1
    with read_bag(tmp_path / "out.mcap") as bag:
        assert bag.latched_topics == {"/calibration"}

    # The player loops endlessly, so that it still runs for the late subscriber.
    player = live.start(*PLAY, str(tmp_path / "out.mcap"), "--loop", "0", "--wait-timeout", "0")
    assert live.observer.wait_for(publishers={"/calibration": 1})
    received = []
    subscribe(live, "calibration", String, received, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    assert live.observer.spin_until(lambda: received)
    assert received[0].data == "from before"
    assert player.end() == 0


# -- playing --------------------------------------------------------------------------------------------------


def test_the_clock_is_never_further_behind_a_message_than_its_grid(tmp_path):
    # No message for 3.7 s, then three at odd times: the ticks of the clock must continue in between.
    factory = RosbagsFactory()
    with BagWriter(tmp_path / "in.mcap") as bag:
        for offset_ns in (0, 1, 3_712_345_678, 3_712_345_679, 3_799_999_999):
            bag.write("ins/imu", imu(factory, 0), START_NS + offset_ns)
    with read_bag(tmp_path / "in.mcap") as bag:
        events = list(add_ticks(bag.records(), START_NS - 100_000_000))
    assert [time_ns for time_ns, _ in events] == sorted(time_ns for time_ns, _ in events)
    tick_ns = None
    for time_ns, record in events:
        if record is None:
            assert tick_ns is None or time_ns - tick_ns == CLOCK_PERIOD_NS
            tick_ns = time_ns
        else:
            assert 0 <= time_ns - tick_ns < CLOCK_PERIOD_NS
    assert sum(record is not None for _, record in events) == 5


@pytest.mark.parametrize("stride", [1, 7, 10**9])
def test_with_ticks_left_out_the_clock_is_not_late(tmp_path, stride):
    factory = RosbagsFactory()
    offsets_ns = (0, 1, 3_712_345_678, 3_712_345_679, 3_730_000_000, 10**12)
    with BagWriter(tmp_path / "in.mcap") as bag:
        for offset_ns in offsets_ns:
            bag.write("ins/imu", imu(factory, 0), START_NS + offset_ns)
    with read_bag(tmp_path / "in.mcap") as bag:
        events = list(add_ticks(bag.records(), START_NS - 100_000_000, lambda: stride))
    ticks = [time_ns for time_ns, record in events if record is None]
    assert ticks == sorted(set(ticks))
    assert all((time_ns - ticks[0]) % CLOCK_PERIOD_NS == 0 for time_ns in ticks)
    for (before_ns, _), (time_ns, record) in itertools.pairwise(events):
        assert record is None or time_ns - before_ns < CLOCK_PERIOD_NS
    assert [time_ns for time_ns, record in events if record] == [START_NS + offset_ns for offset_ns in offsets_ns]
    assert len(ticks) <= 10**12 // CLOCK_PERIOD_NS // stride + 20 * len(offsets_ns)


def test_a_year_at_a_huge_rate_is_played_immediately(live, tmp_path):
    """Ticks of the whole year are left out: three billion of them would follow the first messages."""
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu

    factory = RosbagsFactory()
    year_ns = 365 * 86_400 * 10**9
    with BagWriter(tmp_path / "in.mcap") as bag:
        for number, time_ns in enumerate((START_NS, START_NS + PERIOD_NS, START_NS + year_ns)):
            bag.write("ins/imu", imu(factory, number), time_ns)
    times, messages = [], []
    subscribe(live, "/clock", Clock, times)
    subscribe(live, "ins/imu", Imu, messages)
    printed = live.play(tmp_path / "in.mcap", "--rate", "1e9")
    assert "play: 3 messages" in printed
    assert live.observer.spin_until(lambda: len(messages) == 3)
    assert live.observer.spin_until(lambda: ns(times[-1]) >= START_NS + year_ns)
    assert START_NS - 61 * 10**9 < ns(times[0]) < START_NS


def test_topics_without_subscribers_are_reported_and_not_waited_for(live, tmp_path):
    from sensor_msgs.msg import Imu

    factory = RosbagsFactory()
    with BagWriter(tmp_path / "in.mcap") as bag:
        for number in range(10):
            for topic in ("ins/imu", "reference/gyro/imu", "truth/imu"):
                bag.write(topic, imu(factory, number), START_NS + number * PERIOD_NS)
    messages = []
    subscribe(live, "ins/imu", Imu, messages)
    printed = live.play(tmp_path / "in.mcap", "--wait-timeout", "50")
    assert "no subscriber of /reference/gyro/imu; playing nevertheless" in printed
    assert "no match" not in printed
    assert live.observer.spin_until(lambda: len(messages) == 10)


def test_each_loop_takes_the_clock_back_once(live, tmp_path):
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu

    times, messages = [], []
    subscribe(live, "/clock", Clock, times)
    subscribe(live, "ins/imu", Imu, messages)
    live.play(make_bag(tmp_path / "in.mcap", 100), "--loop", "3", "--rate", "5")
    assert live.observer.spin_until(lambda: len(messages) == 300)
    clock_ns = [ns(message) for message in times]
    assert sum(later < earlier for earlier, later in itertools.pairwise(clock_ns)) == 2
    # The clock starts before the first message and goes past the last, in each loop.
    assert min(clock_ns) < START_NS
    assert max(clock_ns) > START_NS + 99 * PERIOD_NS + LATENCY_NS
    assert [message.angular_velocity.x for message in messages] == [float(n) for n in range(100)] * 3


def test_pause_step_and_resume_by_services(live, tmp_path):
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu

    times, messages = [], []
    subscribe(live, "/clock", Clock, times)
    subscribe(live, "ins/imu", Imu, messages)
    source = make_bag(tmp_path / "in.mcap", 50)
    expected = ["--wait-for-subscribers", "ins/imu", "/clock"]
    player = live.start(*PLAY, str(source), "--paused", "--topics", "ins/imu", *expected)
    # While paused a step plays one message, and the clock is constant and published repeatedly.
    for number in range(3):
        assert call(live, "play_next").success
        assert live.observer.spin_until(lambda count=number + 1: len(messages) == count)
    third_ns = START_NS + 2 * PERIOD_NS + LATENCY_NS
    assert live.observer.spin_until(lambda: [ns(m) > third_ns - CLOCK_PERIOD_NS for m in times[-3:]] == [True] * 3)
    assert len({ns(message) for message in times[-3:]}) == 1
    assert len(messages) == 3
    assert call(live, "toggle_paused").message == "playing"
    refusal = call(live, "play_next")
    assert (refusal.success, refusal.message) == (False, "playing: pause first")
    assert live.observer.spin_until(lambda: player.exit_code is not None)
    assert player.exit_code == 0, player.log_text()
    assert live.observer.spin_until(lambda: len(messages) == 50)
    assert [message.angular_velocity.x for message in messages] == [float(n) for n in range(50)]


def test_offset_filter_and_remap(live, tmp_path):
    from sensor_msgs.msg import Imu

    renamed, original, truth = [], [], []
    subscribe(live, "other/imu", Imu, renamed)
    subscribe(live, "ins/imu", Imu, original)
    subscribe(live, "truth/imu", Imu, truth)
    source = make_bag(tmp_path / "in.mcap", 100)
    options = ["--start-offset", "0.6", "--topics", "ins/imu", "--remap", "ins/imu:=other/imu"]
    assert "play: 40 messages" in live.play(source, *options)
    assert live.observer.spin_until(lambda: len(renamed) == 40)
    assert [message.angular_velocity.x for message in renamed] == [float(n) for n in range(60, 100)]
    assert (original, truth) == ([], [])


def test_a_type_that_is_missing_or_different_is_skipped(live, tmp_path):
    from sensor_msgs.msg import Imu

    message_store().register(get_types_from_msg("float64 x", "other_msgs/msg/Thing"))
    factory = RosbagsFactory()
    with BagWriter(tmp_path / "good.mcap") as bag:
        bag.write("ins/imu", imu(factory, 7), START_NS)
        bag.write("thing", factory.make("other_msgs/msg/Thing", x=1.0), START_NS)
    received = []
    subscribe(live, "ins/imu", Imu, received)
    printed = live.play(tmp_path / "good.mcap")
    assert "topic 'thing' is not played: message type other_msgs/msg/Thing is not installed" in printed
    assert live.observer.spin_until(lambda: len(received) == 1)

    # A definition of std_msgs/Float64 whose field has another name and another size.
    with open(tmp_path / "changed.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float32 value")
        channel = writer.register_channel("number", "cdr", schema)
        writer.add_message(channel, START_NS, b"\x00\x01\x00\x00" + struct.pack("<f", 1.0), START_NS)
        writer.finish()
    player = live.start(*PLAY, str(tmp_path / "changed.mcap"), "--wait-timeout", "0")
    assert player.wait(30) == 2
    assert "std_msgs/msg/Float64.value is unknown to this suite" in player.log_text()
    assert "none of its topics can be played" in player.log_text()


# -- bad input and bad ends -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["absent.mcap"], "absent.mcap: no such file"),
        (["in.mcap", "--topics", "gnss/fix"], "in.mcap: has no topic 'gnss/fix' to play; it has ins/imu, truth/imu"),
        (["in.mcap", "--start-offset", "5"], "in.mcap: a start offset of 5.0 s is past its end at 0.090 s"),
        (["in.mcap", "--rate", "0"], "argument --rate: 0 is not a positive number"),
        (["in.mcap", "--rate", "nan"], "argument --rate: nan is not a positive number"),
        (["in.mcap", "--remap", "a=b"], "argument --remap: 'a=b' is not of the form OLD:=NEW"),
        (["in.mcap", "--wait-for-subscribers", "gnss/fix"], "topic '/gnss/fix' is not played"),
        (
            ["in.mcap", "--wait-for-subscribers", "ins/imu=2", "--wait-timeout", "0.2"],
            "no match after 0.2 s with the subscribers of /ins/imu",
        ),
    ],
)
def test_play_refuses_in_one_line(live, tmp_path, options, expected):
    make_bag(tmp_path / "in.mcap", 10)
    player = live.start(*PLAY, *(str(tmp_path / option) if option.endswith(".mcap") else option for option in options))
    assert player.wait(30) == 2
    lines = player.log_text().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("play: ")
    assert expected in lines[0]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--out", "there.mcap"], "there.mcap: already exists: use --force to overwrite"),
        (["--out", "absent/out.mcap"], "absent/out.mcap: cannot be written: there is no folder"),
        (["--out", "new.mcap", "--flush-period-s", "-1"], "argument --flush-period-s: -1 is not a positive number"),
        ([], "the following arguments are required: --out"),
    ],
)
def test_record_refuses_in_one_line(live, tmp_path, options, expected):
    make_bag(tmp_path / "there.mcap", 1)
    before = (tmp_path / "there.mcap").read_bytes()
    recorder = live.start(*RECORD, *(str(tmp_path / o) if o.endswith(".mcap") else o for o in options))
    assert recorder.wait(30) == 2
    lines = recorder.log_text().splitlines()
    assert len(lines) == 1, lines
    assert expected in lines[0]
    assert (tmp_path / "there.mcap").read_bytes() == before


@pytest.mark.parametrize("command", [[*PLAY, "in.mcap"], [*RECORD, "--out", "out.mcap"]], ids=["play", "record"])
def test_play_and_record_refuse_to_run_unprotected(live, tmp_path, command):
    if dds_has_security(loaded_libraries()):
        pytest.skip("this DDS has security: they then start, or refuse for want of keys")
    make_bag(tmp_path / "in.mcap", 1)
    live.environment |= {"ROS_SECURITY_ENABLE": "TRUE", "ROS_SECURITY_STRATEGY": "Permissive"}
    process = live.start(*command[:-1], str(tmp_path / command[-1]))
    assert process.wait(30) == 2
    (line,) = process.log_text().splitlines()
    assert line.split(": ")[1].startswith("ROS_SECURITY_ENABLE=TRUE requests DDS security")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.smoke
def test_a_killed_recorder_has_everything_but_its_last_flush_period(live, tmp_path):
    flush_period_s = 0.5
    source = make_bag(tmp_path / "in.mcap", 2000)
    path = tmp_path / "out.mcap"
    recorder = live.start_recorder(path, "--flush-period-s", str(flush_period_s))
    player = live.start(*PLAY, str(source), "--wait-for-subscribers", "ins/imu", "truth/imu")
    assert live.observer.spin_until(lambda: path.stat().st_size > 10_000)
    os.kill(recorder.pid, signal.SIGKILL)
    killed_ns = time.time_ns()
    assert recorder.wait(10) == -signal.SIGKILL
    player.end()
    got, problems = contents(path)
    assert len(problems) == 1
    assert "no footer" in problems[0]
    numbers = [data for _, data in got["ins/imu"]]
    assert len(numbers) > 20
    # Without a gap from the first on, ...
    assert numbers == payloads(source, "ins/imu")[: len(numbers)]
    # ... up to the last flush; the same time is allowed for latency and sync on a loaded computer.
    assert killed_ns - got["ins/imu"][-1][0] < 2 * flush_period_s * 1e9


def test_a_full_disk_is_reported_and_leaves_complete_chunks(live, tmp_path):
    limit_bytes = 20_000
    source = make_bag(tmp_path / "in.mcap", 2000)
    path = tmp_path / "out.mcap"
    # A limit on the size of files replaces a full disk: the same write fails, with another errno.
    recorder = live.start_recorder(path, "--topics", "ins/imu")
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
    player = live.start(*PLAY, str(source), "--wait-for-subscribers", "ins/imu")
    assert recorder.wait(40) == 2
    player.end()
    lines = recorder.log_text().splitlines()
    assert len(lines) == 2, lines  # the first one has the path of the recording
    assert lines[1].startswith(f"record: {path}: recording failed: File too large; the file is complete up to")
    got, problems = contents(path)
    assert path.stat().st_size <= limit_bytes
    assert len(problems) == 1
    assert "damaged (" not in problems[0]
    kept = [data for _, data in got["ins/imu"]]
    assert len(kept) > 50
    assert kept == payloads(source, "ins/imu")[: len(kept)]


@pytest.mark.parametrize("options", [["--duration-s", "1"], ["--until-idle-s", "1"]])
def test_a_recording_ends_by_itself(live, tmp_path, options):
    source = make_bag(tmp_path / "in.mcap", 20)
    recorder = live.start_recorder(tmp_path / "out.mcap", *options, "--topics", "ins/imu")
    if "--until-idle-s" in options:
        live.play(source, "--wait-for-subscribers", "ins/imu")
    assert recorder.wait(30) == 0
    if "--until-idle-s" in options:
        assert len(payloads(tmp_path / "out.mcap", "ins/imu")) == 20


def test_status_messages_do_not_prolong_a_recording(live, tmp_path):
    """The real node continues to publish diagnostics, health, alignment and INVALID after the end of its input."""
    source = make_bag(tmp_path / "in.mcap", 20)
    command = [*executable("ship_attitude_star", "ship_attitude"), "--ros-args", "-p", "slow_topics_period_s:=0.1"]
    node = live.start(*command)
    recorder = live.start_recorder(tmp_path / "out.mcap", "--until-idle-s", "2.5")
    topics = ["/ins/imu", "/ship/attitude", "/diagnostics", "/input_health"]
    player_options = ["--topics", "ins/imu", "--wait-for-subscribers", "ins/imu=2"]
    assert live.observer.wait_for(subscribers=dict.fromkeys(topics, 1), timeout_s=30)
    live.play(source, *player_options)
    assert recorder.wait(40) == 0
    assert node.exit_code is None
    got, _ = contents(tmp_path / "out.mcap")
    assert len(got["ins/imu"]) == 20
    last_ns = got["ins/imu"][-1][0]
    for topic in ("diagnostics", "input_health", "ship/attitude"):
        assert any(time_ns > last_ns + 10**9 for time_ns, _ in got[topic])


@pytest.mark.parametrize(
    ("type_name", "fields", "counts"),
    [
        ("sensor_msgs/msg/Imu", {}, True),
        ("ship_msgs/msg/RtkBaseline", {}, True),
        ("ship_msgs/msg/TheodoliteEncoder", {"status": 1}, True),
        *(("ship_msgs/msg/ShipAttitude", {"status": status}, status != 3) for status in range(4)),
        *(("ship_msgs/msg/AttitudeDeg", {"status": status}, status != 3) for status in range(4)),
        *(("ship_msgs/msg/OpticalAxisPointing", {"status": status}, status != 3) for status in range(4)),
        ("tf2_msgs/msg/TFMessage", {}, False),
        *((f"ship_msgs/msg/{name}", {}, False) for name in ("InputHealth", "AlignmentState", "ErrorBudget")),
        ("ship_msgs/msg/AlertArray", {}, False),
        ("diagnostic_msgs/msg/DiagnosticArray", {}, False),
        ("rcl_interfaces/msg/Log", {}, False),
        ("rosgraph_msgs/msg/Clock", {}, False),
    ],
)
def test_activity(type_name, fields, counts):
    from rclpy.serialization import serialize_message

    kind = message_class(type_name)
    assert is_activity(type_name, kind, bytes(serialize_message(kind(**fields)))) is counts
