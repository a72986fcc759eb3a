"""Directions of one target as several theodolites recorded them, brought to common moments."""

import bisect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag, watched
from ship_bags.stamps import ns_from_stamp
from ship_geometry.geodetic import GeodeticPosition
from ship_geometry.ros_axes import horizon_covariance
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_geometry.vector_track import VectorSample, VectorTrack
from theodolite_calib.target.triangulation import Air, Station, StationDirection, TriangulatedPlace, triangulated
from theodolite_calib.triangulation.config import StationConfig, TriangulationConfig

DIRECTION_TYPE = "ship_msgs/msg/TargetDirection"
INVALID = 3
"""TargetDirection.INVALID."""


@dataclass(frozen=True)
class Seen:
    """A direction that a theodolite recorded.

    Attributes:
        direction_n: unit vector in the horizon of its place (North, Up, East), shape (3,).
        covariance_n: of its total error, rad², shape (3, 3).
        status: of its message.
    """

    direction_n: FloatArray
    covariance_n: FloatArray
    status: int


class RecordedDirections:
    """The directions of one theodolite, in the order of their stamps; of two with one stamp the first counts.

    Args:
        station: where it stands.
        seen: direction by its stamp, ns.
        max_gap_ns: directions further apart are not joined.
    """

    def __init__(self, station: Station, seen: Mapping[int, Seen], max_gap_ns: int) -> None:
        self.station, self.times_ns = station, sorted(seen)
        self._seen = [seen[time_ns] for time_ns in self.times_ns]
        self._track: VectorTrack[VectorSample] = VectorTrack(max_gap_ns)
        for time_ns, one in zip(self.times_ns, self._seen, strict=True):
            self._track.insert(VectorSample(time_ns, one.direction_n))

    def at(self, time_ns: int) -> tuple[StationDirection, int] | None:
        """The direction at a moment, with the worse status of its neighbours; None in a gap, and before and after."""
        found = self._track.at(time_ns)
        if found is None:
            return None
        # Errors of neighbours are alike for the most part: no averaging makes the direction better.
        after = bisect.bisect_left(self.times_ns, time_ns)
        near = self._seen[after : after + 1] if self.times_ns[after] == time_ns else self._seen[after - 1 : after + 1]
        worst = max((one.covariance_n for one in near), key=np.trace)
        direction_n = found.vector / np.linalg.norm(found.vector)
        seen = StationDirection(self.station, direction_n, worst + found.error_covariance)
        return seen, max(one.status for one in near)


@dataclass(frozen=True)
class PlacedTarget:
    """The target at one moment.

    Attributes:
        time_ns: the moment.
        place: in the common frame, with the test of its residuals.
        stations: the theodolites that it rests on.
        status: the worst of their directions.
    """

    time_ns: int
    place: TriangulatedPlace
    stations: tuple[str, ...]
    status: int


def read_directions(folder: Path, config: TriangulationConfig, target_id: str) -> list[RecordedDirections]:
    """What each theodolite recorded of a target; a direction that claims nothing (INVALID) is left out.

    Raises:
        BadInput: names the bag, and what it lacks.
    """
    gap_ns = round(config.max_gap_s * SECOND_NS)
    return [
        RecordedDirections(_station(name, one), _recorded(folder / one.bag, one.topic, target_id), gap_ns)
        for name, one in config.stations.items()
    ]


def placed_targets(config: TriangulationConfig, recorded: list[RecordedDirections]) -> Iterator[PlacedTarget]:
    """The target at each stamp of the first theodolite at which another one saw it too, and gives a place with it."""
    origin = _position(config.origin.latitude_deg, config.origin.longitude_deg, config.origin.height_m)
    air = Air(config.refraction.coefficient, config.refraction.sigma)
    for time_ns in recorded[0].times_ns:
        seen = [found for found in (one.at(time_ns) for one in recorded) if found is not None]
        place = triangulated(origin, [direction for direction, _ in seen], air, config.gate_probability)
        if isinstance(place, TriangulatedPlace):
            names = tuple(direction.station.name for direction, _ in seen)
            yield PlacedTarget(time_ns, place, names, max(status for _, status in seen))


def _recorded(path: Path, topic: str, target_id: str) -> dict[int, Seen]:
    seen: dict[int, Seen] = {}
    others = set()
    with read_bag(path) as bag:
        if bag.topics.get(topic) != DIRECTION_TYPE:
            there = ", ".join(sorted(name for name, kind in bag.topics.items() if kind == DIRECTION_TYPE)) or "none"
            raise BadInput(f"has no topic '{topic}' of {DIRECTION_TYPE} (of that type it has: {there})", file=path)
        for record in watched(bag.records([topic]), bag):
            message = record.decode()
            if message.target_id != target_id:
                others.add(message.target_id)
                continue
            east, north, up = message.direction.x, message.direction.y, message.direction.z
            direction_n = np.array([north, up, east])
            covariance = np.asarray(message.direction_covariance, dtype=float).reshape(3, 3)
            if message.status != INVALID and np.isfinite(direction_n).all() and np.isfinite(covariance).all():
                one = Seen(direction_n, horizon_covariance(covariance), message.status)
                seen.setdefault(ns_from_stamp(message.header.stamp), one)
    if not seen:
        there = ", ".join(sorted(others)) or "none"
        raise BadInput(f"topic '{topic}' has no direction of target '{target_id}' (other targets: {there})", file=path)
    return seen


def _station(name: str, config: StationConfig) -> Station:
    return Station(name, _position(config.latitude_deg, config.longitude_deg, config.height_m), config.sigma_m)


def _position(latitude_deg: float, longitude_deg: float, height_m: float) -> GeodeticPosition:
    return GeodeticPosition(float(np.deg2rad(latitude_deg)), float(np.deg2rad(longitude_deg)), height_m)
