"""Every bag in bags/ through the live node over DDS, compared with the same bag replayed offline.

No message may be lost, and outputs may differ only by the inputs received before them: a star measurement shortly
before or after an INS sample, lights before or after an encoder reading. After all inputs the states are the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import relative_topic
from ship_geometry.frames import quaternion_from_rotation, rotation_from_angles
from ship_node.adapters.adapter import Adapter
from ship_node.live.node_clock import TickGrid
from ship_node.parameters.parameter_file import has_section, load_config
from ship_replay.evaluation.bounds import check_bounds, read_bounds
from ship_replay.evaluation.evaluate import evaluate
from ship_testing.one_message import process_message
from ship_testing.trials.live_run import LiveRun
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

pytestmark = [pytest.mark.live, pytest.mark.slow]

BAGS = sorted((Path(__file__).parents[1] / "bags").glob("*.mcap"))
SAME_RAD = 1e-9
INVALID = 3


def ship_attitude(message) -> tuple[np.ndarray, float]:
    """Return orientation x, y, z, w, and the age of the last star measurement used, s; the age identifies it."""
    return np.array([getattr(message.orientation, axis) for axis in "xyzw"]), message.star_age_s


def pointing(message) -> tuple[np.ndarray, float]:
    """Return orientation x, y, z, w and the variance of the pointing, rad², which identifies the last lights used."""
    rotation_nm = rotation_from_angles(message.azimuth, message.elevation, message.image_rotation)
    return quaternion_from_rotation(rotation_nm), float(np.trace(message.rotation_covariance.reshape(3, 3)))


@dataclass(frozen=True)
class Node:
    """A node with its inputs from a bag and its outputs.

    Attributes:
        adapter: adapter of the node.
        package: package of the node's executable.
        file: parameter with the path of the file that the node saves.
        topic: output topic with a message for each message on ``sample``.
        sample: input topic.
        read: orientation of a message on ``topic``, and a number that identifies the last measurement used.
        rate: seconds of the bag per second.
    """

    adapter: type[Adapter]
    package: str
    file: str
    topic: str
    sample: str
    read: Callable[[Any], tuple[np.ndarray, float]]
    rate: float


NODES = (
    # At these rates, INS samples and encoder readings arrive at 200 Hz.
    Node(ShipAttitudeAdapter, "ship_attitude_star", "alignment_file", "ship/attitude", "ins/imu", ship_attitude, 2.0),
    Node(
        OpticalAxisAdapter,
        "theodolite_calib",
        "calibration_file",
        "theodolite/pointing",
        "theodolite/encoder",
        pointing,
        4.0,
    ),
)


@dataclass
class Outcome:
    """Results of one way of running a bag.

    Attributes:
        attitudes: stamp → (orientation x, y, z, w; number of the last measurement used).
        saved: the alignment or calibration saved at the end.
        counts: relative topic → messages in the recorded bag; empty offline.
        invalid_count: INVALID outputs after the first output that is not INVALID.
        cut: messages that the node discarded because it was behind.
    """

    attitudes: dict[int, tuple[np.ndarray, float]]
    saved: dict
    counts: dict[str, int]
    invalid_count: int
    cut: int = 0


@pytest.fixture(scope="module", params=BAGS, ids=lambda path: path.stem)
def runs(request, tmp_path_factory):
    """Return a bag, its node, the offline outcome, the live outcome, and the recorded bag."""
    node = node_of(request.param)
    folder = tmp_path_factory.mktemp(request.param.stem)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        offline = run_offline(node, request.param, folder / "offline.yaml")
        live, recorded_path = run_live(node, request.param, folder, offline.invalid_count)
    return request.param, node, offline, live, recorded_path


def node_of(path: Path) -> Node:
    """Return the one node of the bag's configuration."""
    with read_bag(path) as bag:
        text = bag.attachments[SUITE_ATTACHMENT].decode()
    (node,) = (node for node in NODES if has_section(text, node.adapter.node_name))
    return node


def run_offline(node: Node, path: Path, saved_path: Path) -> Outcome:
    """Run the bag through the adapter message by message, as `replay` does; return outputs and saved file."""
    published, grid = [], TickGrid()
    with read_bag(path) as bag:
        name = node.adapter.node_name
        text = with_file(bag, name, node.file, saved_path)
        adapter = node.adapter(load_config(node.adapter.config_type, text, name), RosbagsFactory())
        topics = {topic.topic for topic in adapter.inputs}
        for record in bag.records(topics):
            for tick_ns in grid.ticks_until(record.log_time_ns):
                published += adapter.tick(tick_ns)
            published += process_message(adapter, record.topic, record.decode(), record.log_time_ns)
    result = adapter.service("save_alignment", record.log_time_ns)
    assert result.success, result.message
    attitudes = [message for topic, message in published if topic == node.topic]
    saved = yaml.safe_load(saved_path.read_text(encoding="utf-8"))
    return Outcome(by_stamp(node, attitudes), saved, {}, count_invalid(attitudes))


def run_live(node: Node, path: Path, folder: Path, unclaimed_offline: int) -> tuple[Outcome, Path]:
    """Run the bag through the node's process; return outputs, the file saved by its service, and the recording.

    The bag is played again, more slowly, if the node reports discarded messages, or received messages so late that
    outputs are missing. Lost messages cannot be compared.
    """
    for slower in (1, 2, 4):
        run_folder = folder / f"live_{slower}"
        outcome, recorded_path = run_live_once(node, path, run_folder, node.rate / slower)
        if outcome.cut == 0 and outcome.invalid_count <= unclaimed_offline:
            break
    return outcome, recorded_path


def run_live_once(node: Node, path: Path, folder: Path, rate: float) -> tuple[Outcome, Path]:
    """Run the bag once through the node's process, at one rate."""
    from std_srvs.srv import Trigger

    saved_path = folder / "saved.yaml"
    with LiveRun(path, node.adapter, node.package, folder, {node.file: str(saved_path)}) as run:
        run.play(rate)
        client = run.observer.node.create_client(Trigger, f"/{node.adapter.node_name}/save_alignment")
        assert run.observer.spin_until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        assert run.observer.spin_until(answer.done)
        assert answer.result().success, answer.result().message
        assert run.node.end() == 0, run.node.log_text()
    counts: dict[str, int] = {}
    cut: dict[str, int] = {}
    attitudes = []
    with read_bag(run.recorded_path) as bag:
        for record in bag.records():
            topic = relative_topic(record.topic)
            counts[topic] = counts.get(topic, 0) + 1
            if topic == node.topic:
                attitudes.append(record.decode())
            elif topic == "input_health":
                health = record.decode()
                cut[health.topic] = dict(zip(health.reasons, health.reason_counts, strict=True)).get("overflow", 0)
        assert bag.problems == []
    saved = yaml.safe_load(saved_path.read_text(encoding="utf-8"))
    outcome = Outcome(by_stamp(node, attitudes), saved, counts, count_invalid(attitudes), int(sum(cut.values())))
    return outcome, run.recorded_path


def with_file(bag, node_name: str, parameter: str, path: Path) -> str:
    """Return the attached configuration with another path of the node's saved file."""
    document = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT])
    (section,) = (parameters for name, parameters in document.items() if name.endswith(node_name))
    section["ros__parameters"][parameter] = str(path)
    return yaml.safe_dump(document)


def by_stamp(node: Node, messages) -> dict[int, tuple[np.ndarray, float]]:
    """Return stamp → attitude for the outputs that are not INVALID; assert that these stamps increase."""
    claimed = [message for message in messages if message.status != INVALID]
    stamps = [ns_from_stamp(message.header.stamp) for message in claimed]
    assert all(later > earlier for earlier, later in pairwise(stamps))
    return {stamp: node.read(message) for stamp, message in zip(stamps, claimed, strict=True)}


def count_invalid(messages) -> int:
    """Return the number of INVALID messages after the first message that is not INVALID."""
    claims = [message.status != INVALID for message in messages]
    return claims[claims.index(True) :].count(False) if True in claims else len(claims)


def angles_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return angles (rad) between orientations (n, 4), to first order, which is accurate for small angles."""
    return 2.0 * np.minimum(np.linalg.norm(first - second, axis=1), np.linalg.norm(first + second, axis=1))


def flat_numbers(tree, name="") -> dict[str, float]:
    """Return dotted name → number of everything in a saved file."""
    if isinstance(tree, dict):
        return {k: v for key, part in tree.items() for k, v in flat_numbers(part, f"{name}.{key}").items()}
    if isinstance(tree, list):
        return {k: v for key, part in enumerate(tree) for k, v in flat_numbers(part, f"{name}.{key}").items()}
    return {name: float(tree)} if isinstance(tree, int | float) else {}


def test_no_message_is_lost(runs):
    path, node, _, live, _ = runs
    with read_bag(path) as bag:
        sent: dict[str, int] = {}
        for record in bag.records():
            sent[record.topic] = sent.get(record.topic, 0) + 1
    given = {topic.topic for topic in node.adapter.outputs}
    played = {topic: count for topic, count in live.counts.items() if topic in sent.keys() - given}
    assert {node.sample, "truth/attitude"} <= played.keys()
    assert played == {topic: sent[topic] for topic in played}
    assert live.cut == 0


def test_the_node_publishes_for_every_sample(runs):
    _, _, offline, live, _ = runs
    assert len(offline.attitudes) > 1000
    assert live.attitudes.keys() == offline.attitudes.keys()


def test_attitudes_differ_only_by_the_inputs_received_before(runs):
    _, _, offline, live, _ = runs
    stamps = sorted(offline.attitudes)
    orientation, last_in = (np.array([offline.attitudes[s][part] for s in stamps]) for part in (0, 1))
    live_orientation, live_last_in = (np.array([live.attitudes[s][part] for s in stamps]) for part in (0, 1))
    # True where both runs have used the same measurement last, or none yet.
    same = np.isclose(last_in, live_last_in, rtol=1e-9, atol=0.0, equal_nan=True)
    # A star measurement may arrive before or after two of twenty INS samples, an image of lights before or after one of
    # ten encoder readings.
    assert np.mean(same) > 0.8
    assert angles_between(orientation[same], live_orientation[same]).max() < SAME_RAD


def test_the_final_states_are_the_same(runs):
    _, _, offline, live, _ = runs
    expected, found = flat_numbers(offline.saved), flat_numbers(live.saved)
    assert expected.keys() == found.keys()
    assert any("covariance" in name for name in expected)
    # Angles are saved in degrees, so the same bound is tighter for angles.
    differences = {name: abs(found[name] - value) for name, value in expected.items()}
    assert {name: value for name, value in differences.items() if value > SAME_RAD} == {}


def test_the_live_run_meets_the_bounds(runs):
    path, _, _, _, recorded_path = runs
    bounds = read_bounds(path.with_suffix(".expected.yaml"))
    with read_bag(path) as played, read_bag(recorded_path) as recorded:
        # On a busy machine the first message reaches the recorder late: less time is skipped, to skip the same stamps.
        late_s = (recorded.start_ns - played.start_ns) / NS_PER_S
    checked = check_bounds(evaluate(recorded_path, path, bounds.skip_s - late_s).quantities(), bounds, path.name)
    assert [bound.line for bound in checked if not bound.is_met] == []
