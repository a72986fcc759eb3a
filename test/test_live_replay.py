"""Every bag in bags/ through the live node over DDS, held against the same bag replayed offline.

Nothing may be lost, and what the node says may differ only by what had arrived when it said it: a star measurement a
moment earlier or later than an INS sample. Once both have taken everything, their states are the same.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_attitude_star.config import ShipAttitudeConfig
from ship_node.parameter_file import load_config
from ship_node.stamps import ns_from_stamp
from ship_node.tick_grid import TickGrid
from ship_replay.bag_reader import read_bag
from ship_replay.bag_writer import SUITE_ATTACHMENT
from ship_replay.bounds import judge, read_bounds
from ship_replay.evaluate import evaluate
from ship_replay.live_run import LiveRun
from ship_replay.message_store import RosbagsFactory
from ship_replay.topic_names import relative_topic

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.xdist_group("dds")]

BAGS = sorted((Path(__file__).parents[1] / "bags").glob("*.mcap"))
RATE = 2.0
"""Seconds of the bag per second: INS samples come at 200 Hz."""
SAME_RAD = 1e-9
INVALID = 3


@dataclass
class Outcome:
    """What one way of running a bag gave.

    Attributes:
        attitudes: stamp → (orientation x, y, z, w; age of the last star measurement used, s).
        saved: the alignment saved at the end.
        counts: relative topic → messages in the recorded bag; empty offline.
    """

    attitudes: dict[int, tuple[np.ndarray, float]]
    saved: dict
    counts: dict[str, int]


@pytest.fixture(scope="module", params=BAGS, ids=lambda path: path.stem)
def runs(request, tmp_path_factory):
    """(bag, offline outcome, live outcome, recorded bag)."""
    folder = tmp_path_factory.mktemp(request.param.stem)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        recorded_path = folder / "live" / "recorded.mcap"
        live = run_live(request.param, folder / "live")
    return request.param, run_offline(request.param, folder / "offline.yaml"), live, recorded_path


def run_offline(path: Path, alignment_path: Path) -> Outcome:
    """The bag through the adapter, message by message, as `replay` does it, and the alignment saved at the end."""
    published, grid = [], TickGrid()
    with read_bag(path) as bag:
        config = load_config(ShipAttitudeConfig, with_alignment_file(bag, alignment_path), "ship_attitude")
        adapter = ShipAttitudeAdapter(config, RosbagsFactory())
        topics = {topic.topic for topic in adapter.inputs}
        for record in bag.records(topics):
            for tick_ns in grid.due(record.log_time_ns):
                published += adapter.tick(tick_ns)
            published += adapter.handle(record.topic, record.decode(), record.log_time_ns)
    result = adapter.service("save_alignment", record.log_time_ns)
    assert result.success, result.message
    attitudes = [message for topic, message in published if topic == "ship/attitude"]
    return Outcome(by_stamp(attitudes), yaml.safe_load(alignment_path.read_text(encoding="utf-8")), {})


def run_live(path: Path, folder: Path) -> Outcome:
    """The bag through the node's process, and the alignment saved by its service."""
    from std_srvs.srv import Trigger

    alignment_path = folder / "alignment.yaml"
    parameters = {"alignment_file": str(alignment_path)}
    with LiveRun(path, ShipAttitudeAdapter, "ship_attitude_star", folder, parameters) as run:
        run.play(RATE)
        client = run.observer.node.create_client(Trigger, "/ship_attitude/save_alignment")
        assert run.observer.spin_until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        assert run.observer.spin_until(answer.done)
        assert answer.result().success, answer.result().message
        assert run.node.end() == 0, run.node.log()
    counts: dict[str, int] = {}
    attitudes = []
    with read_bag(run.recorded_path) as bag:
        for record in bag.records():
            topic = relative_topic(record.topic)
            counts[topic] = counts.get(topic, 0) + 1
            if topic == "ship/attitude":
                attitudes.append(record.decode())
        assert bag.problems == []
    return Outcome(by_stamp(attitudes), yaml.safe_load(alignment_path.read_text(encoding="utf-8")), counts)


def with_alignment_file(bag, alignment_path: Path) -> str:
    """The attached configuration with an alignment file of our own."""
    document = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT])
    document["ship_attitude"]["ros__parameters"]["alignment_file"] = str(alignment_path)
    return yaml.safe_dump(document)


def by_stamp(messages) -> dict[int, tuple[np.ndarray, float]]:
    """Attitudes that claim something, by stamp; stamps must increase."""
    stamps = [ns_from_stamp(message.header.stamp) for message in messages]
    assert all(later > earlier for earlier, later in pairwise(stamps))
    return {
        stamp: (np.array([getattr(message.orientation, axis) for axis in "xyzw"]), message.star_age_s)
        for stamp, message in zip(stamps, messages, strict=True)
        if message.status != INVALID
    }


def angles_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles (rad) between orientations (n, 4), to first order, in which alone a small one is exact."""
    return 2.0 * np.minimum(np.linalg.norm(first - second, axis=1), np.linalg.norm(first + second, axis=1))


def flat_numbers(tree, name="") -> dict[str, float]:
    """Dotted name → number of everything in a saved alignment."""
    if isinstance(tree, dict):
        return {k: v for key, part in tree.items() for k, v in flat_numbers(part, f"{name}.{key}").items()}
    if isinstance(tree, list):
        return {k: v for key, part in enumerate(tree) for k, v in flat_numbers(part, f"{name}.{key}").items()}
    return {name: float(tree)} if isinstance(tree, int | float) else {}


def test_no_message_is_lost(runs):
    path, _, live, _ = runs
    with read_bag(path) as bag:
        sent: dict[str, int] = {}
        for record in bag.records():
            sent[record.topic] = sent.get(record.topic, 0) + 1
    played = {topic: count for topic, count in live.counts.items() if topic in sent}
    assert {"ins/imu", "truth/attitude"} <= played.keys()
    assert played == {topic: sent[topic] for topic in played}


def test_the_node_answers_every_ins_sample(runs):
    _, offline, live, _ = runs
    assert len(offline.attitudes) > 1000
    assert live.attitudes.keys() == offline.attitudes.keys()


def test_attitudes_differ_only_by_what_had_arrived(runs):
    _, offline, live, _ = runs
    stamps = sorted(offline.attitudes)
    orientation, age_s = (np.array([offline.attitudes[s][part] for s in stamps]) for part in (0, 1))
    live_orientation, live_age_s = (np.array([live.attitudes[s][part] for s in stamps]) for part in (0, 1))
    # The age tells which star measurement was the last in: the same one, or none yet in both.
    same = (age_s == live_age_s) | (np.isnan(age_s) & np.isnan(live_age_s))
    # Of twenty INS samples there are two at which a star measurement may come before or after.
    assert np.mean(same) > 0.8
    assert angles_between(orientation[same], live_orientation[same]).max() < SAME_RAD


def test_the_final_states_are_the_same(runs):
    _, offline, live, _ = runs
    expected, found = flat_numbers(offline.saved), flat_numbers(live.saved)
    assert expected.keys() == found.keys()
    assert any("covariance" in name for name in expected)
    # Angles are saved in degrees, so the same bound in their unit is the tighter one.
    differences = {name: abs(found[name] - value) for name, value in expected.items()}
    assert {name: value for name, value in differences.items() if value > SAME_RAD} == {}


def test_the_live_run_meets_the_bounds(runs):
    path, _, _, recorded_path = runs
    bounds = read_bounds(path.with_suffix(".expected.yaml"))
    judged = judge(evaluate(recorded_path, path, bounds.skip_s).flat(), bounds, path.name)
    assert [bound.line for bound in judged if not bound.met] == []
