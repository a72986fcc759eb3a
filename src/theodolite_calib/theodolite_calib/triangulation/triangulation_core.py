"""Positions of targets at common times of several theodolites, and the core of the node ``triangulation``.

A position is computed at each stamp of the leading theodolite. The leading theodolite is the first with a direction at
that time: in the node the first by name, in the command ``triangulate`` the first in the file. Directions of the other
theodolites are interpolated to that stamp, but never across a time at which a theodolite reports INVALID.

The core answers each direction of the leading theodolite once, by a position at its stamp or an INVALID position with
the reason. The direction waits until the other theodolites that report on the target have reported on that time, or
their next report is ``lag_s`` overdue. Positions of one target are published in the order of their stamps.

Reports of a theodolite are expected in order. If messages of a theodolite overtake one another, the older message may
come after the position of its time, and is rejected as LATE. Waiting for such messages would delay every position by
``lag_s``. Star sensors are combined by the same rule (:class:`ship_attitude_star.star_attitude.core.JointWindow`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection, StampConflicts, failure_rejection, resolve_same_stamp
from ship_estimation.time_order.outcome import Measurement, MeasurementDecision, Outcome, Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.sample_track import VectorSample, VectorTrack
from theodolite_calib.triangulation.triangulation import (
    PositioningConfig,
    Station,
    StationDirection,
    TriangulatedPosition,
    TriangulationConfig,
    triangulate,
)

MAX_TARGETS = 100
"""Maximum number of targets; the directions name the targets, so their number has no other limit.

Beyond it the target received longest ago is dropped, and its pending directions are answered as INVALID.
"""

MAX_WAITING = 1000
"""Maximum number of pending directions to one target; beyond it the oldest directions are answered without waiting."""

_LATE = Rejection(Reason.LATE, "too late: later positions of the target were published, or the target was dropped")


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
        position=triangulate(config.origin.position, directions, config.refraction, config.gate_probability),
        stations=tuple(direction.station.name for direction in directions),
        status=max((status for _, status in observations), default=Status.INVALID),
    )


@dataclass(frozen=True)
class PositionEstimate:
    """Position of a target at one time, or INVALID.

    Attributes:
        time_ns: stamp of the direction that is answered.
        target_id: id of the target.
        status: status of the position.
        text: reason if the status is not VALID.
        stations: theodolites with a direction at that time.
        triangulated: position with the residuals of the directions; None if none was computed.
        rejection: reason if INVALID; else None.
        position_n: position in the common frame, m, shape (3,); NaN if INVALID.
        covariance_n: covariance of the position's total error, m², shape (3, 3); NaN if INVALID.
    """

    time_ns: int
    target_id: str
    status: Status
    text: str
    stations: tuple[str, ...]
    triangulated: TriangulatedPosition | None
    rejection: Rejection | None
    position_n: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    covariance_n: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))


TriangulationOutcome = Outcome[MeasurementDecision[Measurement], PositionEstimate]
"""Outcome whose estimates are positions; it contains no decisions about single directions."""


@dataclass
class _ReportTimes:
    """Times of one theodolite's reports on a target, INVALID reports included.

    Attributes:
        newest_ns: latest stamp; 0 before the first report.
        interval_ns: interval between the latest two stamps; 0 before the second report.
        received_ns: time of reception of the latest report.
    """

    newest_ns: int = 0
    interval_ns: int = 0
    received_ns: int = 0

    def add(self, time_ns: int, waiting_ns: int) -> bool:
        """Record a report; return False if its stamp is not later than the latest stamp."""
        if time_ns <= self.newest_ns:
            return False
        self.interval_ns = time_ns - self.newest_ns if self.newest_ns else 0
        self.newest_ns, self.received_ns = time_ns, waiting_ns
        return True


@dataclass
class _Target:
    """Directions to one target.

    Attributes:
        stations: directions to the target from each theodolite, in the order of their names.
        reports: times of each theodolite's reports, in the order of ``stations``.
        waiting: (stamp, number of the theodolite) of each pending direction → time of reception.
        last_answered_ns: last answered stamp of this target, or of dropped targets, because this target may have been
            dropped before.
    """

    stations: list[StationDirections]
    reports: list[_ReportTimes]
    waiting: dict[tuple[int, int], int] = field(default_factory=dict)
    last_answered_ns: int = 0


class TriangulationCore:
    """Positions of targets from the directions of several theodolites.

    Args:
        config: parameters of the node.
    """

    def __init__(self, config: TriangulationConfig) -> None:
        self.config = config
        self._lag_ns = round(config.lag_s * SECOND_NS)
        self._stations: list[Station] = [config.stations[name].station(name) for name in sorted(config.stations)]
        self._stamp_conflicts = StampConflicts()
        self._numbers = {f"station.{station.name}": number for number, station in enumerate(self._stations)}
        self.reset()

    def reset(self, clock_jumped: bool = False) -> list[str]:
        """Discard all directions."""
        self._targets: dict[str, _Target] = {}
        self._forgotten_ns = 0
        self._stamp_conflicts.reset()
        return []

    def step_time_base(self, _step_ns: int, _state: None) -> None:
        """Discard all directions after a step of the clocks."""
        self.reset()

    def reconfigure(self, config: TriangulationConfig) -> None:
        """Apply changed parameters."""
        self.config = config

    def add_direction(self, sample: DirectionSample, waiting_ns: int) -> TriangulationOutcome:
        """Add a direction of one theodolite to one target, or an INVALID report.

        If a report is late or a duplicate, no direction is answered.
        """
        outcome, number = TriangulationOutcome(), self._numbers[sample.source]
        target = self._targets.get(sample.target_id)
        if target is None:
            if sample.time_ns <= self._forgotten_ns:
                outcome.rejection = _LATE
                return outcome
            target = self._add_target(sample.target_id, outcome)
        if target.reports[number].add(sample.time_ns, waiting_ns):
            # The target becomes the last in the order; the first target is dropped first.
            self._targets[sample.target_id] = self._targets.pop(sample.target_id)
        outcome.rejection = self._insert(target, number, sample, waiting_ns)
        if outcome.rejection is None or outcome.rejection.reason not in (Reason.DUPLICATE, Reason.LATE):
            self._answer(sample.target_id, target, waiting_ns, outcome)
        return outcome

    def set_duplicate_publishers(self, source: str, text: str) -> None:
        """Set the text of a conflict of two publishers on one source; an empty text ends the conflict."""
        self._stamp_conflicts.set_duplicate_publishers(source, 0, text)

    def tick(self, now_ns: int, waiting_ns: int) -> TriangulationOutcome:
        """Answer directions that have waited long enough."""
        outcome = TriangulationOutcome()
        for target_id, target in self._targets.items():
            self._answer(target_id, target, waiting_ns, outcome)
        return outcome

    def _add_target(self, target_id: str, outcome: TriangulationOutcome) -> _Target:
        """Add a target and return it; if there are too many targets, another target is dropped."""
        if len(self._targets) >= MAX_TARGETS:
            self._forget(next(iter(self._targets)), outcome)
        seen_by = [StationDirections(station, self.config.max_gap_s) for station in self._stations]
        target = _Target(seen_by, [_ReportTimes() for _ in seen_by], last_answered_ns=self._forgotten_ns)
        self._targets[target_id] = target
        return target

    def _forget(self, target_id: str, outcome: TriangulationOutcome) -> None:
        """Drop a target, answer its pending directions as INVALID; a target that returns gets only later positions."""
        target = self._targets.pop(target_id)
        rejection = Rejection(Reason.OVERFLOW, f"more than {MAX_TARGETS} targets: '{target_id}' is dropped")
        for time_ns, number in sorted(target.waiting):
            target.last_answered_ns = time_ns
            if is_leading(number, time_ns, target.stations):
                outcome.estimates.append(_invalid_position(target_id, time_ns, (), None, rejection))
        self._forgotten_ns = max(self._forgotten_ns, target.last_answered_ns)

    def _insert(self, target: _Target, number: int, sample: DirectionSample, waiting_ns: int) -> Rejection | None:
        track, key = target.stations[number].track, (sample.time_ns, number)
        known = track.get(sample.time_ns)
        rejection = None
        if known is not None:
            takes_its_place, rejection = resolve_same_stamp(known, sample)
            self._stamp_conflicts.record(sample.source, sample.time_ns, rejection)
            if not takes_its_place:
                return rejection
        if sample.status is Status.INVALID:
            track.insert(sample)
            target.waiting.pop(key, None)
            # Old samples are dropped here, because no position is computed at the stamp of an INVALID report.
            oldest_ns = min([time_ns for time_ns, _ in target.waiting], default=sample.time_ns)
            track.drop_before(min(oldest_ns, sample.time_ns - self._lag_ns))
            return rejection or Rejection(Reason.GAP, "the theodolite reports INVALID")
        if sample.time_ns <= target.last_answered_ns:
            return rejection or _LATE
        track.insert(sample)
        target.waiting.setdefault(key, waiting_ns)
        return rejection

    def _answer(self, target_id: str, target: _Target, waiting_ns: int, outcome: TriangulationOutcome) -> None:
        """Answer directions in the order of their stamps, up to the first direction that must wait."""
        for time_ns, number in sorted(target.waiting):
            overflows = len(target.waiting) > MAX_WAITING
            if not overflows and self._is_waiting(target, time_ns, number, waiting_ns):
                return
            del target.waiting[time_ns, number]
            target.last_answered_ns = time_ns
            if is_leading(number, time_ns, target.stations):
                outcome.estimates.append(self._estimate(target_id, target, time_ns, outcome))
            for station in target.stations:
                station.track.drop_before(time_ns)

    def _is_waiting(self, target: _Target, time_ns: int, number: int, waiting_ns: int) -> bool:
        """True if a theodolite that reports on the target may still report on the time of a pending direction.

        The next report is expected one interval after the last report. If a theodolite has sent only one report, the
        interval of the theodolite with the pending direction is used, or else ``max_gap_s``.
        """
        max_gap_ns, came_ns = round(self.config.max_gap_s * SECOND_NS), target.waiting[time_ns, number]
        for reports in target.reports:
            if not 0 < reports.newest_ns < time_ns:
                continue
            interval_ns = reports.interval_ns or target.reports[number].interval_ns or max_gap_ns
            is_joined = reports.newest_ns + interval_ns - time_ns <= max_gap_ns
            is_overdue = waiting_ns - reports.received_ns > interval_ns + self._lag_ns
            has_waited = waiting_ns - came_ns > min(interval_ns, max_gap_ns) + self._lag_ns
            if is_joined and not is_overdue and not has_waited:
                return True
        return False

    def _estimate(
        self, target_id: str, target: _Target, time_ns: int, outcome: TriangulationOutcome
    ) -> PositionEstimate:
        try:
            placed = position_at(time_ns, target.stations, self.config)
        except Exception as error:
            outcome.failures.append((time_ns, failure_rejection(error)))
            return _invalid_position(target_id, time_ns, (), None, failure_rejection(error))
        place = placed.position
        if isinstance(place, Rejection):
            return _invalid_position(target_id, time_ns, placed.stations, None, place)
        if place.rejection is not None:
            return _invalid_position(target_id, time_ns, placed.stations, place, place.rejection)
        status, text = placed.status, ""
        if status is not Status.VALID:
            text = f"a direction to the target is {status.name}"
        conflict_text = self._conflict_text(time_ns, placed.stations)
        if conflict_text and status is not Status.DEGRADED:
            status, text = Status.DEGRADED, conflict_text
        return PositionEstimate(
            time_ns, target_id, status, text, placed.stations, place, None, place.position_n, place.covariance_n
        )

    def _conflict_text(self, time_ns: int, stations: tuple[str, ...]) -> str:
        """Return the text about conflicting directions of some theodolites; empty without conflicts."""
        sources = {f"station.{name}" for name in stations}
        return self._stamp_conflicts.text(sources & self._stamp_conflicts.active_at(time_ns).keys())


def _invalid_position(
    target_id: str, time_ns: int, stations: tuple[str, ...], compared: TriangulatedPosition | None, rejection: Rejection
) -> PositionEstimate:
    return PositionEstimate(time_ns, target_id, Status.INVALID, rejection.text, stations, compared, rejection)
