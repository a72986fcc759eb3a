"""replay --verify on black boxes: complete, changed in one bit, cut, damaged, of other nodes."""

import json
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
import yaml
from mcap.records import Attachment, Message, Metadata, Schema

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_file import open_mcap
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_store import message_store
from ship_estimation.rejection_rules import Reason
from ship_node.messages.common_messages import INTEGRITY_TYPE
from ship_node.saved_files.saved_start import SavedStart
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.replay import main
from ship_simulation.inject_command import main as inject
from ship_testing.black_boxes import FORMAT, OPTICAL_AXIS, SHIP_ATTITUDE, make_black_box, write_changed_copy
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

ATTITUDE = "ship_msgs/msg/ShipAttitude"


@pytest.fixture(scope="module")
def black_box(tmp_path_factory):
    folder = tmp_path_factory.mktemp("box")
    return make_black_box(folder / "box.mcap", folder / "alignment.yaml").path


def verify(capsys, *arguments):
    """Return exit code, stdout and stderr of ``replay --verify``."""
    code = main([*map(str, arguments), "--verify"])
    out, err = capsys.readouterr()
    return code, out, err


def error_text(capsys, *arguments):
    """Return the one-line error of exit code 2."""
    code, _, err = verify(capsys, *arguments)
    assert code == 2
    assert err.count("\n") == 1
    return err


def test_a_whole_black_box_is_equal_to_the_last_bit(black_box, capsys):
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    # 8 s at 100 Hz and 300 messages more after the clock went back; 2 accepted parameter changes, one refused by the
    # adapter and one refused by the node.
    events = "clock jump back 1", "parameters 3", "parameters refused 1"
    for used in (*events, "~/save_alignment 1", "~/reset 1", "~/load_alignment 1"):
        assert used in out
    assert "outputs are equal to the last bit" in out
    assert "verified up to this point" not in out
    assert "note" not in out


def test_a_black_box_of_several_files_is_equal_to_the_last_bit(tmp_path, capsys):
    """The first file is given; a later one by itself is refused with the name of the first."""
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "alignment.yaml", part_bytes=1).path
    assert (tmp_path / "box.part2.mcap").is_file()
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    assert "outputs are equal to the last bit" in out
    assert "note" not in out
    expected = "part 2 of a black box: give its first file, box.mcap, with all parts in its folder"
    assert expected in error_text(capsys, tmp_path / "box.part2.mcap")
    (tmp_path / "box.part2.mcap").unlink()
    code, out, _ = verify(capsys, black_box)
    assert code == 1
    assert "entries are missing before" in out


def test_a_black_box_of_the_optical_axis_is_equal_to_the_last_bit(tmp_path, capsys):
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "calibration.yaml", node=OPTICAL_AXIS).path
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    for used in ("clock jump back 1", "parameters 3", "~/save_alignment 1", "~/reset 1", "~/load_alignment 1"):
        assert used in out
    # 8 s at 50 Hz, and the repeated pointings after the clock jumped back.
    pointings = int(re.search(r"theodolite/pointing (\d+)", out).group(1))
    assert pointings > 400
    # Once a second, and again after the clock jumped back.
    assert int(re.search(r"theodolite/escort (\d+)", out).group(1)) >= 8
    assert "outputs are equal to the last bit" in out
    text = (tmp_path / "calibration.yaml").read_text()
    assert text.startswith("format: optical_axis calibration")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("node", "fault", "source"),
    [
        (SHIP_ATTITUDE, "topic: star/fore/horizon_attitude, kind: knock, right_arcsec: 80.0", "star.fore"),
        (OPTICAL_AXIS, "topic: beacon/a/baseline, kind: wrong_fix, up_m: 2.0", "beacon.a"),
    ],
    ids=["ship_attitude", "optical_axis"],
)
def test_a_black_box_with_an_exclusion_is_equal_to_the_last_bit(node, fault, source, tmp_path, capsys):
    faults, hit = tmp_path / "faults.yaml", tmp_path / "hit.mcap"
    faults.write_text(f"faults: {{one: {{{fault}, start_s: 3.0}}}}")
    assert inject([str(node.bag), "--faults", str(faults), "--out", str(hit)]) == 0
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "saved.yaml", node=replace(node, bag=hit)).path
    with read_bag(black_box) as bag:
        (topic,) = (name for name, type_name in bag.topics.items() if type_name == INTEGRITY_TYPE)
        excluded = [name for record in bag.records([topic]) for name in record.decode().excluded]
    assert set(excluded) == {source}
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    assert "outputs are equal to the last bit" in out


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship_attitude", "optical_axis"])
def test_a_black_box_records_the_waiting_time_for_timeouts(node, tmp_path, capsys):
    """The node's clock is put forward during 2.2 s without messages, and back later."""

    def node_ns(waiting_ns):
        return waiting_ns + (700_000_000 if 3_500_000_000 < waiting_ns < 6_000_000_000 else 0)

    def is_lost(waiting_ns):
        return 3_000_000_000 < waiting_ns < 5_200_000_000

    black_box = make_black_box(
        tmp_path / "box.mcap", tmp_path / "saved.yaml", node=node, node_ns=node_ns, is_lost=is_lost
    ).path
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    topic = node.adapter_class.outputs[0].topic
    with read_bag(black_box) as bag:
        start_ns = bag.start_ns
        given = [r for r in bag.records_in_file_order() if r.topic == topic]
        invalid = [r for r in given if r.decode().status == 3 and r.log_time_ns - start_ns > 1_000_000_000]
    # No data from 3 s on; INVALID is published within a second and a tick, and once more a second later.
    invalid_s = [(r.log_time_ns - start_ns) * 1e-9 - 0.7 for r in invalid]
    assert len(invalid_s) == 2
    assert 3.95 < invalid_s[0] <= 4.1
    assert invalid_s[1] - invalid_s[0] == pytest.approx(1.0)

    def without_waiting(record, topics):
        return replace(record, publish_time=record.log_time) if isinstance(record, Message) else record

    code, out, _ = verify(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", without_waiting))
    assert code == 1
    assert f"first difference: {topic}" in out


NEWER = {
    ShipAttitudeAdapter: {"ship/attitude_deg", "/tf", "/tf_static"},
    OpticalAxisAdapter: {"/tf"},
}


def older_release(kind):
    """Return the adapter class of a release that did not publish the newer topics."""
    newer = NEWER[kind]

    class Older(kind):
        __module__ = kind.__module__  # its package is the same
        outputs = tuple(output for output in kind.outputs if output.topic not in newer)

        def process_message(self, *arguments):
            return [published for published in super().process_message(*arguments) if published[0] not in newer]

        def tick(self, *arguments):
            return [published for published in super().tick(*arguments) if published[0] not in newer]

    return Older


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship", "axis"])
def test_a_black_box_of_a_node_that_was_behind_is_equal_to_the_last_bit(tmp_path, capsys, node):
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "saved.yaml", node=node, is_overloaded=True).path
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    assert "overload 2" in out
    with read_bag(black_box) as bag:
        topic, start_ns = node.adapter_class.outputs[0].topic, bag.start_ns
        given = [(r.log_time_ns - start_ns, r.decode().status) for r in bag.records({topic})]
    behind = [status for time_ns, status in given if 6_510_000_000 < time_ns < 7_790_000_000]
    # INVALID is published when the overload is detected (at 6.5 s), and then once a second: here at 7.5 s.
    assert behind == [3]
    assert {status for time_ns, status in given if time_ns > 7_820_000_000} != {3}


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship", "axis"])
def test_a_black_box_from_before_a_topic_was_published_is_equal_to_the_last_bit(tmp_path, capsys, node):
    black_box = tmp_path / "box.mcap"
    make_black_box(
        black_box, tmp_path / "saved.yaml", node=replace(node, adapter_class=older_release(node.adapter_class))
    )
    with read_bag(black_box) as bag:
        assert not NEWER[node.adapter_class] & set(bag.topics)
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    assert "outputs are equal to the last bit" in out
    assert "/tf" not in out


def test_the_saved_file_is_not_written_again(black_box, capsys):
    path = black_box.with_name("alignment.yaml")
    before = path.stat().st_mtime_ns
    path.rename(path.with_suffix(".moved"))
    try:
        assert verify(capsys, black_box)[0] == 0
        assert not path.exists()
    finally:
        path.with_suffix(".moved").rename(path)
    assert path.stat().st_mtime_ns == before


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship_attitude", "optical_axis"])
def test_what_a_node_saves_by_itself_is_replayed_and_not_written_again(tmp_path, capsys, node):
    saved = tmp_path / "saved.yaml"
    black_box = make_black_box(tmp_path / "box.mcap", saved, node=node, autosave_s=1.0).path
    with read_bag(black_box) as bag:
        assert len([name for name in bag.attachments if name.startswith("files/")]) > 6
    saved.unlink()
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    assert "outputs are equal to the last bit" in out
    assert "note" not in out
    assert not saved.exists()


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship_attitude", "optical_axis"])
def test_a_node_that_did_not_save_by_itself_yet_is_not_expected_to_have_saved(tmp_path, capsys, monkeypatch, node):
    """The black box lacks the autosave period, whose default is a minute; here a minute passes within a second."""
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "saved.yaml", node=node).path

    def without_the_parameter(record, _topics):
        if not isinstance(record, Attachment) or record.name != SUITE_ATTACHMENT:
            return record
        data = re.sub(rb'(?m)^ *"alignment_autosave_s": .*\n', b"", record.data)
        assert data != record.data
        return replace(record, data=data)

    is_time = SavedStart.is_autosave_time
    monkeypatch.setattr(SavedStart, "is_autosave_time", lambda self, ns, period_s: is_time(self, ns, period_s / 60.0))
    code, out, _ = verify(capsys, write_changed_copy(black_box, tmp_path / "old.mcap", without_the_parameter))
    assert code == 0, out
    assert "outputs are equal to the last bit" in out
    suite = tmp_path / "suite.yaml"
    with read_bag(black_box) as bag:
        values = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT].decode())
    (section,) = values.values()
    for period_s, same in ((None, True), (0.0, True), (60.0, False)):
        section["ros__parameters"].pop("alignment_autosave_s", None)
        section["ros__parameters"] |= {} if period_s is None else {"alignment_autosave_s": period_s}
        suite.write_text(yaml.safe_dump(values), encoding="utf-8")
        code, out, _ = verify(capsys, tmp_path / "old.mcap", "--config", suite)
        assert (code == 0) is same, out


UNSET_INPUTS = {
    ShipAttitudeAdapter: (("ins/imu",), ("ins",)),
    OpticalAxisAdapter: (("beacon/a/imu", "beacon/b/imu"), ("beacons.a.imu", "beacons.b.imu")),
}
"""Inputs of type sensor_msgs/Imu, and the groups of their parameters."""


def without_an_orientation(node, folder):
    """Return a copy of the node's bag: from 3 s on, orientation covariances of its Imu inputs begin with -1."""
    faults, hit = folder / "faults.yaml", folder / "hit.mcap"
    unset = "kind: corrupt, field: 'orientation_covariance[0]', value: -1.0, start_s: 3.0"
    topics = enumerate(UNSET_INPUTS[node.adapter_class][0])
    faults.write_text(f"faults: {{{', '.join(f'of_{n}: {{topic: {topic}, {unset}}}' for n, topic in topics)}}}")
    assert inject([str(node.bag), "--faults", str(faults), "--out", str(hit)]) == 0
    return hit


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship_attitude", "optical_axis"])
def test_a_black_box_with_refused_orientations_is_equal_to_the_last_bit(tmp_path, capsys, node):
    hit = without_an_orientation(node, tmp_path)
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "saved.yaml", node=replace(node, bag=hit)).path
    with read_bag(black_box) as bag:
        (topic,) = (name for name, type_name in bag.topics.items() if type_name == "ship_msgs/msg/Innovation")
        assert "not_given" in {Reason(record.decode().reason).word for record in bag.records([topic])}
    code, out, _ = verify(capsys, black_box)
    assert code == 0, out
    assert "outputs are equal to the last bit" in out


@pytest.mark.slow
@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship_attitude", "optical_axis"])
def test_a_black_box_from_before_orientations_were_refused_is_replayed_as_recorded(tmp_path, capsys, node):
    """Older nodes used orientations with unset covariance, and stated no covariance of the rates in ship/imu."""
    hit = without_an_orientation(node, tmp_path)
    parameters = {f"{group}.accept_unset_covariance": True for group in UNSET_INPUTS[node.adapter_class][1]}
    parameters |= {"ins.rate_sigma_arcsec_per_s": 4.0} if node is SHIP_ATTITUDE else {}
    like_then = replace(node, bag=hit, parameters={**node.parameters, **parameters})
    black_box = make_black_box(tmp_path / "box.mcap", tmp_path / "saved.yaml", node=like_then).path

    def as_recorded_then(record, topics):
        if isinstance(record, Attachment) and record.name == SUITE_ATTACHMENT:
            data = re.sub(rb'(?m)^ *"accept_unset_covariance": .*\n', b"", record.data)
            assert data != record.data
            return replace(record, data=data)
        if isinstance(record, Message) and topics[record.channel_id] == "ship/imu":
            store, kind = message_store(), "sensor_msgs/msg/Imu"
            imu = store.deserialize_cdr(record.data, kind)
            assert imu.angular_velocity_covariance[0] > 0.0
            imu.angular_velocity_covariance = np.zeros(9)
            return replace(record, data=bytes(store.serialize_cdr(imu, kind)))
        return record

    old = write_changed_copy(black_box, tmp_path / "old.mcap", as_recorded_then)
    code, out, _ = verify(capsys, old, "--out", tmp_path / "replayed.mcap")
    assert code == 0, out
    assert "outputs are equal to the last bit" in out
    if node is SHIP_ATTITUDE:
        with read_bag(tmp_path / "replayed.mcap") as bag:
            assert not any(record.decode().angular_velocity_covariance.any() for record in bag.records(["ship/imu"]))


@pytest.mark.slow
def test_a_bag_replayed_or_checked_does_not_replace_what_a_ship_has_saved(tmp_path, capsys):
    saved, suite = tmp_path / "alignment.yaml", tmp_path / "suite.yaml"
    with read_bag(SHIP_ATTITUDE.bag) as bag:
        attached = yaml.safe_load(bag.attachments["suite.yaml"].decode())
    (section,) = attached.values()
    section["ros__parameters"] |= {"alignment_file": str(saved), "alignment_autosave_s": 1.0}
    suite.write_text(yaml.safe_dump(attached), encoding="utf-8")
    assert main([str(SHIP_ATTITUDE.bag), "--out", str(tmp_path / "out.mcap"), "--config", str(suite)]) == 0
    assert check_config([str(suite), str(SHIP_ATTITUDE.bag)]) == 0
    capsys.readouterr()
    assert not saved.exists()


def change_nth(topic, number, change):
    """Return a change of the nth message (from 1) on a topic."""
    seen = 0

    def apply(record, topics):
        nonlocal seen
        if isinstance(record, Message) and topics[record.channel_id] == topic:
            seen += 1
            return change(record) if seen == number else record
        return record

    return apply


def with_last_bit_flipped(field, type_name=ATTITUDE):
    def change(message):
        store = message_store()
        decoded = store.deserialize_cdr(message.data, type_name)
        value = getattr(decoded, field)
        bits = struct.unpack("<Q", struct.pack("<d", value))[0] ^ 1
        setattr(decoded, field, struct.unpack("<d", struct.pack("<Q", bits))[0])
        return replace(message, data=bytes(store.serialize_cdr(decoded, type_name)))

    return change


def test_one_bit_of_one_field_is_found_and_named(black_box, tmp_path, capsys):
    with read_bag(black_box) as bag:
        attitude = [r for r in bag.records_in_file_order() if r.topic == "ship/attitude"][99].decode()
    stamp = attitude.header.stamp.sec * 10**9 + attitude.header.stamp.nanosec
    other = write_changed_copy(
        black_box, tmp_path / "b.mcap", change_nth("ship/attitude", 100, with_last_bit_flipped("pitch"))
    )
    code, out, _ = verify(capsys, other)
    assert code == 1
    line = next(line for line in out.splitlines() if line.startswith("first difference: "))
    assert "ship/attitude, stamp 2014-07-09T11:50:" in line
    assert f"({stamp} ns), field pitch: recorded " in line
    assert line.endswith(f", replayed {attitude.pitch!r}")


def test_an_input_changed_by_one_bit_shows_in_the_output_that_follows(black_box, tmp_path, capsys):
    def change(message):
        store = message_store()
        imu = store.deserialize_cdr(message.data, "sensor_msgs/msg/Imu")
        imu.orientation.x += 1e-9
        return replace(message, data=bytes(store.serialize_cdr(imu, "sensor_msgs/msg/Imu")))

    code, out, _ = verify(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change_nth("ins/imu", 50, change)))
    assert code == 1
    assert "first difference: ship/attitude, stamp" in out


def test_an_output_too_many_is_a_difference(black_box, tmp_path, capsys):
    copy = write_changed_copy(
        black_box, tmp_path / "b.mcap", change_nth("ship/attitude", 30, lambda m: [m, m]), renumber=True
    )
    code, out, _ = verify(capsys, copy)
    assert code == 1
    assert "recorded a message, replayed a message on ship/imu" in out


def test_an_output_too_few_is_a_difference(black_box, tmp_path, capsys):
    copy = write_changed_copy(
        black_box, tmp_path / "b.mcap", change_nth("/tf", 30, lambda message: None), renumber=True
    )
    code, out, _ = verify(capsys, copy)
    assert code == 1
    assert "first difference: /tf, " in out
    assert "recorded nothing, replayed a message" in out


def test_another_saved_file_is_a_difference(black_box, tmp_path, capsys):
    def change(record, topics):
        if isinstance(record, Attachment) and record.name == "files/0001/alignment.yaml":
            return replace(record, data=record.data.replace(b"version: 1", b"version: 9"))
        return record

    code, out, _ = verify(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change))
    assert code == 1
    assert "alignment.yaml, stamp" in out
    assert "field line 2: recorded 'version: 9', replayed 'version: 1'" in out


def test_other_texts_of_a_saved_file_are_counted(black_box, tmp_path, capsys):
    def change(record, topics):
        if isinstance(record, Attachment) and record.name == "files/0001/alignment.yaml":
            return replace(record, data=record.data.replace(b"format: ", b"format: earlier "))
        return record

    code, out, _ = verify(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change))
    assert code == 0, out
    assert re.search(r"other texts: file \S+alignment\.yaml 1; the first: file", out)


def test_missing_entries_end_the_verification_and_are_reported(black_box, tmp_path, capsys):
    code, out, _ = verify(
        capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change_nth("ins/imu", 400, lambda message: None))
    )
    assert code == 1
    assert "verified up to this point: entries are missing before 2014-07-09T11:50:11.79" in out
    assert "first difference" not in out


def test_a_damaged_chunk_ends_the_verification_and_is_reported(black_box, tmp_path, capsys):
    chunks = open_mcap(black_box).chunks
    place = chunks[len(chunks) // 2]
    data = bytearray(black_box.read_bytes())
    data[place.offset + place.length // 2] ^= 1
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(data)
    code, out, _ = verify(capsys, damaged)
    assert code == 1
    assert "entries are missing before" in out
    assert "is damaged" in out


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_a_cut_black_box_is_verified_up_to_the_cut(black_box, tmp_path, capsys, part):
    cut = tmp_path / "b.mcap"
    data = black_box.read_bytes()
    cut.write_bytes(data[: round(part * len(data))])
    code, out, _ = verify(capsys, cut)
    assert code == 0, out
    assert "the black box ends without a footer, at 2014-07-09T11:50:" in out
    assert "no footer" in out


class TestRefused:
    def test_of_another_version_of_the_format(self, black_box, tmp_path, capsys):
        def change(record, topics):
            if isinstance(record, Metadata):
                assert record.metadata["format"] == FORMAT
                return replace(record, metadata=record.metadata | {"format": "0"})
            return record

        line = error_text(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change))
        assert f"b.mcap: version 0 of the black box: expected {FORMAT}" in line

    def test_of_another_node(self, black_box, tmp_path, capsys):
        def change(record, topics):
            if isinstance(record, Metadata):
                return replace(record, metadata=record.metadata | {"node": "gyro"})
            return record

        line = error_text(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change))
        assert "black box of node 'gyro': expected one of " in line
        assert "ship_attitude" in line.partition("expected one of")[2]

    def test_without_its_head(self, black_box, tmp_path, capsys):
        copy = write_changed_copy(
            black_box, tmp_path / "b.mcap", lambda r, topics: None if isinstance(r, Metadata) else r
        )
        assert "metadata record 'black_box' is missing" in error_text(capsys, copy)

    def test_with_a_message_definition_that_has_changed(self, black_box, tmp_path, capsys):
        def change(record, topics):
            if isinstance(record, Schema) and record.name == ATTITUDE:
                return replace(record, data=record.data.replace(b"float64 pitch", b"float64 trim"))
            return record

        line = error_text(capsys, write_changed_copy(black_box, tmp_path / "b.mcap", change))
        assert "topic 'ship/attitude': the message definition has changed" in line
        assert "ship_msgs/msg/ShipAttitude.pitch is missing in the bag" in line

    def test_with_the_content_of_a_file_missing(self, black_box, tmp_path, capsys):
        name = "files/0002/alignment.yaml"
        copy = write_changed_copy(black_box, tmp_path / "b.mcap", without_attachment(name))
        line = error_text(capsys, copy)
        assert f"attachment {name} is missing: the content of {black_box.with_name('alignment.yaml')}" in line

    def test_with_parameters_that_this_node_does_not_have(self, black_box, tmp_path, capsys):
        copy = write_changed_copy(
            black_box, tmp_path / "b.mcap", with_suite(lambda text: text.replace("lag_s", "delay_s"))
        )
        assert "attachment suite.yaml" in (line := error_text(capsys, copy))
        assert "'delay_s' is unknown" in line

    def test_with_the_parameters_of_other_devices(self, black_box, tmp_path, capsys):
        copy = write_changed_copy(
            black_box, tmp_path / "b.mcap", with_suite(lambda text: text.replace('"starboard"', '"aft"'))
        )
        line = error_text(capsys, copy)
        assert "'star/starboard/horizon_attitude' (ship_msgs/msg/StarHorizonAttitude) is not a topic of" in line


def without_attachment(name):
    return lambda r, topics: None if isinstance(r, Attachment) and r.name == name else r


def with_suite(change):
    def apply(record, topics):
        if isinstance(record, Attachment) and record.name == SUITE_ATTACHMENT:
            changed = change(record.data.decode())
            assert changed != record.data.decode()
            return replace(record, data=changed.encode())
        return record

    return apply


@pytest.fixture
def suite(black_box, tmp_path):
    """Return a file with the parameters of the black box."""
    with read_bag(black_box) as bag:
        text = bag.attachments[SUITE_ATTACHMENT]
    path = tmp_path / "suite.yaml"
    path.write_bytes(text)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["suite.yaml", "versions.json"])
def test_a_missing_attachment_is_refused_or_replaced_by_config(black_box, suite, tmp_path, capsys, name):
    copy = write_changed_copy(black_box, tmp_path / "b.mcap", without_attachment(name))
    line = error_text(capsys, copy)
    assert name in line
    assert "--config" in line
    code, out, _ = verify(capsys, copy, "--config", suite)
    assert code == 0
    assert f"note: replayed with {suite} instead of the black box's own parameters" in out


def test_another_version_of_the_suite_is_refused_or_replayed_with_config(black_box, suite, tmp_path, capsys):
    def change(record, topics):
        if isinstance(record, Attachment) and record.name == "versions.json":
            found = json.loads(record.data)
            found["suite"]["ship_attitude_star"] = "0.0.1"
            return replace(record, data=json.dumps(found).encode())
        return record

    copy = write_changed_copy(black_box, tmp_path / "b.mcap", change)
    assert "another version of the suite (ship_attitude_star 0.0.1 there, 0.1.0 here)" in error_text(capsys, copy)
    code, out, _ = verify(capsys, copy, "--config", suite)
    assert code == 0
    assert "note: written by another version of the suite" in out


def test_other_parameters_by_config_are_reported_and_give_a_difference(black_box, suite, tmp_path, capsys):
    suite.write_text(suite.read_text().replace('"tilt_sigma_arcsec": 10.0', '"tilt_sigma_arcsec": 11.0'))
    out_path = tmp_path / "out.mcap"
    code, out, _ = verify(capsys, black_box, "--config", suite, "--out", out_path)
    assert code == 1
    assert "instead of the black box's own parameters: ins.tilt_sigma_arcsec = 11.0, was 10.0" in out
    with read_bag(black_box) as recorded, read_bag(out_path) as replayed:
        counts = [sum(1 for r in bag.records(["ship/attitude"])) for bag in (recorded, replayed)]
    assert counts[0] == counts[1]


def test_verify_draws_no_report_and_without_it_there_must_be_an_out(black_box, tmp_path, capsys):
    assert main([str(black_box)]) == 2
    assert main([str(black_box), "--verify", "--report", str(tmp_path)]) == 2
    assert "--out is missing" in capsys.readouterr().err
