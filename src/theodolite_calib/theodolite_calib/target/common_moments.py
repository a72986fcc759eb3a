"""Directions of one target by several theodolites, brought to common moments: the one way of command and node.

A place is made at each stamp of the theodolite that leads there: the first, by name (the node) or in the order of the
file (the command), that sees the target at that moment. The directions of the others are interpolated to it, but never
across a moment at which a theodolite says that it sees nothing (INVALID).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_estimation.outcome import Status
from ship_estimation.refusals import Refusal
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_geometry.vector_track import VectorSample, VectorTrack
from theodolite_calib.target.config import PlacingConfig
from theodolite_calib.target.triangulation import Station, StationDirection, TriangulatedPlace, triangulated


@dataclass(frozen=True)
class DirectionSample(VectorSample):
    """A direction as a theodolite told it; its unit vector in the horizon of its place is ``vector``, shape (3,).

    Attributes:
        source: ``station.<name>`` of the theodolite.
        target_id: of the target.
        covariance_n: of its total error, rad², zero along it, shape (3, 3).
        status: what the theodolite says that it is worth; INVALID: there is no direction.
    """

    source: str
    target_id: str
    covariance_n: FloatArray
    status: Status

    def content(self) -> bytes:
        """All values as bytes."""
        return self.vector.tobytes() + self.covariance_n.tobytes() + bytes([self.status])


class _DirectionTrack(VectorTrack[DirectionSample]):
    """Directions of one theodolite; INVALID ones are kept, for nothing is interpolated across them."""

    def _interval(self, time_ns: int) -> tuple[int, float] | None:
        interval = super()._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        ends = self._samples[left : left + 1 if fraction == 0.0 else left + 2]
        return None if any(sample.status is Status.INVALID for sample in ends) else interval

    def _joined(self, left: int) -> bool:
        ends = self._samples[left : left + 2]
        return super()._joined(left) and not any(sample.status is Status.INVALID for sample in ends)


class SeenByStation:
    """The directions of one theodolite to one target.

    Args:
        station: where it stands.
        max_gap_s: directions further apart are not joined.
    """

    def __init__(self, station: Station, max_gap_s: float) -> None:
        self.station = station
        self.track = _DirectionTrack(round(max_gap_s * SECOND_NS))

    def sees(self, time_ns: int) -> bool:
        """Whether there is a direction at a moment: not in a gap, beside an INVALID one, before the first or later."""
        return self.track.at(time_ns) is not None

    def at(self, time_ns: int) -> tuple[StationDirection, Status] | None:
        """The direction at a moment, with the worse status of its neighbours; None where it is not seen."""
        found = self.track.at(time_ns)
        if found is None:
            return None
        near = self._neighbours(time_ns)
        # Errors of neighbours are alike for the most part: no averaging makes the direction better.
        worst = max((sample.covariance_n for sample in near), key=np.trace)
        direction_n = found.vector / np.linalg.norm(found.vector)
        seen = StationDirection(self.station, direction_n, worst + found.error_covariance)
        return seen, max(sample.status for sample in near)

    def _neighbours(self, time_ns: int) -> list[DirectionSample]:
        """The sample at a moment, or those before and after it."""
        before = self.track.last_before(time_ns)
        assert before is not None
        if before.time_ns == time_ns:
            return [before]
        return [before, self.track.between(time_ns, time_ns + self.track.max_gap_ns)[0]]


@dataclass(frozen=True)
class PlacedTarget:
    """The target at one moment.

    Attributes:
        time_ns: the moment.
        place: in the common frame, with the test of its residuals; or why there is none.
        stations: the theodolites that saw it then.
        status: the worst of their directions.
    """

    time_ns: int
    place: TriangulatedPlace | Refusal
    stations: tuple[str, ...]
    status: Status


def leads(number: int, time_ns: int, seen_by: Sequence[SeenByStation]) -> bool:
    """Whether a theodolite sees the target at a moment, and none of those before it in ``seen_by`` does."""
    return seen_by[number].sees(time_ns) and not any(before.sees(time_ns) for before in seen_by[:number])


def placed_at(time_ns: int, seen_by: Sequence[SeenByStation], config: PlacingConfig) -> PlacedTarget:
    """The target at a moment by all that see it then."""
    seen = [found for found in (one.at(time_ns) for one in seen_by) if found is not None]
    directions = [direction for direction, _ in seen]
    return PlacedTarget(
        time_ns=time_ns,
        place=triangulated(config.origin.position, directions, config.air, config.gate_probability),
        stations=tuple(direction.station.name for direction in directions),
        status=max((status for _, status in seen), default=Status.INVALID),
    )
