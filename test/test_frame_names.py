"""``frames.deck``, ``frames.horizon`` and ``publish_tf``: the suite with a URDF, or with other transforms."""

import json

import pytest
import yaml

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_estimation.parameters.schema import ParameterError, build
from ship_replay.offline.replay import ADAPTERS, replay
from ship_replay.offline.smooth import smooth
from ship_testing.bag_parts import write_beginning
from ship_testing.places import ROOT
from ship_testing.small_voyage import fault_free_run, new_adapter, run_adapter, voyage

FRAMES = {"deck": "base_link", "horizon": "enu"}


def frames_of(message):
    """Yield the frames named in a message: the frame of its header, and both frames of each of its transforms."""
    yield message.header.frame_id if hasattr(message, "header") else ""
    for transform in getattr(message, "transforms", ()):
        yield transform.header.frame_id
        yield transform.child_frame_id


def links(messages):
    return {(t.header.frame_id, t.child_frame_id) for message in messages for t in message.transforms}


def test_every_message_of_the_ship_names_the_frames_as_configured():
    run = run_adapter(new_adapter(frames__deck="base_link", frames__horizon="enu"), voyage())
    assert links(run.messages("/tf")) == {("enu", "base_link")}
    assert links(run.messages("/tf_static")) == {("base_link", "star_fore"), ("base_link", "star_starboard")}
    named = {(topic, frame) for _, topic, message in run.published for frame in frames_of(message)}
    assert {topic for topic, frame in named if frame in ("deck", "horizon")} == set()
    assert {topic for topic, frame in named if frame == "base_link"} >= {
        "ship/attitude", "ship/imu", "ship/attitude_deg", "ship/alignment", "ship/integrity", "ship/error_budget",
    }  # fmt: skip


@pytest.mark.parametrize(("publish_tf", "topics"), [(True, {"/tf", "/tf_static"}), (False, set())])
def test_transforms_are_left_to_another_node(publish_tf, topics):
    run = run_adapter(new_adapter(publish_tf=publish_tf), voyage())
    assert {topic for _, topic, _ in run.published if topic.startswith("/tf")} == topics
    assert {output.topic for output in run.adapter.outputs if output.topic.startswith("/tf")} == topics
    others = [(ns, topic, message) for ns, topic, message in fault_free_run().published if not topic.startswith("/tf")]
    assert [topic for _, topic, _ in run.published if not topic.startswith("/tf")] == [topic for _, topic, _ in others]


def part_and_suite(tmp_path, publish_tf=True):
    """Return the first seconds of the theodolite's bag, and its suite with ``ship_attitude`` and other frame names."""
    part, suite = (
        write_beginning(ROOT / "bags" / "theodolite.mcap", tmp_path / "part.mcap", 3.0),
        tmp_path / "suite.yaml",
    )
    with read_bag(part) as bag:
        values = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT].decode())
    values["/**/ship_attitude"] = {"ros__parameters": {"ins": {"frame_id": "ins"}, "frames": FRAMES}}
    parameters = values["/**/optical_axis"]["ros__parameters"]
    parameters["ship"]["frame_id"] = "base_link"
    parameters |= {"frames": FRAMES, "publish_tf": publish_tf}
    suite.write_text(json.dumps(values), encoding="utf-8")
    return part, suite


@pytest.mark.parametrize("publish_tf", [True, False])
def test_the_theodolite_uses_the_configured_frames(publish_tf, tmp_path):
    (part, suite), out = part_and_suite(tmp_path, publish_tf), tmp_path / "out.mcap"
    replay(part, out, ADAPTERS, suite)
    with read_bag(out) as bag:
        messages = [(record.topic, record.decode()) for record in bag.records()]
    below = {("base_link", "theodolite_main")} if publish_tf else set()
    assert links(message for topic, message in messages if topic == "/tf") == {("enu", "base_link")} | below
    ours = [(topic, message) for topic, message in messages if not topic.startswith(("truth/", "ins/", "beacon/"))]
    assert {topic for topic, message in ours for frame in frames_of(message) if frame in ("deck", "horizon")} == set()


def test_smoothed_attitudes_use_the_configured_frames_and_the_theodolite_accepts_them(tmp_path):
    (part, suite), out = part_and_suite(tmp_path), tmp_path / "out.mcap"
    smooth(part, out, suite)
    with read_bag(out) as bag:
        frames = {(record.topic, record.decode().header.frame_id) for record in bag.records()}
    ours = {pair for pair in frames if not pair[0].startswith("truth/")}
    assert ours == {("ship/attitude_smoothed", "base_link"), ("theodolite/pointing_smoothed", "theodolite_main")}


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ({"deck": ""}, r"'frames\.deck' = '' is not a frame name: expected one like 'base_link'"),
        ({"horizon": "/map"}, r"'frames\.horizon' = '/map' is not a frame name"),
        ({"deck": "map", "horizon": "map"}, r"'frames\.deck' = 'map' equals 'frames\.horizon'"),
    ],
)
def test_frame_names_invalid_for_tf2_are_refused(frames, reason):
    with pytest.raises(ParameterError, match=reason):
        build(ShipAttitudeConfig, {"frames": frames})
