"""A recorder queries the nodes' parameters, and a replay of the recording uses them."""

import sys

import pytest
import rclpy

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_node.parameters.parameter_file import load_config
from ship_replay.offline.replay import replay
from ship_testing.hand_made_bags import START_NS, imu
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

pytestmark = pytest.mark.live

PARAMETERS = """\
/**/ship_attitude:
  ros__parameters:
    ins: {white_sigma_arcsec: 2.5, frame_id: "1e3"}
    star_sensors: {fore: {azimuth_deg: 30.0, elevation_deg: 40.0}}
"""


def command(module, *arguments):
    return [sys.executable, "-m", module, *arguments]


@pytest.mark.parametrize("name", ["voyage.mcap", "voyage"])
def test_a_recording_contains_the_parameters_of_the_nodes(name, tmp_path, monkeypatch):
    """The recording is a file or a folder; one of the nodes never answers."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id = free_domain_id()
    environment = live_environment(domain_id, tmp_path)
    (tmp_path / "suite.yaml").write_text(PARAMETERS)
    bag, out = tmp_path / "in.mcap", tmp_path / name
    with BagWriter(bag) as writer:
        for number in range(30):
            stamp_ns = START_NS + number * 10_000_000
            writer.write("ins/imu", imu(stamp_ns, "1e3"), stamp_ns)
    start = "from ship_attitude_star.nodes import ship_attitude; ship_attitude()"
    options = ("-r", "__ns:=/aurora", "--params-file", tmp_path / "suite.yaml", "-p", f"black_box:={tmp_path}/box.mcap")
    node = [sys.executable, "-c", start, "--ros-args", *map(str, options)]
    recorder = command("ship_bags.commands.record", "--out", str(out))
    # The player waits until both the node and the recorder subscribe.
    waiting = ("--wait-for-subscribers", "ins/imu=2", "--ros-args", "-r", "__ns:=/aurora")
    player = command("ship_bags.commands.play", str(bag), *waiting)
    with (
        GraphObserver(domain_id) as observer,
        LiveProcess(node, tmp_path / "node.log", environment) as running,
        LiveProcess(recorder, tmp_path / "record.log", environment) as recording,
    ):
        # This node is in the graph with its services, but does not answer.
        unresponsive = rclpy.create_node("unresponsive", context=observer.node.context)
        there = observer.wait_for({"/aurora/ship/attitude": 1}, {"/aurora/ship/attitude": 1, "/aurora/ins/imu": 1})
        assert there, running.log_text() + recording.log_text()
        with LiveProcess(player, tmp_path / "play.log", environment) as playing:
            assert observer.spin_until(lambda: playing.exit_code is not None, 30), playing.log_text()
        assert recording.end() == 0, recording.log_text()
        assert "record: /unresponsive did not report its parameters" in recording.log_text()
        assert "ship_attitude did not report" not in recording.log_text()
        assert running.exit_code is None, running.log_text()
        unresponsive.destroy_node()
    with read_bag(out) as recorded:
        text = recorded.attachments["suite.yaml"].decode()
    config = load_config(ShipAttitudeConfig, text, "/aurora/ship_attitude")
    assert (config.ins.white_sigma_arcsec, config.ins.frame_id) == (2.5, "1e3")
    assert list(config.star_sensors) == ["fore"]
    # A node that gets the attached suite file must not overwrite the black box of the recorded node.
    assert "box.mcap" not in text
    summary = replay(out, tmp_path / "again.mcap", (ShipAttitudeAdapter,), namespace="aurora")
    assert summary.inputs["ins/imu"] == 30
