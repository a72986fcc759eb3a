"""Estimated write rates, against bags and black boxes that were written, and against the free disk space."""

import dataclasses
import re
from pathlib import Path

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bringup.checks.check_line import Result
from ship_bringup.checks.disk_check import DiskState, check_disk, estimate_write_rates, read_disk_state
from ship_bringup.checks.network_state import ObservedTopic
from ship_node.messages.inputs_outputs import InputTopic
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import ADAPTERS, replay
from ship_testing.bag_parts import write_beginning
from ship_testing.black_boxes import LENGTH_NS, OPTICAL_AXIS, SHIP_ATTITUDE, make_black_box
from ship_watch.safety.limits import Limits, MachineLimits

ROOT = Path(__file__).parents[3]
GB, HOUR_S = 1e9, 3600.0
FREE = MachineLimits(disk_free_gb=0.0)
TAIL_S = 2.0
"""Time that :func:`make_black_box` adds to the eight seconds by repeating the first 300 messages, s."""


def chain_and_inputs(path):
    """Return the nodes of a bag, its inputs as observed on the network, their records, and its length in s."""
    with read_bag(path) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory())
        records = list(bag.records([topic.topic for topic in chain.inputs]))
        seconds = (bag.end_ns - bag.start_ns) * 1e-9
    observed = []
    for topic in chain.inputs:
        lengths = [len(record.data) for record in records if record.topic == topic.topic]
        if lengths:
            mean, count = sum(lengths) / len(lengths), len(lengths)
            observed.append(ObservedTopic(topic, (), count / seconds, mean, count))
    return chain, observed, records, seconds


@pytest.mark.parametrize("name", ["demo", "theodolite"])
def test_record_size_is_within_the_estimate(name, tmp_path):
    """Inputs and outputs of the suite, written as by ``record``: a chunk every tenth of a second."""
    path = write_beginning(ROOT / "bags" / f"{name}.mcap", tmp_path / "in.mcap", 8.0)
    chain, observed, records, seconds = chain_and_inputs(path)
    replay(path, tmp_path / "out.mcap", ADAPTERS)
    written = tmp_path / "record.mcap"
    with read_bag(tmp_path / "out.mcap") as out, BagWriter(written, atomic=False) as writer:
        types = dict(out.topics) | {topic.topic: topic.type_name for topic in chain.inputs}
        for topic, kind in types.items():
            writer.add_topic(topic, kind, False)
        records += out.records([topic.topic for topic in chain.outputs])
        next_ns = 0
        for record in sorted(records, key=lambda each: each.log_time_ns):
            writer.write_raw(record.topic, types[record.topic], record.data, record.log_time_ns, record.log_time_ns)
            if record.log_time_ns >= next_ns:
                writer.flush()
                next_ns = record.log_time_ns + 100_000_000
    measured = written.stat().st_size / seconds
    estimated = estimate_write_rates(chain.adapters, observed).record
    assert measured < estimated < 4.0 * measured


@pytest.mark.parametrize("node", [SHIP_ATTITUDE, OPTICAL_AXIS], ids=["ship_attitude", "optical_axis"])
def test_black_box_size_is_within_the_estimate(node, tmp_path):
    make_black_box(tmp_path / "box.mcap", tmp_path / "saved.yaml", node=node)
    chain, observed, _, _ = chain_and_inputs(node.bag)
    own = [adapter for adapter in chain.adapters if isinstance(adapter, node.adapter_class)]
    measured = (tmp_path / "box.mcap").stat().st_size / (LENGTH_NS * 1e-9 + TAIL_S)
    estimated = estimate_write_rates(own, observed).boxes
    assert measured < estimated < 5.0 * measured


def test_missing_inputs_count_with_typical_values():
    path = ROOT / "bags" / "demo.mcap"
    chain, observed, _, _ = chain_and_inputs(path)
    full, without_inputs = estimate_write_rates(chain.adapters, observed), estimate_write_rates(chain.adapters, [])
    assert 0.5 < without_inputs.record / full.record < 2.0
    no_message = [ObservedTopic(InputTopic("ins/imu", "sensor_msgs/msg/Imu", True, 1))]
    assert estimate_write_rates(chain.adapters, no_message) == without_inputs
    one_message = [dataclasses.replace(no_message[0], count=1, message_bytes=316.0)]
    assert estimate_write_rates(chain.adapters, one_message) == without_inputs


def test_faster_ins_needs_more_space():
    chain, observed, _, _ = chain_and_inputs(ROOT / "bags" / "demo.mcap")
    faster = [ObservedTopic(each.input, (), 10.0 * each.rate_hz, each.message_bytes, each.count) for each in observed]
    assert (
        estimate_write_rates(chain.adapters, faster).boxes > 5.0 * estimate_write_rates(chain.adapters, observed).boxes
    )


@pytest.mark.parametrize(
    ("free_gb", "result"), [(30.1, Result.OK), (29.9, Result.WARN), (20.1, Result.WARN), (19.9, Result.FAIL)]
)
def test_free_space_limits(free_gb, result):
    """10 h need 20 GB, and 10 GB must remain free."""
    limits = Limits(machine=MachineLimits(disk_free_gb=10.0))
    state = DiskState(Path("/box"), 1, round(free_gb * GB))
    (row,) = check_disk(state, 20.0 * GB / (10.0 * HOUR_S), 10.0, limits)
    assert row.result is result
    assert "10 h need 20.0 GB" in row.finding


def test_unreadable_disk_fails():
    (row,) = check_disk(DiskState(Path("/box"), None, None), 1.0, 1.0, Limits())
    assert row.result is Result.FAIL


def test_unmounted_disk_of_the_limits_fails(tmp_path):
    (row,) = check_disk(read_disk_state(tmp_path / "data"), 1.0, 1.0, Limits(), "machine.disk_path")
    assert row.result is Result.FAIL
    assert row.finding.startswith(f"{tmp_path}/data, named by machine.disk_path, is not there")
    assert row.advice.startswith("mount the disk")
    (row,) = check_disk(read_disk_state(tmp_path), 1.0, 0.001, Limits(machine=FREE), "machine.disk_path")
    assert row.result is Result.OK


def test_missing_folder_reports_the_measured_folder(tmp_path):
    (row,) = check_disk(read_disk_state(tmp_path / "a" / "b"), 1.0, 0.001, Limits(machine=FREE))
    assert row.result is Result.OK
    assert re.fullmatch(rf"{tmp_path}/a/b is not there yet: [\d.]+ GB free in {tmp_path}, .*", row.finding)


def test_missing_folder_is_on_the_disk_of_its_parent(tmp_path):
    assert read_disk_state(tmp_path / "a" / "b").device == tmp_path.stat().st_dev
    assert read_disk_state(tmp_path / "a" / "b").free_bytes > 0
