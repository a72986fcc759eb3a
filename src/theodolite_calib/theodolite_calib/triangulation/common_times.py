"""Directions to one target from several theodolites, interpolated to common times; used by command and node.

A position is computed at each stamp of the leading theodolite. The leading theodolite is the first with a direction at
that time: in the node the first by name, in the command the first in the file. Directions of the other theodolites are
interpolated to that stamp, but never across a time at which a theodolite reports INVALID.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.vector_track import VectorSample, VectorTrack
from theodolite_calib.triangulation.config import PositioningConfig
from theodolite_calib.triangulation.triangulation import Station, StationDirection, TriangulatedPosition, triangulate


@dataclass(frozen=True)
class DirectionSample(VectorSample):
    """Direction published by a theodolite: a unit vector in the local horizon, ``vector``, shape (3,), NaN if INVALID.

    Attributes:
        source: ``station.<name>`` of the theodolite.
        target_id: id of the target.
        covariance_n: covariance of the direction's total error, rad², zero along the direction, shape (3, 3).
        status: status stated by the theodolite; INVALID if it has no direction.
    """

    source: str
    target_id: str
    covariance_n: FloatArray
    status: Status

    def content(self) -> bytes:
        """Return all values as bytes."""
        return self.vector.tobytes() + self.covariance_n.tobytes() + bytes([self.status])


class _DirectionTrack(VectorTrack[DirectionSample]):
    """Directions of one theodolite; INVALID reports are kept, because no direction is interpolated across them."""

    def _interval(self, time_ns: int) -> tuple[int, float] | None:
        interval = super()._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        ends = self._samples[left : left + 1 if fraction == 0.0 else left + 2]
        return None if any(sample.status is Status.INVALID for sample in ends) else interval

    def _are_joined(self, left: int) -> bool:
        ends = self._samples[left : left + 2]
        return super()._are_joined(left) and not any(sample.status is Status.INVALID for sample in ends)


class StationDirections:
    """Directions of one theodolite to one target.

    Args:
        station: position of the theodolite.
        max_gap_s: maximum interval between two directions that are interpolated, s.
    """

    def __init__(self, station: Station, max_gap_s: float) -> None:
        self.station = station
        self.track = _DirectionTrack(round(max_gap_s * SECOND_NS))

    def has_direction_at(self, time_ns: int) -> bool:
        """True if a valid direction has this stamp, or can be interpolated between valid directions without a gap."""
        return self.track.at(time_ns) is not None

    def direction_at(self, time_ns: int) -> tuple[StationDirection, Status] | None:
        """Return the direction at a time, with the worse status of its neighbours; None without a direction."""
        found = self.track.at(time_ns)
        if found is None:
            return None
        near = self._neighbours(time_ns)
        # Errors of neighbouring directions are mostly common, so that an average does not reduce them.
        worst = max((sample.covariance_n for sample in near), key=np.trace)
        direction_n = found.vector / np.linalg.norm(found.vector)
        direction = StationDirection(self.station, direction_n, worst + found.error_covariance)
        return direction, max(sample.status for sample in near)

    def _neighbours(self, time_ns: int) -> list[DirectionSample]:
        """Return the sample at a time, or the samples before and after that time."""
        before = self.track.last_before(time_ns)
        assert before is not None
        if before.time_ns == time_ns:
            return [before]
        return [before, self.track.samples_between(time_ns, time_ns + self.track.max_gap_ns)[0]]


@dataclass(frozen=True)
class TargetPosition:
    """Position of the target at one time.

    Attributes:
        time_ns: time of the position.
        position: position in the common frame, with the test of its residuals; or a rejection.
        stations: theodolites with a direction at that time.
        status: worst status of the directions.
    """

    time_ns: int
    position: TriangulatedPosition | Rejection
    stations: tuple[str, ...]
    status: Status


def is_leading(number: int, time_ns: int, stations: Sequence[StationDirections]) -> bool:
    """True if a theodolite is the first in ``stations`` with a direction at a time."""
    return stations[number].has_direction_at(time_ns) and not any(
        before.has_direction_at(time_ns) for before in stations[:number]
    )


def position_at(time_ns: int, stations: Sequence[StationDirections], config: PositioningConfig) -> TargetPosition:
    """Return the target's position at a time from all directions at that time."""
    observations = [found for found in (one.direction_at(time_ns) for one in stations) if found is not None]
    directions = [direction for direction, _ in observations]
    return TargetPosition(
        time_ns=time_ns,
        position=triangulate(config.origin.position, directions, config.air, config.gate_probability),
        stations=tuple(direction.station.name for direction in directions),
        status=max((status for _, status in observations), default=Status.INVALID),
    )
