"""star_attitude in the suite: replayed with ship_attitude in one pass, from its black box, and live over DDS."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message, serialize_message

from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_factory import RosidlFactory
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import ns_from_stamp
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_geometry.frames import horizon_covariance, rotation_from_angles
from ship_geometry.rotations import log_rotation
from ship_node.black_box.black_box import BlackBox
from ship_node.live.adapter_calls import AdapterCalls
from ship_node.live.node_clock import TickGrid
from ship_node.saved_files.saved_document import RecordingFiles
from ship_replay.commands.replay import main as replay
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import star_attitude_configuration
from ship_testing import small_voyage, star_voyage
from ship_testing.one_message import process_message
from ship_testing.trials.live_run import LiveRun

ROOT = Path(__file__).parents[1]

SEEDS = 50
SOLUTIONS = ("star/fore/solution", "star/starboard/solution")
SHIP = "ship/attitude"
VALID = 0


def star_values(**changes: Any) -> dict[str, Any]:
    sensors = {
        id_: {
            "azimuth_deg": azimuth_deg,
            "elevation_deg": 45.0,
            "frame_id": f"star_{id_}",
            "camera": dict(star_voyage.CAMERA_PARAMETERS),  # rcl does not support YAML aliases
        }
        for id_, azimuth_deg in (("fore", 0.0), ("starboard", 90.0))
    }
    return {"ins": {"frame_id": "ins"}, "star_sensors": sensors, **changes}


def suite(*nodes: str) -> str:
    """Return the configuration of some nodes; ship_attitude uses the solutions."""
    ship = star_values()
    for sensor in ship["star_sensors"].values():
        sensor["input"] = "solution"
        del sensor["camera"]
    values = {"star_attitude": star_values(), "ship_attitude": ship}
    return yaml.safe_dump({node: {"ros__parameters": values[node]} for node in nodes})


def write(path: Path, suite_text: str, further: Iterable[BagRecord] = (), without: str = "nothing") -> Path:
    """Write the voyage as a bag."""
    with BagWriter(path) as bag:
        bag.add_attachment(SUITE_ATTACHMENT, suite_text)
        kinds = {topic.topic: topic.type_name for topic in star_voyage.new_adapter().inputs}
        for arrival in star_voyage.voyage(noise=True):
            if not arrival.topic.endswith(without):
                data = serialize_message(arrival.message)
                bag.write_raw(arrival.topic, kinds[arrival.topic], data, arrival.receive_ns)
        for record in further:
            bag.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    return path


def records(path: Path, *topics: str) -> list[BagRecord]:
    with read_bag(path) as bag:
        return list(bag.records(topics or None))


def bytes_of(path: Path, *topics: str) -> list[tuple[str, int, bytes]]:
    return [(record.topic, record.log_time_ns, record.data) for record in records(path, *topics)]


def ship_bytes(path: Path) -> list[tuple[str, int, bytes]]:
    """Return the ship's attitudes since the first INS sample; before, only ticks publish INVALID attitudes."""
    return [entry for entry in bytes_of(path, SHIP) if entry[1] > small_voyage.START_NS]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the voyage, and the outputs of a replay of both nodes."""
    folder = tmp_path_factory.mktemp("both")
    bag, out = write(folder / "in.mcap", suite("star_attitude", "ship_attitude")), folder / "out.mcap"
    assert replay([str(bag), "--out", str(out)]) == 0
    return bag, out


def test_solutions_are_used_by_the_ship_attitude_in_one_pass(both: tuple[Path, Path]) -> None:
    _, out = both
    attitudes = [record.decode() for record in records(out, SHIP)]
    assert len(records(out, *SOLUTIONS)) == len(star_voyage.with_topics(star_voyage.voyage(), *star_voyage.AZIMUTH_DEG))
    assert attitudes[-1].status == VALID
    assert list(attitudes[-1].sources) == ["ins", "star.fore", "star.starboard"]


def test_one_pass_is_equal_to_separate_replays_to_the_last_bit(
    both: tuple[Path, Path], tmp_path: Path
) -> None:
    stars_only = write(tmp_path / "1.mcap", suite("star_attitude"))
    assert replay([str(stars_only), "--out", str(tmp_path / "2.mcap")]) == 0
    assert bytes_of(tmp_path / "2.mcap", *SOLUTIONS) == bytes_of(both[1], *SOLUTIONS)
    assert SHIP not in {record.topic for record in records(tmp_path / "2.mcap")}

    solutions = records(tmp_path / "2.mcap", *SOLUTIONS)
    second = write(tmp_path / "3.mcap", suite("ship_attitude"), solutions, without="observations")
    assert replay([str(second), "--out", str(tmp_path / "4.mcap")]) == 0
    assert ship_bytes(tmp_path / "4.mcap") == ship_bytes(both[1])


def test_solutions_recorded_with_the_observations_are_not_used_twice(
    both: tuple[Path, Path], tmp_path: Path
) -> None:
    bag = write(tmp_path / "in.mcap", suite("star_attitude", "ship_attitude"), records(both[1], *SOLUTIONS))
    assert replay([str(bag), "--out", str(tmp_path / "out.mcap")]) == 0
    assert bytes_of(tmp_path / "out.mcap", SHIP, *SOLUTIONS) == bytes_of(both[1], SHIP, *SOLUTIONS)


def test_without_observations_the_recorded_solutions_are_used(
    both: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = suite("star_attitude", "ship_attitude")
    bag = write(tmp_path / "in.mcap", text, records(both[1], *SOLUTIONS), without="observations")
    assert replay([str(bag), "--out", str(tmp_path / "out.mcap")]) == 0
    assert ship_bytes(tmp_path / "out.mcap") == ship_bytes(both[1])
    assert "star_attitude is not replayed: the bag has no star/fore/observations" in capsys.readouterr().out


def test_a_bag_with_inputs_and_outputs_of_both_nodes_is_verified(
    both: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = suite("star_attitude", "ship_attitude")
    bag = write(tmp_path / "in.mcap", text, records(both[1], SHIP, *SOLUTIONS, "star/joint/solution"))
    assert replay([str(bag), "--verify"]) == 0, capsys.readouterr().out
    out = capsys.readouterr().out
    assert "star/fore/solution 15" in out.partition("equal:")[2]
    assert f"{SHIP} {len(records(both[1], SHIP))}" in out.partition("equal:")[2]


@pytest.mark.statistics
def test_the_error_of_the_joint_solution_fits_its_covariance_over_many_voyages() -> None:
    """Scenario ``paper_stars``: each seed draws mounting, refraction, UT1 and place, and gives one solution."""
    low, high = mean_nees_band(SEEDS, 3)
    assert low < np.mean(joint_nees(SEEDS)) < high


@pytest.mark.statistics
def test_the_error_of_the_joint_solution_of_streaks_fits_its_covariance() -> None:
    """Exposures of a fifth of a second of a ship that rolls 4° in 11 s."""
    low, high = mean_nees_band(SEEDS, 3)
    assert low < np.mean(joint_nees(SEEDS, exposure_s=0.2)) < high
    # With a configured point spread of 100 px the streaks count as short, and no solution is consistent (NaN).
    assert not np.mean(joint_nees(5, exposure_s=0.2, configured_psf_px=100.0)) < high


def joint_nees(seeds: int, exposure_s: float = 0.0, configured_psf_px: float | None = None) -> list[float]:
    """Return NEES of one joint solution of each of many voyages."""
    scenario = dataclasses.replace(load_scenario(ROOT / "bags" / "scenarios" / "paper_stars.yaml"), duration_s=1.0)
    sensors = {id_: dataclasses.replace(s, exposure_s=exposure_s) for id_, s in scenario.star_sensors.items()}
    scenario = dataclasses.replace(scenario, star_sensors=sensors)
    values = star_attitude_configuration(scenario)
    if configured_psf_px is not None:
        for sensor in values["star_sensors"].values():
            sensor["camera"]["psf_sigma_px"] = configured_psf_px
    config = build(StarAttitudeConfig, values)
    nees = []
    for seed in range(seeds):
        adapter, truth, joint = StarAttitudeAdapter(config, RosbagsFactory()), {}, []
        topics = {topic.topic for topic in adapter.inputs}
        for topic, message, log_time_ns in generate_messages([simulate(scenario, seed)], RosbagsFactory()):
            if topic == "truth/attitude":
                rotation_nd = rotation_from_angles(message.heading, message.pitch, message.roll)
                truth[ns_from_stamp(message.header.stamp)] = rotation_nd
            elif topic in topics:
                given = process_message(adapter, topic, message, log_time_ns)
                joint += [solved for name, solved in given if name == "star/joint/solution"]
        last = joint[-1]
        error = log_rotation(truth[ns_from_stamp(last.header.stamp)] @ star_voyage.solution_rotation(last).T)
        nees.append(normalized_error_squared(error, horizon_covariance(last.rotation_covariance.reshape(3, 3))))
    return nees


class _NoSubscriber:
    """Publisher without subscribers."""

    def publish(self, message: Any) -> None:
        """Discard the message."""


def test_a_black_box_of_the_node_is_equal_to_the_last_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, files = star_voyage.config(), RecordingFiles()
    adapter = StarAttitudeAdapter(config, RosidlFactory(), files)
    black_box = BlackBox(str(tmp_path / "box.mcap"), adapter, config, adapter.outputs, "/", print)
    calls = AdapterCalls(adapter, {output.topic: _NoSubscriber() for output in adapter.outputs}, files, black_box)
    grid = TickGrid()
    for number, arrival in enumerate(star_voyage.voyage(noise=True)):
        for tick_ns in grid.ticks_until(arrival.receive_ns):
            calls.tick(tick_ns)
        if number == 40:
            calls.set_parameters({"star_sensors.fore.camera.centroid_sigma_px": 0.1}, arrival.receive_ns)
        if number == 80:
            assert calls.service("reset", arrival.receive_ns).success
        data = serialize_message(arrival.message)
        # The message has passed the middleware, where sigma_px and magnitude have single precision.
        calls.handle(arrival.topic, data, deserialize_message(data, type(arrival.message)), arrival.receive_ns)
    black_box.close()

    assert replay([str(tmp_path / "box.mcap"), "--verify"]) == 0, capsys.readouterr().out
    out = capsys.readouterr().out
    for used in ("parameters 1", "~/reset 1", "star/fore/observations 15"):
        assert used in out.partition("equal:")[0]
    for equal in ("star/fore/solution 15", "star/joint/solution 1", "star/joint/error_budget"):
        assert equal in out.partition("equal:")[2]


@pytest.mark.smoke
@pytest.mark.live
def test_live_over_dds_the_outputs_and_the_black_box_are_the_same(
    both: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    path = tmp_path / "box.mcap"
    with LiveRun(both[0], StarAttitudeAdapter, "ship_attitude_star", tmp_path / "run", {"black_box": str(path)}) as run:
        run.play(rate=1.0)
    live = {(r.topic.lstrip("/"), stamp(r)): attitude(r) for r in records(run.recorded_path) if "solution" in r.topic}
    for record in records(both[1], *SOLUTIONS):
        # The position may be interpolated from one fix more or less.
        assert np.max(np.abs(live[record.topic, stamp(record)] - attitude(record))) < 1e-11
    assert replay([str(path), "--verify"]) == 0, capsys.readouterr().out


def stamp(record: BagRecord) -> int:
    return ns_from_stamp(record.decode().header.stamp)


def attitude(record: BagRecord) -> np.ndarray:
    message = record.decode()
    return np.array([message.azimuth, message.elevation, message.roll])
