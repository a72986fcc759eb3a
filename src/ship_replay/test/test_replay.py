"""Replay passes a bag to an adapter in order of log time and writes the outputs."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_file import open_mcap
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter, TypeDefinition, suite_definition
from ship_bags.message_store import serialize
from ship_bags.provenance import COMMIT_RECORD, commit_record
from ship_bags.stamps import ns_from_stamp
from ship_estimation.parameters.fields import parameter
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import ARCSEC
from ship_node.health.input_health import InputHealthMonitor
from ship_node.messages.inputs_outputs import InputTopic, OutputTopic
from ship_replay.commands.replay import main
from ship_replay.offline.replay import replay
from ship_testing.hand_made_bags import FACTORY, PERIOD_NS, START_NS, imu, ship_attitude, write_imu_bag
from ship_testing.one_message import process_each
from theodolite_calib.adapters.triangulation_adapter import TriangulationAdapter

TICK_NS = 100_000_000
TRIANGULATION = """/**/triangulation:
  ros__parameters:
    origin: {latitude_deg: 32.0, longitude_deg: 120.0, height_m: 20.0}
    stations:
      east: {latitude_deg: 32.0, longitude_deg: 120.0, height_m: 20.0}
      west: {latitude_deg: 32.0, longitude_deg: 119.999, height_m: 20.0}
"""
IMU = "sensor_msgs/msg/Imu"
SUITE = "/**/tiny:\n  ros__parameters:\n    error_arcsec: 2.0\n"


@dataclass(frozen=True)
class TinyConfig:
    error_arcsec: float = parameter(0.0, doc="added to the heading", unit="arcsec", minimum=0.0, maximum=10.0)


class TinyAdapter:
    """Imu in, attitude with the same stamp out, with a known error; records each call."""

    node_name = "tiny"
    config_type = TinyConfig
    block_topics = frozenset()
    calls = ()

    def __init__(self, config, factory, files=None):
        self.config, self.factory = config, factory
        self.inputs = (
            InputTopic("ins/imu", "sensor_msgs/msg/Imu", required=True, depth=100),
            InputTopic("reference/b/imu", "sensor_msgs/msg/Imu", required=False, depth=100),
        )
        self.outputs = (
            OutputTopic("ship/attitude", "ship_msgs/msg/ShipAttitude"),
            OutputTopic("ship/error_arcsec", "ship_msgs/msg/AttitudeErrorArcsec"),
        )
        self.health = InputHealthMonitor(self.inputs)
        self.latest_header = None
        TinyAdapter.calls = []

    def process(self, batch):
        return process_each(batch, self.add, self.tick)

    def add(self, arrival):
        topic, message, receive_ns = arrival.topic, arrival.message, arrival.receive_ns
        self.calls.append((topic, receive_ns))
        self.health.record_arrival(topic, receive_ns)
        if message.header.frame_id == "wrong":
            self.health.record_rejected(topic, Rejection(Reason.FRAME, "wrong frame"), receive_ns)
            return []
        self.health.record_accepted(topic, ns_from_stamp(message.header.stamp), receive_ns)
        self.latest_header = message.header
        heading = true_heading(ns_from_stamp(message.header.stamp)) + self.config.error_arcsec * ARCSEC
        return [("ship/attitude", ship_attitude(ns_from_stamp(message.header.stamp), heading, factory=self.factory))]

    def tick(self, now_ns, waiting_ns=None):
        self.calls.append(("tick", now_ns))
        if self.latest_header is None:
            return []
        fields = {f"{kind}_{angle}": np.nan for kind in ("sigma", "error") for angle in ("heading", "pitch", "roll")}
        message = self.factory.make("ship_msgs/msg/AttitudeErrorArcsec", header=self.latest_header, **fields)
        return [("ship/error_arcsec", message)]


def true_heading(stamp_ns):
    """Return a heading with a swing of 4° about North in 11 s: linear interpolation at 10 Hz would err by 5.9″."""
    return np.deg2rad(4.0) * np.sin(2 * np.pi * (stamp_ns - START_NS) * 1e-9 / 11.0) % (2 * np.pi)


def true_rate(stamp_ns):
    return np.deg2rad(4.0) * 2 * np.pi / 11.0 * np.cos(2 * np.pi * (stamp_ns - START_NS) * 1e-9 / 11.0)


def write_bag_with_truth(path, count=500):
    """Write Imu at 100 Hz, and truth at 10 Hz that is logged later than the Imu of the same stamp."""
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", SUITE)
        bag.add_metadata("simulation", {"seed": "1"})
        for number in range(count):
            stamp_ns = START_NS + number * PERIOD_NS
            bag.write("ins/imu", imu(stamp_ns), stamp_ns)
            if number % 10 == 0:
                truth = ship_attitude(stamp_ns, true_heading(stamp_ns))
                truth.angular_velocity.z = -true_rate(stamp_ns)  # heading is clockwise, z is up
                bag.write("truth/attitude", truth, stamp_ns + 5_000_000)
    return path


def outputs(path, topic):
    with read_bag(path) as bag:
        return [(record.log_time_ns, record.decode()) for record in bag.records({topic})]


def test_messages_and_ticks_come_in_order(tmp_path):
    bag = write_imu_bag(tmp_path / "in.mcap", 25, attachments=[("suite.yaml", SUITE)])
    summary = replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    # The bag runs from .050 to .290: the grid passes .100 and .200, each before the message that passes it.
    expected = [("ins/imu", START_NS + number * PERIOD_NS) for number in range(25)]
    expected.insert(15, ("tick", START_NS + 150_000_000))
    expected.insert(5, ("tick", START_NS + 50_000_000))
    assert TinyAdapter.calls == expected
    assert summary.inputs == {"ins/imu": 25}
    assert summary.outputs == {"ship/attitude": 25, "ship/error_arcsec": 2}
    assert summary.absent == ["reference/b/imu"]


def test_outputs_carry_the_log_time_of_what_caused_them(tmp_path):
    bag = write_imu_bag(tmp_path / "in.mcap", 25, attachments=[("suite.yaml", SUITE)])
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    assert [time for time, _ in outputs(tmp_path / "out.mcap", "ship/attitude")] == [
        START_NS + number * PERIOD_NS for number in range(25)
    ]
    errors = outputs(tmp_path / "out.mcap", "ship/error_arcsec")
    assert [time for time, _ in errors] == [START_NS + 50_000_000, START_NS + 150_000_000]


def test_ticks_end_after_a_long_gap(tmp_path):
    path = tmp_path / "in.mcap"
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", SUITE)
        for log_time_ns in (START_NS, START_NS + 4 * 10**17):
            bag.write("ins/imu", imu(START_NS), log_time_ns)
    replay(path, tmp_path / "out.mcap", (TinyAdapter,))
    assert [name for name, _ in TinyAdapter.calls].count("tick") == 6000
    assert TinyAdapter.calls[-1] == ("ins/imu", START_NS + 4 * 10**17)


def test_the_same_bag_gives_the_same_bytes(tmp_path):
    bag = write_bag_with_truth(tmp_path / "in.mcap")
    for name in ("a.mcap", "b.mcap"):
        replay(bag, tmp_path / name, (TinyAdapter,))
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_truth_and_marks_are_copied(tmp_path):
    bag = write_bag_with_truth(tmp_path / "in.mcap")
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    with read_bag(bag) as first, read_bag(tmp_path / "out.mcap") as second:
        kept = [[(r.log_time_ns, r.data) for r in b.records({"truth/attitude"})] for b in (first, second)]
        assert len(kept[0]) == 50
        assert kept[0] == kept[1]
        assert second.attachments == {"suite.yaml": SUITE.encode()}
        assert second.metadata == {"simulation": {"seed": "1"}, COMMIT_RECORD: commit_record()}


def test_errors_are_filled_in_from_the_truth(tmp_path):
    bag = write_bag_with_truth(tmp_path / "in.mcap")
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    filled = [message for _, message in outputs(tmp_path / "out.mcap", "ship/error_arcsec")]
    assert len(filled) == 50
    # The stamps of the errors lie between two stamps of the truth; a cubic over 0.1 s errs by 4e-4 arcsec here.
    np.testing.assert_allclose([message.error_heading for message in filled[:-1]], 2.0, atol=1e-3)
    np.testing.assert_allclose([message.error_pitch for message in filled[:-1]], 0.0, atol=1e-6)
    # The last message has a stamp after the end of the truth.
    assert np.isnan(filled[-1].error_heading)


def test_errors_stay_nan_without_truth(tmp_path):
    bag = write_imu_bag(tmp_path / "in.mcap", 50, attachments=[("suite.yaml", SUITE)])
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    assert all(np.isnan(message.error_heading) for _, message in outputs(tmp_path / "out.mcap", "ship/error_arcsec"))


@pytest.mark.parametrize(
    ("topic", "namespace"), [("/ins/imu", ""), ("/ship/ins/imu", "ship"), ("/ship/ins/imu", "/ship/"), ("ins/imu", "")]
)
def test_topics_of_any_namespace(tmp_path, topic, namespace):
    bag = write_imu_bag(tmp_path / "in.mcap", 10, topic, attachments=[("suite.yaml", SUITE)])
    assert replay(bag, tmp_path / "out.mcap", (TinyAdapter,), namespace=namespace).inputs == {"ins/imu": 10}


def test_rejected_and_noted_messages_are_two_lists(tmp_path, capsys):
    """A message without covariance is used with a note; one with another frame is rejected."""
    path = tmp_path / "in.mcap"
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", "/**/ship_attitude:\n  ros__parameters: {ins: {frame_id: ins}}\n")
        for number, frame in enumerate(["ins", "ins", "mast", "ins"]):
            stamp_ns = START_NS + number * 10_000_000
            bag.write("ins/imu", imu(stamp_ns, frame), stamp_ns)
    assert main([str(path), "--out", str(tmp_path / "out.mcap")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "rejected: ins/imu: frame 1" in lines
    assert "noted: ins/imu: covariance_unknown 3" in lines


def test_rejections_and_undecodable_messages_are_counted(tmp_path):
    path = tmp_path / "in.mcap"
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", SUITE)
        bag.write("ins/imu", imu(START_NS), START_NS)
        bag.write("ins/imu", imu(START_NS + 1, "wrong"), START_NS + 1)
        bag.write_raw("ins/imu", "sensor_msgs/msg/Imu", serialize(imu(START_NS))[:40], START_NS + 2)
    summary = replay(path, tmp_path / "out.mcap", (TinyAdapter,))
    assert summary.rejected == {"ins/imu": {"frame": 1}}
    assert summary.undecodable == {"ins/imu": 1}
    assert summary.inputs == {"ins/imu": 2}


def write_bag_with_definition(path, change, extra=b""):
    """Write five INS samples with a changed definition of their type, and with more bytes at their end."""

    def define(type_name):
        text, type_hash = suite_definition(type_name)
        return TypeDefinition(change(text) if type_name == IMU else text, type_hash)

    with BagWriter(path, define=define) as bag:
        bag.add_attachment("suite.yaml", SUITE)
        for number in range(5):
            stamp_ns = START_NS + number * PERIOD_NS
            bag.write_raw("ins/imu", IMU, serialize(imu(stamp_ns, heading=1e-3 * number)) + extra, stamp_ns)
    return path


def test_an_additional_field_of_an_input_is_accepted(tmp_path):
    """The definition of a later or extended message has all fields of the suite's."""
    rule = "=" * 80
    bag = write_bag_with_definition(
        tmp_path / "in.mcap", lambda text: text.replace(rule, f"float64 more\n{rule}", 1), np.array([7.0]).tobytes()
    )
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    usual = write_imu_bag(tmp_path / "plain.mcap", 5, attachments=[("suite.yaml", SUITE)])
    replay(usual, tmp_path / "usual.mcap", (TinyAdapter,))
    with read_bag(bag) as found:
        assert found.differences == {IMU: [f"{IMU}.more is unknown to this suite"]}
    published = []
    for name in ("out.mcap", "usual.mcap"):
        with read_bag(tmp_path / name) as found:
            published.append([(record.log_time_ns, record.data) for record in found.records({"ship/attitude"})])
    assert len(published[0]) == 5
    assert published[0] == published[1]


def test_a_field_that_an_input_lacks_is_refused(tmp_path):
    bag = write_bag_with_definition(tmp_path / "in.mcap", lambda text: text.replace("angular_velocity\n", "rate\n", 1))
    with pytest.raises(BadInput, match=r"topic 'ins/imu': sensor_msgs/msg/Imu\.angular_velocity is missing in the bag"):
        replay(bag, tmp_path / "out.mcap", (TinyAdapter,))


def test_a_configuration_given_rules_over_the_attached_one(tmp_path):
    config = tmp_path / "mine.yaml"
    config.write_text(SUITE.replace("2.0", "5.0"))
    bag = write_bag_with_truth(tmp_path / "in.mcap", 100)
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,), config)
    with read_bag(tmp_path / "out.mcap") as out:
        assert b"5.0" in out.attachments["suite.yaml"]
    assert outputs(tmp_path / "out.mcap", "ship/error_arcsec")[0][1].error_heading == pytest.approx(5.0, abs=1e-3)


class TestBadInput:
    def assert_refused(self, tmp_path, bag, match, **options):
        with pytest.raises(BadInput, match=match):
            replay(bag, tmp_path / "out.mcap", (TinyAdapter,), **options)
        assert not list(tmp_path.glob("out.mcap*"))

    def test_required_topic_missing(self, tmp_path):
        bag = write_imu_bag(tmp_path / "in.mcap", 5, "compass", attachments=[("suite.yaml", SUITE)])
        advice = "sensor_msgs/Imu on compass: --remap compass:=ins/imu"
        self.assert_refused(tmp_path, bag, rf"in\.mcap: required topics ins/imu are missing; found compass; {advice}$")

    def test_required_topic_in_a_namespace(self, tmp_path):
        bag = write_imu_bag(tmp_path / "in.mcap", 5, "/ship/ins/imu", attachments=[("suite.yaml", SUITE)])
        self.assert_refused(tmp_path, bag, "under the namespace 'ship': give --namespace ship")

    def test_wrong_type(self, tmp_path):
        path = tmp_path / "in.mcap"
        with BagWriter(path) as bag:
            bag.add_attachment("suite.yaml", SUITE)
            bag.write("ins/imu", ship_attitude(START_NS), START_NS)
        self.assert_refused(
            tmp_path, path, "topic 'ins/imu' is ship_msgs/msg/ShipAttitude: expected sensor_msgs/msg/Imu"
        )

    def test_no_configuration(self, tmp_path):
        bag = write_imu_bag(tmp_path / "in.mcap", 5)
        self.assert_refused(tmp_path, bag, r"no configuration suite\.yaml is attached to the bag: give one by --config")

    def test_unknown_parameter_in_the_attached_configuration(self, tmp_path):
        bag = write_imu_bag(tmp_path / "in.mcap", 5, attachments=[("suite.yaml", SUITE + "    gain: 1.0\n")])
        self.assert_refused(tmp_path, bag, r"in\.mcap: attachment suite\.yaml: .*:4: parameter 'gain' is unknown")

    def test_topics_without_a_message(self, tmp_path):
        bag = tmp_path / "in.mcap"
        with BagWriter(bag) as writer:
            writer.add_attachment("suite.yaml", SUITE)
            writer.add_topic("ins/imu", "sensor_msgs/msg/Imu", False)
            writer.write("compass", imu(START_NS), START_NS)
        self.assert_refused(tmp_path, bag, r"in\.mcap: no message of ins/imu could be read$")

    def test_inputs_that_may_be_missing_are_named_where_all_are(self, tmp_path):
        """The bag is in a namespace that was not given."""
        bag = tmp_path / "in.mcap"
        with BagWriter(bag) as writer:
            writer.add_attachment("suite.yaml", TRIANGULATION)
            writer.write("/fleet/west/theodolite/target_direction", imu(START_NS), START_NS)
        text = r"no message of east/theodolite/target_direction, west/.* could be read; .*--namespace"
        with pytest.raises(BadInput, match=text):
            replay(bag, tmp_path / "out.mcap", (TriangulationAdapter,))

    def test_output_over_the_input(self, tmp_path):
        bag = write_imu_bag(tmp_path / "in.mcap", 5, attachments=[("suite.yaml", SUITE)])
        before = bag.read_bytes()
        with pytest.raises(BadInput, match="would overwrite the input"):
            replay(bag, bag, (TinyAdapter,))
        assert bag.read_bytes() == before


class TestCommand:
    """The command with the real adapter."""

    SUITE = "ship_attitude:\n  ros__parameters:\n    ins:\n      frame_id: ins\n"

    @pytest.mark.slow
    @pytest.mark.parametrize("namespace", ["", "vessel", "ship"])
    def test_replays_and_reports(self, tmp_path, capsys, namespace):
        bag = tmp_path / "in.mcap"
        with BagWriter(bag) as writer:
            writer.add_attachment("suite.yaml", "/**/" + self.SUITE)
            for number in range(300):
                stamp_ns = START_NS + number * PERIOD_NS
                writer.write(f"{namespace}/ins/imu", imu(stamp_ns), stamp_ns)
                if number % 10 == 0:
                    writer.write(f"{namespace}/truth/attitude", ship_attitude(stamp_ns), stamp_ns)
        out = tmp_path / "out.mcap"
        arguments = ["--out", str(out), "--report", str(tmp_path / "report"), "--namespace", namespace]
        assert main([str(bag), *arguments]) == 0
        printed = capsys.readouterr().out
        assert "in:  ins/imu 300" in printed
        assert "x real time)" in printed
        attitudes = [message for _, message in outputs(out, "ship/attitude")]
        assert [ns_from_stamp(message.header.stamp) for message in attitudes] == [
            START_NS + number * PERIOD_NS for number in range(300)
        ]
        assert {path.name for path in (tmp_path / "report").iterdir()} == {"out.html", "out.json"}
        numbers = json.loads((tmp_path / "report" / "out.json").read_text())
        # The INS alone, whose messages only the replayed bag contains, is compared, too.
        assert {"fused.heading.rms_arcsec", "ins.heading.rms_arcsec"} <= set(numbers)
        text = (tmp_path / "report" / "out.html").read_text()
        assert "<td>fused</td>" in text
        assert "<td>ins</td>" in text
        with read_bag(out) as replayed:
            names = {topic.topic for topic in ShipAttitudeAdapter.outputs}
            assert names <= set(replayed.topics)

    def test_bad_input_is_one_line_and_two(self, tmp_path, capsys):
        assert main([str(tmp_path / "none.mcap"), "--out", str(tmp_path / "out.mcap")]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert lines == [f"replay: {tmp_path / 'none.mcap'}: no such file or folder"]

    def test_a_bag_whose_only_chunk_is_damaged_is_one_line_and_two(self, tmp_path, capsys):
        bag = write_imu_bag(tmp_path / "in.mcap", 50, attachments=[("suite.yaml", self.SUITE)])
        file = open_mcap(bag)
        file.data.stream.close()
        (place,) = file.chunks
        data = bytearray(bag.read_bytes())
        middle = place.offset + place.length // 2
        data[middle : middle + 200] = bytes(200)
        bag.write_bytes(data)
        assert main([str(bag), "--out", str(tmp_path / "out.mcap")]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        (line,) = printed.err.splitlines()
        assert line.startswith(f"replay: {bag}: the bag holds no messages that can be read (in.mcap: the chunk at byte")
        assert not list(tmp_path.glob("out.mcap*"))

    def test_wrong_usage_is_one_line_and_two(self, capsys):
        with pytest.raises(SystemExit) as caught:
            main(["--speed", "2"])
        assert caught.value.code == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_factory_messages_are_written_as_they_are(tmp_path):
    """The adapter's messages come from the factory and are not changed."""
    bag = write_bag_with_truth(tmp_path / "in.mcap", 20)
    replay(bag, tmp_path / "out.mcap", (TinyAdapter,))
    expected = ship_attitude(START_NS, true_heading(START_NS) + 2.0 * ARCSEC, factory=FACTORY)
    with read_bag(tmp_path / "out.mcap") as out:
        assert next(out.records({"ship/attitude"})).data == serialize(expected)
