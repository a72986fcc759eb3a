"""Images of a target in a bag: directions fit the truth, in blocks and one by one, and pointings are unchanged.

The bag is simulated (theodolite_night.yaml): the detector turns, and the target moves around on it.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import ns_from_stamp
from ship_estimation.time_order.outcome import Status
from ship_replay.offline.replay import ADAPTERS, replay
from ship_simulation.simulate_command import write_bag
from ship_simulation.suite_file import suite_yaml
from ship_testing.theodolite_scenes import bag_scenario, with_stars_and_targets

TARGET, DIRECTION, TRUTH = "theodolite/target", "theodolite/target_direction", "truth/target_direction"


@pytest.fixture(scope="module", name="voyage")
def _voyage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[int, Any]]:
    """Return the folder of a bag with images, its suite file, and the true directions and places by stamp."""
    folder, scenario = tmp_path_factory.mktemp("target"), with_stars_and_targets(bag_scenario(duration_s=10.0))
    scenario = dataclasses.replace(scenario, telescopes={})
    write_bag(scenario, 3, folder / "in.mcap", b"")
    (folder / "suite.yaml").write_text(suite_yaml(scenario))
    truths = {}
    with read_bag(folder / "in.mcap") as bag, BagWriter(folder / "plain.mcap") as plain:
        for record in bag.records():
            if record.topic == TRUTH:
                truths[record.log_time_ns] = record.decode()
            elif record.topic != TARGET:
                plain.write(record.topic, record.decode(), record.log_time_ns)
    return folder, folder / "suite.yaml", truths


def replay_bag(folder: Path, bag: str, suite: Path, *, one_by_one: bool = False) -> list[tuple[str, bytes, int]]:
    out = folder / f"{Path(bag).stem}_{one_by_one}.mcap"
    summary = replay(folder / bag, out, ADAPTERS, suite, one_by_one=one_by_one)
    assert summary.problems == []
    with read_bag(out) as replayed_bag:
        return [(record.topic.strip("/"), bytes(record.data), record.log_time_ns) for record in replayed_bag.records()]


def test_errors_of_directions_and_places_fit_their_covariances(voyage) -> None:
    folder, suite, truths = voyage
    replay(folder / "in.mcap", folder / "out.mcap", ADAPTERS, suite)
    with read_bag(folder / "out.mcap") as bag:
        published = [record.decode() for record in bag.records() if record.topic.strip("/") == DIRECTION]
    claimed = [message for message in published if message.status != Status.INVALID]
    assert len(published) >= len(truths) - 2
    # Images at the ends of the voyage have no pointing on both sides.
    assert len(claimed) >= len(truths) - 4 > 90
    assert Status.VALID in {message.status for message in claimed}
    for message in claimed:
        truth = truths[ns_from_stamp(message.header.stamp)]
        found = vector(message.direction)
        across = np.linalg.svd(found[None])[2][1:]
        error = across @ (vector(truth.direction) - found)
        covariance = across @ np.array(message.direction_covariance).reshape(3, 3) @ across.T
        # Chi-square with two degrees: beyond 27.6 is one in a million; with three beyond 30.7.
        assert error @ np.linalg.solve(covariance, error) < 27.6
        off_m = vector(truth.position) - vector(message.position)
        covariance_m2 = np.array(message.position_covariance).reshape(3, 3)
        assert off_m @ np.linalg.solve(covariance_m2, off_m) < 30.7


def vector(of: Any) -> np.ndarray:
    return np.array([of.x, of.y, of.z])


@pytest.mark.slow
def test_a_replay_in_blocks_gives_what_one_by_one_gives(voyage) -> None:
    folder, suite, _ = voyage
    in_blocks = replay_bag(folder, "in.mcap", suite)
    assert any(topic == DIRECTION for topic, _, _ in in_blocks)
    assert in_blocks == replay_bag(folder, "in.mcap", suite, one_by_one=True)


def test_pointings_are_those_without_the_images(voyage) -> None:
    folder, suite, _ = voyage
    about_inputs = DIRECTION, TRUTH, "input_health", "diagnostics"
    with_images, without = (
        [entry for entry in replay_bag(folder, bag, suite) if entry[0] not in about_inputs]
        for bag in ("in.mcap", "plain.mcap")
    )
    innovations = [entry for entry in with_images if entry[0] == "theodolite/innovation"]
    innovations_without = [entry for entry in without if entry[0] == "theodolite/innovation"]
    assert len(innovations) - len(innovations_without) <= 2  # of the images at the ends, which have no pointing
    others = [entry for entry in with_images if entry[0] != "theodolite/innovation"]
    assert others == [entry for entry in without if entry[0] != "theodolite/innovation"]
