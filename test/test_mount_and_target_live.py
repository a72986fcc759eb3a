"""Stars on the mount, targets and triangulation through the live nodes over DDS, compared with replay and truth."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.stamps import ns_from_stamp
from ship_bags.topic_names import relative_topic
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import ENU_FROM_HORIZON
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_node.adapters.adapter import Adapter
from ship_replay.offline.replay import ADAPTERS, replay
from ship_simulation.simulate_command import write_bag
from ship_testing.theodolite_scenes import bag_scenario, with_stars_and_targets
from ship_testing.theodolite_stations import buoy_direction, buoy_n, direction_message, triangulation_values
from ship_testing.trials.live_run import LiveRun
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.adapters.triangulation_adapter import POSITION_TOPIC, TriangulationAdapter
from theodolite_calib.samples.samples import Mode

pytestmark = [pytest.mark.live, pytest.mark.smoke]

START_NS, PERIOD_NS, LATENCY_NS = 1_767_225_600_000_000_000, 100_000_000, 50_000_000
SIGMA = 3.0 * ARCSEC
TRUTH, DIRECTION, POINTING = "truth/target_direction", "theodolite/target_direction", "theodolite/pointing"

Messages = dict[str, list[Any]]


def messages(path: Path) -> Messages:
    """Return relative topic → its messages."""
    found: Messages = {}
    with read_bag(path) as bag:
        for record in bag.records():
            found.setdefault(relative_topic(record.topic) or "", []).append(record.decode())
    return found


def live_and_offline(
    bag: Path, adapter: type[Adapter], folder: Path, rate: float, parameters: dict[str, str]
) -> tuple[Messages, Messages]:
    """Return the outputs of the live node with the truth, and those of the replay."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        with LiveRun(bag, adapter, "theodolite_calib", folder / "live", parameters) as run:
            run.play(rate)
            assert run.node.end() == 0, run.node.log_text()
    replay(bag, folder / "offline.mcap", ADAPTERS)
    return messages(run.recorded_path), messages(folder / "offline.mcap")


def by_stamp(found: list[Any]) -> dict[int, Any]:
    return {ns_from_stamp(message.header.stamp): message for message in found if message.status != Status.INVALID}


def vector(of: Any) -> np.ndarray:
    return np.array([of.x, of.y, of.z])


def square(error: np.ndarray, covariance: Any) -> float:
    """Return the normalised error squared of a direction, with a covariance of rank two, or of a position."""
    return float(error @ np.linalg.pinv(np.reshape(covariance, (3, 3)), rcond=1e-9, hermitian=True) @ error)


@pytest.fixture(scope="module", name="runs")
def _runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Messages, Messages]:
    folder = tmp_path_factory.mktemp("run")
    write_bag(with_stars_and_targets(bag_scenario(duration_s=10.0)), 3, folder / "in.mcap", b"")
    return live_and_offline(folder / "in.mcap", OpticalAxisAdapter, folder, 2.0, {})


def test_directions_of_every_image_are_those_of_replay_and_truth(runs: tuple[Messages, Messages]) -> None:
    live, offline = runs
    truths = by_stamp(live[TRUTH])
    published, replayed = by_stamp(live[DIRECTION]), by_stamp(offline[DIRECTION])
    assert len(truths) > 90
    # The images at both ends may lack a pointing before or after them.
    assert set(published) >= set(sorted(truths)[1:-3])
    off_rad = [np.linalg.norm(vector(published[ns].direction) - vector(replayed[ns].direction)) for ns in published]
    # Live and replayed directions differ if lights or stars arrived earlier or later.
    assert np.mean(np.array(off_rad) < 1e-9) > 0.8
    for time_ns, message in published.items():
        truth = truths[time_ns]
        # Chi-square with two degrees: beyond 27.6 is one in a million; with three beyond 30.7.
        assert square(vector(truth.direction) - vector(message.direction), message.direction_covariance) < 27.6
        assert square(vector(truth.position) - vector(message.position), message.position_covariance) < 30.7


def test_stars_and_lights_point_in_the_live_node(runs: tuple[Messages, Messages]) -> None:
    live, _ = runs
    modes = [message.mode for message in live[POINTING]]
    assert modes.count(Mode.STARS_AND_LIGHTS) > 0.8 * len(modes)
    accepted = [message for message in live["theodolite/innovation"] if message.source == "star.night"]
    assert sum(message.accepted for message in accepted) > 40


@pytest.fixture(scope="module", name="stations")
def _stations(tmp_path_factory: pytest.TempPathFactory) -> tuple[Messages, Messages, Path]:
    """Return live outputs, replayed outputs and the black box, for directions of three theodolites to a buoy.

    The directions last ten seconds; each theodolite has its own times.
    """
    folder, rng = tmp_path_factory.mktemp("stations"), np.random.default_rng(5)
    epochs = [(START_NS + index * PERIOD_NS + 10_000_000 * n, n) for index in range(100) for n in range(3)]
    with BagWriter(folder / "in.mcap") as bag:
        suite = {"/**/triangulation": {"ros__parameters": triangulation_values(3)}}
        bag.add_attachment(SUITE_ATTACHMENT, yaml.safe_dump(suite))
        for time_ns, number in epochs:
            seen_n = exp_rotation(SIGMA * rng.standard_normal(3)) @ buoy_direction(number, (time_ns - START_NS) * 1e-9)
            message = direction_message(time_ns, seen_n, SIGMA)
            bag.write(f"t{number}/theodolite/target_direction", message, time_ns + LATENCY_NS)
    black_box = folder / "box.mcap"
    return *live_and_offline(
        folder / "in.mcap", TriangulationAdapter, folder, 4.0, {"black_box": str(black_box)}
    ), black_box


def test_places_are_published_live_and_are_those_of_replay_and_truth(stations: tuple[Messages, Messages, Path]) -> None:
    live, offline, _ = stations
    published, replayed = by_stamp(live[POSITION_TOPIC]), by_stamp(offline[POSITION_TOPIC])
    # Positions have the times of the first theodolite's directions. If such a direction is missing or late, the
    # position has the time of another theodolite.
    assert sum((time_ns - START_NS) % PERIOD_NS == 0 for time_ns in published) >= 95
    same = sorted(published.keys() & replayed.keys())
    assert len(same) >= 95
    off_m = [np.linalg.norm(vector(published[ns].position) - vector(replayed[ns].position)) for ns in same]
    # A direction that arrived earlier or later changes the interpolation between its neighbours.
    assert np.median(off_m) < 1e-6
    for time_ns in same:
        error_m = vector(published[time_ns].position) - ENU_FROM_HORIZON @ buoy_n((time_ns - START_NS) * 1e-9)
        assert square(error_m, published[time_ns].position_covariance) < 30.7


def test_the_black_box_of_the_node_is_equal_to_the_last_bit(
    stations: tuple[Messages, Messages, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    from ship_replay.commands.replay import main

    code = main([str(stations[2]), "--verify"])
    printed = capsys.readouterr()
    assert code == 0, printed.out + printed.err
    assert "outputs are equal to the last bit" in printed.out
