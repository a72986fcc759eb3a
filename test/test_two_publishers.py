"""Two publishers on one input, named by the live node or found by their values: outputs by this input are not VALID.

The detection of two publishers in a live node is tested in ship_node/test/test_live_node.py.
"""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import exp_rotation
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.replay import main as replay
from ship_testing import small_session, small_voyage, star_voyage
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrivals

DEMO = Path(__file__).parents[1] / "bags" / "demo.mcap"
TEXT = "two publishers send on it: /one and /other; end all but one"


def part(arrivals: Arrivals, since_s: float, until_s: float) -> Arrivals:
    since_ns, until_ns = (START_NS + round(s * SECOND_NS) for s in (since_s, until_s))
    return tuple(arrival for arrival in arrivals if since_ns <= arrival.receive_ns < until_ns)


def statuses(adapter: Any, drive: Callable[..., Any], arrivals: Arrivals, topic: str, output: str) -> list[set[int]]:
    """Return statuses of an output before, during and after two publishers on a topic: from 2 s to 4 s, of 6 s."""
    found = []
    for since_s, until_s, text in ((-1.0, 2.0, ""), (2.0, 4.0, TEXT), (4.0, 9.0, "")):
        adapter.set_duplicate_publishers(topic, text)
        run = drive(adapter, part(arrivals, since_s, until_s))
        _, statuses_now = adapter.health.messages_and_statuses(adapter.factory, run.now_ns, run.now_ns)
        health = next(status for status in statuses_now if status.name == f"input {topic}")
        assert (health.message == TEXT) == bool(text)
        found.append({message.status for message in run.messages(output)[3:]})
    return found


@pytest.mark.parametrize("topic", [small_voyage.INS, small_voyage.FORE])
def test_an_attitude_by_two_publishers_is_degraded_and_valid_again_at_once(topic: str) -> None:
    arrivals = small_voyage.voyage(6.0)
    found = statuses(small_voyage.new_adapter(), small_voyage.run_adapter, arrivals, topic, "ship/attitude")
    assert Status.VALID in found[0]
    assert found[1:] == [{Status.DEGRADED}, {Status.VALID}]


@pytest.mark.parametrize("topic", [star_voyage.FORE, star_voyage.FIX, star_voyage.PRESSURE])
def test_stars_by_two_publishers_are_not_solved(topic: str) -> None:
    arrivals, output = star_voyage.voyage(6.0), "star/fore/solution"
    before, meanwhile, after = statuses(star_voyage.new_adapter(), star_voyage.run_adapter, arrivals, topic, output)
    assert before == after != meanwhile == {3}, "StarHorizonAttitude.INVALID"


def test_stars_are_solved_without_an_ins_of_two_publishers() -> None:
    arrivals, adapter = star_voyage.voyage(6.0), star_voyage.new_adapter()
    found = statuses(adapter, star_voyage.run_adapter, arrivals, star_voyage.INS, "star/fore/solution")
    assert {3} not in found


@pytest.mark.parametrize(
    "topic", ["theodolite/encoder", "ship/attitude", "theodolite/beacons", "beacon/alpha/baseline"]
)
def test_a_pointing_by_two_publishers_is_degraded_and_valid_again_at_once(topic: str) -> None:
    arrivals = small_session.session(6.0)
    found = statuses(small_session.new_adapter(), small_session.run_adapter, arrivals, topic, "theodolite/pointing")
    assert found[0] >= {Status.VALID}
    assert found[1:] == [{Status.DEGRADED}, {Status.VALID}]


@pytest.fixture(scope="module", name="bag")
def _bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the first 12 s of a voyage; from 4 s to 8 s a second INS also publishes, half a degree off."""
    path, other = tmp_path_factory.mktemp("two") / "two.mcap", exp_rotation([0.0, 0.0, np.deg2rad(0.5)])
    with read_bag(DEMO) as bag, BagWriter(path) as out:
        for name, content in bag.attachments.items():
            out.add_attachment(name, content)
        assert bag.start_ns is not None
        held: list[tuple[int, str, Any]] = []
        for record in bag.records():
            since_s = (record.log_time_ns - bag.start_ns) / SECOND_NS
            if since_s > 12.0:
                break
            message = record.decode()
            held.append((record.log_time_ns, record.topic, message))
            if record.topic == small_voyage.INS and 4.0 <= since_s < 8.0:
                held.append((record.log_time_ns + 3_000_000, record.topic, second_ins_sample(message, other, 0.003)))
        for time_ns, topic, message in sorted(held, key=lambda entry: entry[:2]):
            out.write(topic, message, time_ns)
    return path


def second_ins_sample(message: Any, other: np.ndarray, later_s: float) -> Any:
    """Return a sample of a second INS, rotated by ``other`` against the first, ``later_s`` after the given sample."""
    message = copy.deepcopy(message)
    rate, turned = message.angular_velocity, message.orientation
    turn = exp_rotation(later_s * np.array([rate.x, rate.y, rate.z])) @ other
    q = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w]) * Rotation.from_matrix(turn)
    turned.x, turned.y, turned.z, turned.w = q.as_quat().tolist()
    message.header.stamp.nanosec += round(later_s * SECOND_NS)
    return message


def test_two_ins_in_a_bag_are_reported_until_they_end(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.mcap"
    assert replay([str(bag), "--out", str(out)]) == 0
    assert "two streams alternate on ins/imu, 0.5° apart" in capsys.readouterr().out
    with read_bag(out) as replayed, read_bag(bag) as given:
        start_ns = given.start_ns
        records = replayed.records({"ship/attitude"})
        statuses = [(record.log_time_ns - start_ns, record.decode().status) for record in records]
    assert {status for ns, status in statuses if 4.2e9 < ns < 8e9} == {Status.DEGRADED}
    assert {status for ns, status in statuses if ns > 10e9} == {Status.VALID}
    assert {status for ns, status in statuses if 1e9 < ns < 4e9} == {Status.VALID}


def test_check_config_names_two_ins_in_a_bag(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with read_bag(bag) as content:
        (tmp_path / "suite.yaml").write_bytes(content.attachments["suite.yaml"])
    assert check_config([str(tmp_path / "suite.yaml"), str(bag)]) == 0
    assert "two streams alternate on ins/imu, 0.5° apart" in capsys.readouterr().out


def test_blocks_and_single_messages_report_two_ins_equally(bag: Path, tmp_path: Path) -> None:
    replayed = []
    for option in ([], ["--one-by-one"]):
        out = tmp_path / f"out{len(option)}.mcap"
        assert replay([str(bag), "--out", str(out), *option]) == 0
        with read_bag(out) as recorded:
            replayed.append([(r.topic, r.log_time_ns, bytes(r.data)) for r in recorded.records()])
    assert replayed[0] == replayed[1]


def test_two_star_sensors_on_one_topic_of_a_bag_are_found_by_their_innovations(tmp_path: Path) -> None:
    path, out = tmp_path / "two.mcap", tmp_path / "out.mcap"
    with read_bag(DEMO) as bag, BagWriter(path) as written:
        for name, content in bag.attachments.items():
            written.add_attachment(name, content)
        assert bag.start_ns is not None
        for record in bag.records():
            since_s = (record.log_time_ns - bag.start_ns) / SECOND_NS
            if since_s > 30.0:
                break
            message = record.decode()
            written.write(record.topic, message, record.log_time_ns)
            if record.topic == small_voyage.FORE and since_s > 10.0:
                message.azimuth += np.deg2rad(0.1)
                message.header.stamp.nanosec += 1000
                written.write(record.topic, message, record.log_time_ns)
    assert replay([str(path), "--out", str(out)]) == 0
    with read_bag(out) as replayed:
        statuses = [s for record in replayed.records({"/diagnostics"}) for s in record.decode().status]
    found = f"two streams alternate on {small_voyage.FORE}, "
    assert any(status.message.startswith(found) for status in statuses)
