"""Says before the voyage where a telescope's focal length contradicts the lights that a bag shows."""

from bisect import bisect_left
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import relative_topics
from ship_geometry.rotations import FloatArray, angle_between
from ship_replay.preflight.check_config import CheckedNode, Findings
from theodolite_calib.config import OpticalAxisConfig

_IMAGES = 30
_NEAR_NS = NS_PER_S // 5
_FEWEST_PAIRS = 5
_LEAST_ANGLE = np.deg2rad(0.1)
_TOLERANCE = 0.2
"""Baselines are from the ship's antenna and not from the telescope: at some hundred metres that is a few percent."""

_IMAGE_TOPIC = "theodolite/beacons"


def check_telescope(path: Path, nodes: Sequence[CheckedNode], bag: Bag, namespace: str, findings: Findings) -> None:
    """Compare the configured focal length with that by distances in the image and angles between the lights.

    Args:
        path: file of the configuration.
        nodes: what it is about.
        bag: a bag recorded with the sensors of the voyage.
        namespace: namespace of the ship in the bag.
        findings: takes what is found.
    """
    found = relative_topics(bag.topics, namespace)
    usable = {t: name for t, name in found.items() if bag.topics[name] not in bag.differences}
    for node in nodes:
        if isinstance(node.config, OpticalAxisConfig) and _IMAGE_TOPIC in usable:
            measured_m = _focal_length_m(node.config, bag, usable)
            configured_m = node.config.telescope.focal_length_m
            if measured_m is not None and not abs(measured_m / configured_m - 1.0) <= _TOLERANCE:
                name = "telescope.focal_length_m"
                line = node.file.line_of(name)
                findings.errors.append(
                    f"{path}:{line}: parameter '{name}' = {configured_m:g} m, but lights on '{_IMAGE_TOPIC}' in "
                    f"{bag.path} stand as far apart as with {measured_m:.2g} m"
                )


def _focal_length_m(config: OpticalAxisConfig, bag: Bag, usable: dict[str, str]) -> float | None:
    """Median over pairs of lights; None where there are too few."""
    images, baselines = _collected(config, bag, usable)
    ratios_m: list[float] = []
    for time_ns, points_m in images:
        lines = {id_: line for id_ in points_m if (line := _nearest(baselines.get(id_, []), time_ns)) is not None}
        for one, other in combinations(sorted(lines), 2):
            angle = float(angle_between(lines[one], lines[other]))
            distance_m = float(np.linalg.norm(points_m[one] - points_m[other]))
            if angle > _LEAST_ANGLE and distance_m > 0.0:
                ratios_m.append(distance_m / angle)
    return float(np.median(ratios_m)) if len(ratios_m) >= _FEWEST_PAIRS else None


def _collected(
    config: OpticalAxisConfig, bag: Bag, usable: dict[str, str]
) -> tuple[list[tuple[int, dict[str, FloatArray]]], dict[str, list[tuple[int, FloatArray]]]]:
    """Images with several lights, spread over the bag, and the unit vectors to the drones by time."""
    topics = {f"beacon/{id_}/baseline": id_ for id_ in config.beacons if f"beacon/{id_}/baseline" in usable}
    relative = {usable[topic]: topic for topic in (*topics, _IMAGE_TOPIC)}
    spacing_ns = ((bag.end_ns or 0) - (bag.start_ns or 0)) // _IMAGES
    images: list[tuple[int, dict[str, FloatArray]]] = []
    baselines: dict[str, list[tuple[int, FloatArray]]] = {id_: [] for id_ in topics.values()}
    for record in bag.records(relative):
        try:
            message: Any = record.decode()
        except BadInput:
            continue
        time_ns = ns_from_stamp(message.header.stamp)
        if relative[record.topic] == _IMAGE_TOPIC:
            points_m = {light.beacon_id: np.array([light.x, light.z]) for light in message.beacons}
            if len(points_m) > 1 and (not images or time_ns - images[-1][0] >= spacing_ns):
                images.append((time_ns, points_m))
        else:
            vector_m = np.array([message.enu.x, message.enu.y, message.enu.z])
            distance_m = float(np.linalg.norm(vector_m))
            if distance_m > 0.0:
                baselines[topics[relative[record.topic]]].append((time_ns, vector_m / distance_m))
    return images, baselines


def _nearest(baselines: list[tuple[int, FloatArray]], time_ns: int) -> FloatArray | None:
    """The unit vector nearest in time; None where none is near."""
    index = bisect_left(baselines, time_ns, key=lambda entry: entry[0])
    near = [entry for entry in baselines[max(index - 1, 0) : index + 1] if abs(entry[0] - time_ns) <= _NEAR_NS]
    return min(near, key=lambda entry: abs(entry[0] - time_ns))[1] if near else None
