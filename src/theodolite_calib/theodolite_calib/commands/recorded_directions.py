"""Recorded directions of several theodolites to one target, and the target's positions from them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag, with_bag_progress
from ship_bags.stamps import END_OF_TIME_NS
from ship_estimation.time_order.outcome import Status
from ship_node.messages.field_checks import MessageRejected
from theodolite_calib.commands.triangulation_file import RecordedTriangulationConfig
from theodolite_calib.messages.direction_messages import direction
from theodolite_calib.messages.target_messages import TARGET_TYPE
from theodolite_calib.triangulation.common_times import (
    DirectionSample,
    StationDirections,
    TargetPosition,
    is_leading,
    position_at,
)
from theodolite_calib.triangulation.config import PositioningConfig


def read_directions(folder: Path, config: RecordedTriangulationConfig, target_id: str) -> list[StationDirections]:
    """Return the recorded directions of each theodolite to a target, without unusable directions.

    If two directions have the same stamp, the first is used.

    Raises:
        BadInput: a bag cannot be read, lacks the configured topic, or has no direction of the target.
    """
    recorded = []
    for name, station in config.stations.items():
        directions = StationDirections(station.station(name), config.max_gap_s)
        for sample in _recorded_directions(folder / station.bag, station.topic, name, target_id):
            if directions.track.get(sample.time_ns) is None:
                directions.track.insert(sample)
        recorded.append(directions)
    return recorded


def target_positions(config: PositioningConfig, recorded: Sequence[StationDirections]) -> Iterator[TargetPosition]:
    """Yield position or rejection at each stamp of a leading theodolite; a position needs two directions."""
    stamps = [(time_ns, number) for number, seen in enumerate(recorded) for time_ns in seen.track.times_ns]
    for time_ns, number in sorted(stamps):
        if is_leading(number, time_ns, recorded):
            yield position_at(time_ns, recorded, config)


def _recorded_directions(path: Path, topic: str, station: str, target_id: str) -> list[DirectionSample]:
    found, others = [], set()
    with read_bag(path) as bag:
        if bag.topics.get(topic) != TARGET_TYPE:
            there = ", ".join(sorted(name for name, kind in bag.topics.items() if kind == TARGET_TYPE)) or "none"
            raise BadInput(f"has no topic '{topic}' of {TARGET_TYPE} (of that type it has: {there})", file=path)
        for record in with_bag_progress(bag.records([topic]), bag):
            message = record.decode()
            try:
                sample = direction(message, station, END_OF_TIME_NS).value
            except MessageRejected:
                continue
            if sample.target_id != target_id:
                others.add(sample.target_id)
            else:
                found.append(sample)
    if all(sample.status is Status.INVALID for sample in found):
        there = ", ".join(sorted(others)) or "none"
        raise BadInput(f"topic '{topic}' has no direction of target '{target_id}' (other targets: {there})", file=path)
    return found
