"""Bags with other topic names than the suite's: --remap, and the map ``topics`` of a suite file."""

import json
from pathlib import Path

import pytest
import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.context import Context
from sensor_msgs.msg import Imu

from ship_bags.commands.export import main as export
from ship_bags.commands.info import main as info
from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import names_from_options, topic_names
from ship_bringup.checks.network_state import observe_network
from ship_bringup.security.rights import suite_rights
from ship_bringup.suite.plan import check_nodes
from ship_monitor.commands.monitor import _parser as monitor_parser
from ship_monitor.page.bag_playback import RecordedSuite
from ship_node.messages.inputs_outputs import InputTopic
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.evaluate import main as evaluate
from ship_replay.commands.replay import main as replay
from ship_replay.commands.report import main as report
from ship_replay.commands.smooth import main as smooth
from ship_simulation.inject_command import main as inject
from ship_studies.campaign.campaign_command import main as campaign
from ship_studies.installation.calibrate_installation_command import main as calibrate_installation
from ship_testing.live_relay import LiveRelay
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

ROOT = Path(__file__).parents[1]
SUITE = ROOT / "examples" / "two_sensors.yaml"
NAMES = {"ins/imu": "/imu/data", "gnss/fix": "/fix", "truth/attitude": "/simulator/attitude"}
REMAPS = [word for name, other in NAMES.items() for word in ("--remap", f"{other}:={name}")]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return twenty seconds of a voyage."""
    return _beginning(tmp_path_factory.mktemp("plain") / "voyage.mcap", {})


@pytest.fixture(scope="module")
def renamed_bag(tmp_path_factory):
    """Return the same twenty seconds with the topic names of drivers for INS, receiver and truth."""
    return _beginning(tmp_path_factory.mktemp("renamed") / "voyage.mcap", NAMES)


def _beginning(path, names, suite=None):
    with read_bag(ROOT / "bags" / "demo.mcap") as bag, BagWriter(path) as writer:
        if suite is not None:
            writer.add_attachment("suite.yaml", suite)
        for record in bag.records():
            if record.log_time_ns > bag.start_ns + 20 * NS_PER_S:
                break
            topic = names.get(record.topic.lstrip("/"), record.topic)
            writer.write_raw(topic, record.type_name, record.data, record.log_time_ns)
    return path


@pytest.fixture
def mapped_suite(tmp_path):
    """Return a suite file with a map of topics."""
    path = tmp_path / "mapped.yaml"
    path.write_text(_mapped_text())
    return path


def _mapped_text():
    entries = "".join(f"      {name}: {other}\n" for name, other in NAMES.items())
    return SUITE.read_text().replace("  ros__parameters:\n", f"  ros__parameters:\n    topics:\n{entries}", 1)


def _outputs(path):
    with read_bag(path) as bag:
        return [(record.topic, record.log_time_ns, record.data) for record in bag.records()]


@pytest.fixture(scope="module")
def expected_outputs(plain, tmp_path_factory):
    """Return the outputs of the replay of the bag with the suite's names."""
    out = tmp_path_factory.mktemp("expected") / "out.mcap"
    assert replay([str(plain), "--config", str(SUITE), "--out", str(out)]) == 0
    return out


def test_remap_replays_and_evaluates_the_same(plain, renamed_bag, expected_outputs, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    assert replay([str(renamed_bag), "--config", str(SUITE), "--out", str(out), *REMAPS]) == 0
    assert _outputs(out) == _outputs(expected_outputs)
    files = [tmp_path / name for name in ("renamed.json", "plain.json")]
    assert evaluate([str(out), "--against", str(renamed_bag), "--json", str(files[0]), *REMAPS]) == 0
    assert evaluate([str(expected_outputs), "--against", str(plain), "--json", str(files[1])]) == 0
    assert json.loads(files[0].read_text()) == json.loads(files[1].read_text())


def test_the_map_of_a_suite_file_replays_and_evaluates_the_same(renamed_bag, expected_outputs, mapped_suite, tmp_path):
    out = tmp_path / "out.mcap"
    assert replay([str(renamed_bag), "--config", str(mapped_suite), "--out", str(out)]) == 0
    assert _outputs(out) == _outputs(expected_outputs)


def test_the_map_of_the_attached_suite_file_replays_and_evaluates_the_same(expected_outputs, tmp_path):
    bag = _beginning(tmp_path / "recorded.mcap", NAMES, _mapped_text())
    assert replay([str(bag), "--out", str(tmp_path / "out.mcap")]) == 0
    assert _outputs(tmp_path / "out.mcap") == _outputs(expected_outputs)
    assert evaluate([str(tmp_path / "out.mcap"), "--against", str(bag)]) == 0


def test_a_namespace_applies_to_names_without_a_slash(plain, expected_outputs, tmp_path):
    names = {record[0].lstrip("/"): f"/ship/{record[0].lstrip('/')}" for record in _outputs(plain)}
    bag = _beginning(tmp_path / "in.mcap", names | {"ins/imu": "/ship/imu/data", "gnss/fix": "/fix"})
    out = tmp_path / "out.mcap"
    words = ["--namespace", "ship", "--remap", "imu/data:=ins/imu", "/fix:=gnss/fix"]
    assert replay([str(bag), "--config", str(SUITE), "--out", str(out), *words]) == 0
    assert _outputs(out) == _outputs(expected_outputs)


def test_a_candidate_for_a_missing_input_is_named_by_its_type(renamed_bag, tmp_path, capsys):
    advice = "sensor_msgs/Imu on /imu/data: --remap /imu/data:=ins/imu"
    assert replay([str(renamed_bag), "--config", str(SUITE), "--out", str(tmp_path / "out.mcap")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert advice in line
    assert check_config([str(SUITE), str(renamed_bag)]) == 2
    captured = capsys.readouterr()
    assert advice in captured.err
    assert check_config([str(SUITE), str(renamed_bag), *REMAPS]) == 0
    assert "is not in" not in capsys.readouterr().out


def test_every_command_that_reads_a_bag_accepts_remap(renamed_bag, expected_outputs, tmp_path, capsys):
    bag, config, out = str(renamed_bag), str(SUITE), tmp_path
    assert smooth([bag, "--config", config, "--out", str(out / "smoothed.mcap"), *REMAPS]) == 0
    words = ["--config", config, "--out", str(out / "alignment.yaml"), *REMAPS]
    assert calibrate_installation([bag, *words]) == 0
    assert report([str(expected_outputs), "--truth", bag, "--out", str(out / "page.html"), *REMAPS]) == 0
    words = ["--config", config, "--out", str(out / "campaign"), "--workers", "1", *REMAPS]
    assert campaign([bag, *words]) == 0
    faults = ROOT / "bags" / "faults" / "demo.yaml"
    words = ["--faults", str(faults), "--out", str(out / "faulty.mcap"), *REMAPS]
    assert inject([bag, *words]) == 0
    capsys.readouterr()
    assert info([bag, *REMAPS]) == 0
    assert "\nins/imu " in capsys.readouterr().out
    assert export([bag, "--topics", "gnss/fix", "--format", "csv", "--out", str(out / "tables"), *REMAPS]) == 0
    assert (out / "tables" / "gnss.fix.csv").is_file()


def test_the_page_shows_a_recording_with_other_names(expected_outputs, tmp_path):
    with read_bag(expected_outputs) as bag, BagWriter(tmp_path / "other.mcap") as writer:
        for record in bag.records():
            topic = {"ship/attitude": "/nav/attitude"}.get(record.topic, record.topic)
            writer.write_raw(topic, record.type_name, record.data, record.log_time_ns)
    options = monitor_parser().parse_args(["--bag", "other.mcap", "--remap", "/nav/attitude:=ship/attitude"])
    with topic_names(names_from_options(options)):
        suite = RecordedSuite(tmp_path / "other.mcap")
    assert any(message.topic == "ship/attitude" for message in suite.messages(0))
    suite.close()


def test_a_topic_that_already_has_the_name_is_ignored_and_named(plain, expected_outputs, tmp_path, capsys):
    with read_bag(plain) as bag, BagWriter(tmp_path / "two.mcap") as writer:
        for record in bag.records():
            topic = record.topic.lstrip("/")
            if topic == "ins/imu":
                writer.write_raw("/imu/data", record.type_name, record.data, record.log_time_ns)
                writer.write_raw("/ins/imu", record.type_name, bytes(len(record.data)), record.log_time_ns)
            else:
                writer.write_raw(topic, record.type_name, record.data, record.log_time_ns)
    out, words = tmp_path / "out.mcap", ["--config", str(SUITE), "--remap", "/imu/data:=ins/imu"]
    assert replay([str(tmp_path / "two.mcap"), "--out", str(out), *words]) == 0
    assert _outputs(out) == _outputs(expected_outputs)
    assert "two.mcap: topic '/ins/imu' is not read: /imu/data has its name" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--remap", "/imu/data"], "'/imu/data' is not of the form OLD:=NEW, as /imu/data:=ins/imu"),
        (["--remap", "/imu/data:=a/b", "/fix:=a/b"], "topics '/fix' and '/imu/data' cannot both be read as 'a/b'"),
        (["--remap", "/imu/dat:=a/b"], "has no topic '/imu/dat' to rename; it has /fix, /imu/data"),
    ],
)
def test_an_invalid_remap_is_one_line(renamed_bag, tmp_path, capsys, words, line):
    try:
        code = export([str(renamed_bag), "--out", str(tmp_path / "tables"), *words])
    except SystemExit as end:
        code = end.code
    assert code == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert line in error


@pytest.mark.parametrize(
    ("entries", "line"),
    [
        ("      imu: /imu/data\n", ":4: parameter 'topics.imu': expected the suite's name of an input behind"),
        ("      ins/imu: 7\n", ":4: parameter 'topics.ins/imu' = 7: expected the name of a topic, as /imu/data"),
        ("      ins/imu: /i\n      a/imu: /i\n", ":5: parameter 'topics.a/imu' = '/i': that is ins/imu already"),
    ],
)
def test_a_wrong_map_is_one_line_with_its_place(renamed_bag, tmp_path, capsys, entries, line):
    path = tmp_path / "suite.yaml"
    path.write_text(f"/**/ship_attitude:\n  ros__parameters:\n    topics:\n{entries}    ins:\n      frame_id: ins\n")
    assert replay([str(renamed_bag), "--config", str(path), "--out", str(tmp_path / "out.mcap")]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert line in error


def test_an_entry_without_a_node_input_is_named(tmp_path, capsys):
    path = tmp_path / "suite.yaml"
    text = SUITE.read_text().replace("ros__parameters:\n", "ros__parameters:\n    topics: {ins/imo: /i/d}\n", 1)
    path.write_text(text)
    assert check_config([str(path)]) == 0
    assert ": parameter 'topics.ins/imo': no estimator of this file takes ins/imo" in capsys.readouterr().out


@pytest.mark.live
def test_a_live_node_subscribes_to_the_ships_topic_name(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    relay = LiveRelay("-p", "topics.ins/imu:=/imu/data")
    try:
        assert relay.live.node.count_subscribers("/imu/data") == 1
        assert relay.live.node.count_subscribers("/ins/imu") == 0
        names = relay.call(ListParameters, "list_parameters", ListParameters.Request()).result.names
        assert "topics.ins/imu" in names
    finally:
        relay.close()


@pytest.mark.live
def test_a_suite_is_played_recorded_and_replayed_under_the_names_of_the_ship(
    renamed_bag, mapped_suite, tmp_path, monkeypatch
):
    """The nodes use the ship's names by the map; a recording includes the map, so that a replay needs no option."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id, recorded = free_domain_id(), tmp_path / "recorded.mcap"
    environment = live_environment(domain_id, tmp_path)
    recorder = [*executable("ship_bags", "record"), "--out", str(recorded)]
    suite = [*executable("ship_bringup", "suite"), str(mapped_suite), "--bag", str(renamed_bag), "--rate", "4"]
    with (
        GraphObserver(domain_id) as observer,
        LiveProcess(recorder, tmp_path / "record.log", environment) as recording,
        LiveProcess(suite, tmp_path / "suite.log", environment) as running,
    ):
        assert observer.spin_until(lambda: running.exit_code is not None, 120), running.log_text()
        assert running.exit_code == 0, running.log_text()
        assert recording.end() == 0, recording.log_text()
    with read_bag(recorded) as bag:
        assert {"/imu/data", "/truth/attitude"} <= bag.topics.keys()
        assert "/ins/imu" not in bag.topics
    assert replay([str(recorded), "--out", str(tmp_path / "again.mcap")]) == 0
    with read_bag(tmp_path / "again.mcap") as bag:
        assert any(record.topic == "ship/attitude" for record in bag.records())


@pytest.mark.live
def test_preflight_subscribes_to_the_ships_topic_names(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    context = Context()
    rclpy.init(context=context)
    driver = rclpy.create_node("driver", context=context)
    driver.create_publisher(Imu, "/imu/data", 10)
    topic = InputTopic("ins/imu", "sensor_msgs/msg/Imu", required=False, depth=100)
    try:
        (observed,) = observe_network([topic], [], "ship", 0.1, {"ins/imu": "/imu/data"}).inputs
        assert [publisher.node for publisher in observed.publishers] == ["/driver"]
    finally:
        driver.destroy_node()
        context.try_shutdown()


def test_policies_allow_the_names_of_the_ship():
    adapters = [node.adapter for node in check_nodes(SUITE, "ship")[0]]
    plain, renamed_bag = (suite_rights(adapters, "ship", ship_names=names) for names in ({}, {"ins/imu": "/imu/data"}))
    concerned = [rights for rights in zip(plain, renamed_bag, strict=True) if "/ship/ins/imu" in _topics_of(rights[0])]
    assert len(concerned) >= 4  # node, INS, recorder, preflight
    assert all("/imu/data" in _topics_of(after) for _, after in concerned)


def _topics_of(rights):
    return rights.subscribes | rights.publishes
