"""A source listed in ``sources_off`` has the same effect as a bag without its topic, to the last bit.

Only health, diagnostics and the innovations that name the source may differ. The expected result is a replay of the
same bag without the topic, by the same code without the parameter.
"""

from pathlib import Path

import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_store import RosbagsFactory, message_store
from ship_estimation.rejection_rules import Reason
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import ADAPTERS
from ship_replay.offline.replay_run import LARGEST_BATCH, ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary
from ship_testing.memory_sink import MemorySink, Published
from ship_testing.places import ROOT

DEMO, THEODOLITE = ROOT / "bags" / "demo.mcap", ROOT / "bags" / "theodolite.mcap"
OF_ITSELF = {"/diagnostics", "input_health"}
INNOVATIONS = {"ship/innovation", "theodolite/innovation", "star/innovation"}
LENGTH_NS = 25_000_000_000

CASES = [
    (DEMO, "ship_attitude", "star.fore", "star/fore/horizon_attitude"),
    (DEMO, "ship_attitude", "star.starboard", "star/starboard/horizon_attitude"),
    (THEODOLITE, "optical_axis", "lights", "theodolite/beacons"),
    (THEODOLITE, "optical_axis", "baseline.a", "beacon/a/baseline"),
    (THEODOLITE, "optical_axis", "drone.b", "beacon/b/imu"),
]


def replay_published(
    batch_size: int, bag_path: Path, config_path: Path | None, without: str = ""
) -> Published:
    """Return the outputs for the beginning of a bag without one topic."""
    with read_bag(bag_path) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory(), config_path)
        taken, sink = {topic.topic for topic in chain.inputs} - {without}, MemorySink()
        run = ReplayRun(chain, sink, ReplaySummary(), set(), batch_size)
        assert bag.start_ns is not None
        for record in bag.records():
            if record.log_time_ns > bag.start_ns + LENGTH_NS:
                break
            if record.topic in taken:
                run.process_message(record.topic, record)
        run.finish()
    return sink.published


def suite_without(bag_path: Path, node: str, source: str, folder: Path) -> Path:
    """Return the bag's suite file with a source switched off."""
    with read_bag(bag_path) as bag:
        suite = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT])
    suite[f"/**/{node}"]["ros__parameters"]["sources_off"] = [source]
    path = folder / "suite.yaml"
    path.write_text(yaml.safe_dump(suite))
    return path


def estimates(published: Published, source: str) -> tuple[Published, int]:
    """Return the outputs without health, diagnostics and reports that the source is off; and the report count."""
    kept, count = {}, 0
    for topic, messages in published.items():
        if topic not in OF_ITSELF:
            kept[topic] = list(messages)
        if topic in INNOVATIONS:
            is_off = [is_reported_off(data, source) for _, data in messages]
            count += sum(is_off)
            kept[topic] = [message for message, off in zip(messages, is_off, strict=True) if not off]
    return {topic: messages for topic, messages in kept.items() if messages}, count


def is_reported_off(data: bytes, source: str) -> bool:
    innovation = message_store().deserialize_cdr(data, "ship_msgs/msg/Innovation")
    off = innovation.reason == Reason.OFF
    assert not off or (innovation.source, innovation.accepted) == (source, False)
    return bool(off)


@pytest.mark.slow
@pytest.mark.parametrize("batch_size", [1, LARGEST_BATCH])
@pytest.mark.parametrize(("bag_path", "node", "source", "topic"), CASES, ids=[case[2] for case in CASES])
def test_off_from_the_start_is_as_without_the_topic(
    batch_size: int, bag_path: Path, node: str, source: str, topic: str, tmp_path: Path
) -> None:
    off, rejected_off = estimates(
        replay_published(batch_size, bag_path, suite_without(bag_path, node, source, tmp_path)), source
    )
    without, rejected_without = estimates(replay_published(batch_size, bag_path, None, without=topic), source)
    assert rejected_without == 0
    assert rejected_off > 20
    assert {topic: len(messages) for topic, messages in off.items()} == {
        topic: len(messages) for topic, messages in without.items()
    }
    assert off == without
    assert off != estimates(replay_published(batch_size, bag_path, None), source)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("bag_path", "node", "source", "_topic"), CASES[1:3], ids=[case[2] for case in CASES[1:3]])
def test_blocks_equal_one_by_one(
    bag_path: Path, node: str, source: str, _topic: str, tmp_path: Path
) -> None:
    suite = suite_without(bag_path, node, source, tmp_path)
    assert replay_published(LARGEST_BATCH, bag_path, suite) == replay_published(1, bag_path, suite)
