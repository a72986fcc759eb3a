"""Images of a target in a bag: replayed against the true pointing, in blocks and one by one, and without a trace.

The images are made from ``truth/pointing`` of a simulated voyage by the formulas of this file, at the stamps of it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header, ns_from_stamp
from ship_estimation.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.ros_axes import ENU_FROM_HORIZON
from ship_replay.offline.nodes import ADAPTERS
from ship_replay.offline.replay import replay
from ship_simulation.simulate_command import write_bag
from ship_simulation.suite.suite import suite_yaml
from ship_testing.theodolite_scenes import bag_scenario

FOCAL_LENGTH_M, IMAGE_SIGMA_M, LATENCY_NS = 1.5, 3e-6, 40_000_000
TARGET, DIRECTION = "theodolite/target", "theodolite/target_direction"


def seen_m(number: int) -> np.ndarray:
    """The target wanders over the field, up to half a degree from the main axis: (forward, up, right)."""
    beside = np.array([1.0, 0.008 * np.cos(0.7 * number), 0.008 * np.sin(0.4 * number)])
    return beside / np.linalg.norm(beside)


def image(factory: RosbagsFactory, time_ns: int, number: int, rng: np.random.Generator) -> Any:
    rho = -np.pi + 0.31 * number % (2.0 * np.pi)
    _, up, right = seen_m(number)
    up_v, right_v = up * np.cos(rho) + right * np.sin(rho), right * np.cos(rho) - up * np.sin(rho)
    x, z = -FOCAL_LENGTH_M * np.array([right_v, up_v]) / seen_m(number)[0] + IMAGE_SIGMA_M * rng.standard_normal(2)
    return factory.make(
        "ship_msgs/msg/TargetImage",
        header=make_header(factory, time_ns, "main_detector"),
        target_id="buoy",
        x=float(x),
        z=float(z),
        sigma=IMAGE_SIGMA_M,
        exposure_s=0.0,
        detector_rotation=float(rho),
        range=float("nan"),
        range_sigma=float("nan"),
    )


def entries(path: Path) -> Iterator[tuple[str, Any, int]]:
    with read_bag(path) as bag:
        for record in bag.records():
            yield record.topic, record.decode(), record.log_time_ns


@pytest.fixture(scope="module", name="voyage")
def _voyage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[int, np.ndarray]]:
    """A bag with images, its suite file, and the true directions (North, Up, East) by stamp."""
    folder, scenario, factory = tmp_path_factory.mktemp("target"), bag_scenario(duration_s=10.0), RosbagsFactory()
    write_bag(scenario, 3, folder / "plain.mcap", b"")
    told, truth_n, rng = list(entries(folder / "plain.mcap")), {}, np.random.default_rng(7)
    for topic, message, time_ns in list(told):
        if topic.strip("/") == "truth/pointing":
            number = len(truth_n)
            angles = message.azimuth, message.elevation, message.image_rotation
            truth_n[time_ns] = rotation_from_angles(*angles) @ seen_m(number)
            told.append((TARGET, image(factory, time_ns, number, rng), time_ns + LATENCY_NS))
    with BagWriter(folder / "in.mcap") as bag:
        for topic, message, time_ns in sorted(told, key=lambda entry: entry[2]):
            bag.write(topic, message, time_ns)
    suite = yaml.safe_load(suite_yaml(scenario))
    (node,) = (name for name in suite if name.endswith("optical_axis"))
    suite[node]["ros__parameters"]["main_detector"] = {"focal_length_m": FOCAL_LENGTH_M, "frame_id": "main_detector"}
    (folder / "suite.yaml").write_text(yaml.safe_dump(suite))
    return folder, folder / "suite.yaml", truth_n


def replayed(folder: Path, bag: str, suite: Path, *, one_by_one: bool = False) -> list[tuple[str, bytes, int]]:
    out = folder / f"{Path(bag).stem}_{one_by_one}.mcap"
    summary = replay(folder / bag, out, ADAPTERS, suite, one_by_one=one_by_one)
    assert summary.problems == []
    with read_bag(out) as replayed_bag:
        return [(record.topic.strip("/"), bytes(record.data), record.log_time_ns) for record in replayed_bag.records()]


def test_directions_are_those_of_the_truth_as_their_covariance_says(voyage) -> None:
    folder, suite, truth_n = voyage
    replay(folder / "in.mcap", folder / "out.mcap", ADAPTERS, suite)
    with read_bag(folder / "out.mcap") as bag:
        told = [record.decode() for record in bag.records() if record.topic.strip("/") == DIRECTION]
    claimed = [message for message in told if message.status != Status.INVALID]
    assert len(told) >= len(truth_n) - 2
    # What stands at the ends of the voyage has no pointing on both its sides.
    assert len(claimed) >= len(truth_n) - 4
    assert Status.VALID in {message.status for message in claimed}
    for message in claimed:
        found = np.array([message.direction.x, message.direction.y, message.direction.z])
        error = ENU_FROM_HORIZON @ truth_n[ns_from_stamp(message.header.stamp)] - found
        across = np.linalg.svd(found[None])[2][1:]
        covariance = across @ np.array(message.direction_covariance).reshape(3, 3) @ across.T
        # Chi-square with two degrees: beyond 27.6 is one in a million.
        assert across @ error @ np.linalg.solve(covariance, across @ error) < 27.6


def test_a_replay_in_blocks_gives_what_one_by_one_gives(voyage) -> None:
    folder, suite, _ = voyage
    in_blocks = replayed(folder, "in.mcap", suite)
    assert any(topic == DIRECTION for topic, _, _ in in_blocks)
    assert in_blocks == replayed(folder, "in.mcap", suite, one_by_one=True)


def test_pointings_are_what_they_are_without_the_images(voyage) -> None:
    folder, suite, _ = voyage
    about_inputs = DIRECTION, "input_health", "diagnostics"
    with_images, without = (
        [entry for entry in replayed(folder, bag, suite) if entry[0] not in about_inputs]
        for bag in ("in.mcap", "plain.mcap")
    )
    innovations = [entry for entry in with_images if entry[0] == "theodolite/innovation"]
    told = [entry for entry in without if entry[0] == "theodolite/innovation"]
    assert len(innovations) - len(told) <= 2  # of the images at the ends, which have no pointing
    others = [entry for entry in with_images if entry[0] != "theodolite/innovation"]
    assert others == [entry for entry in without if entry[0] != "theodolite/innovation"]
