"""The core of the node ``triangulation``: places of targets as the directions of the theodolites come.

Each direction is answered once: where its theodolite leads (:mod:`theodolite_calib.target.common_moments`) by a place
at its stamp, or by none, with the reason. It waits until the other theodolites that report on the target have reported
on that moment, or their next report is ``lag_s`` overdue. The places of one target are put out in the order of their
stamps.

A theodolite that has told of a moment is taken to have told of all before it: where its messages overtake one another,
the older one may come after the place of its time, and is refused as LATE. To wait the whole ``lag_s`` for each would
make every place that late. Star sensors are joined by the same rule
(:class:`ship_attitude_star.star_attitude.core.JointWindow`).
"""

from dataclasses import dataclass, field

import numpy as np

from ship_estimation.outcome import Decision, Measurement, Outcome, Status
from ship_estimation.refusals import Contradictions, Reason, Refusal, failure, same_stamp
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.target.common_moments import DirectionSample, SeenByStation, leads, placed_at
from theodolite_calib.target.config import TriangulationConfig
from theodolite_calib.target.triangulation import Station, TriangulatedPlace

MOST_TARGETS = 100
"""Targets that are followed at a time: their names come from outside. Of more, the one heard of longest ago is
forgotten, and its directions that wait get no place."""

MOST_WAITING = 1000
"""Directions to one target that wait at a time; of a flood the oldest are answered by what is there."""

_LATE = Refusal(Reason.LATE, "the places of its time were put out, or its target forgotten, before it came")


@dataclass(frozen=True)
class PlaceEstimate:
    """The place of a target at one moment, or that none is claimed.

    Attributes:
        time_ns: the stamp of the direction that it answers.
        target_id: of the target.
        position_n: in the common frame, m, shape (3,); NaN where none is claimed.
        covariance_n: of its total error, m², shape (3, 3); NaN likewise.
        status: what it is worth.
        text: why it is not VALID.
        stations: the theodolites that saw the target then.
        compared: the place with the residuals of the directions; None where there is none to compare with.
        refusal: why no place is claimed; None where one is.
    """

    time_ns: int
    target_id: str
    position_n: FloatArray
    covariance_n: FloatArray
    status: Status
    text: str
    stations: tuple[str, ...]
    compared: TriangulatedPlace | None
    refusal: Refusal | None


PlacingOutcome = Outcome[Decision[Measurement], PlaceEstimate]
"""Places are its estimates; of single directions nothing is decided."""


@dataclass
class _Reports:
    """Times of one theodolite's reports on a target, INVALID ones among them.

    Attributes:
        newest_ns: latest stamp; 0 before the first.
        interval_ns: between the latest two stamps; 0 before the second.
        received_ns: time of waiting at which the last one came.
    """

    newest_ns: int = 0
    interval_ns: int = 0
    received_ns: int = 0

    def add(self, time_ns: int, waiting_ns: int) -> bool:
        """Record a report; False if it is not later than those before it, which tells of no time to come."""
        if time_ns <= self.newest_ns:
            return False
        self.interval_ns = time_ns - self.newest_ns if self.newest_ns else 0
        self.newest_ns, self.received_ns = time_ns, waiting_ns
        return True


@dataclass
class _Target:
    """What is known of one target.

    Attributes:
        seen_by: its directions by each theodolite, in their order.
        reports: the times of each theodolite's reports, in the same order.
        waiting: (stamp, number of the theodolite) of each direction that is not answered → when it came.
        done_ns: the last stamp that was answered, of it or of a target that was forgotten before it was heard of: that
            may have been the same one.
    """

    seen_by: list[SeenByStation]
    reports: list[_Reports]
    waiting: dict[tuple[int, int], int] = field(default_factory=dict)
    done_ns: int = 0


class TriangulationCore:
    """Places of targets by the directions of several theodolites.

    Args:
        config: the node's parameters.
    """

    def __init__(self, config: TriangulationConfig) -> None:
        self.config = config
        self._lag_ns = round(config.lag_s * SECOND_NS)
        self._stations: list[Station] = [config.stations[name].station(name) for name in sorted(config.stations)]
        self._contradictions = Contradictions()
        self._numbers = {f"station.{station.name}": number for number, station in enumerate(self._stations)}
        self.reset()

    def reset(self, clock_jumped: bool = False) -> list[str]:
        """Forget all directions."""
        self._targets: dict[str, _Target] = {}
        self._forgotten_ns = 0
        self._contradictions.forget()
        return []

    def step_time_base(self, _step_ns: int, _state: None) -> None:
        """Forget all directions: their clocks have stepped."""
        self.reset()

    def reconfigure(self, config: TriangulationConfig) -> None:
        """Go on with other noise and another gate."""
        self.config = config

    def add_direction(self, sample: DirectionSample, waiting_ns: int) -> PlacingOutcome:
        """A direction of one theodolite to one target, or that it claims none.

        One that is late or a duplicate answers no other and forgets no target.
        """
        outcome, number = PlacingOutcome(), self._numbers[sample.source]
        target = self._targets.get(sample.target_id)
        if target is None:
            if sample.time_ns <= self._forgotten_ns:
                outcome.refusal = _LATE
                return outcome
            target = self._begin(sample.target_id, outcome)
        if target.reports[number].add(sample.time_ns, waiting_ns):
            # Of the targets the first one is forgotten first.
            self._targets[sample.target_id] = self._targets.pop(sample.target_id)
        outcome.refusal = self._take(target, number, sample, waiting_ns)
        if outcome.refusal is None or outcome.refusal.reason not in (Reason.DUPLICATE, Reason.LATE):
            self._answer(sample.target_id, target, waiting_ns, outcome)
        return outcome

    def contest(self, source: str, text: str) -> None:
        """Set that two publishers send as a source; an empty text ends it."""
        self._contradictions.contest(source, 0, text)

    def tick(self, now_ns: int, waiting_ns: int) -> PlacingOutcome:
        """Answer what has waited long enough."""
        outcome = PlacingOutcome()
        for target_id, target in self._targets.items():
            self._answer(target_id, target, waiting_ns, outcome)
        return outcome

    def _begin(self, target_id: str, outcome: PlacingOutcome) -> _Target:
        """Return a target that was not heard of; where it is one too many another one is forgotten."""
        if len(self._targets) >= MOST_TARGETS:
            self._forget(next(iter(self._targets)), outcome)
        seen_by = [SeenByStation(station, self.config.max_gap_s) for station in self._stations]
        target = _Target(seen_by, [_Reports() for _ in seen_by], done_ns=self._forgotten_ns)
        self._targets[target_id] = target
        return target

    def _forget(self, target_id: str, outcome: PlacingOutcome) -> None:
        """Forget a target; its directions that wait are answered, and no later place of it is stamped before them."""
        target = self._targets.pop(target_id)
        refusal = Refusal(Reason.OVERFLOW, f"more than {MOST_TARGETS} targets: '{target_id}' is forgotten")
        for time_ns, number in sorted(target.waiting):
            target.done_ns = time_ns
            if leads(number, time_ns, target.seen_by):
                outcome.estimates.append(_no_place(target_id, time_ns, (), None, refusal))
        self._forgotten_ns = max(self._forgotten_ns, target.done_ns)

    def _take(self, target: _Target, number: int, sample: DirectionSample, waiting_ns: int) -> Refusal | None:
        track, key = target.seen_by[number].track, (sample.time_ns, number)
        known = track.get(sample.time_ns)
        refusal = None
        if known is not None:
            takes_its_place, refusal = same_stamp(known, sample)
            self._contradictions.note(sample.source, sample.time_ns, refusal)
            if not takes_its_place:
                return refusal
        if sample.status is Status.INVALID:
            track.insert(sample)
            target.waiting.pop(key, None)
            # No place is asked for at its stamp, with which old ones would be forgotten.
            oldest_ns = min([time_ns for time_ns, _ in target.waiting], default=sample.time_ns)
            track.drop_before(min(oldest_ns, sample.time_ns - self._lag_ns))
            return refusal or Refusal(Reason.GAP, "the theodolite itself says INVALID")
        if sample.time_ns <= target.done_ns:
            return refusal or _LATE
        track.insert(sample)
        target.waiting.setdefault(key, waiting_ns)
        return refusal

    def _answer(self, target_id: str, target: _Target, waiting_ns: int, outcome: PlacingOutcome) -> None:
        """Answer the directions that wait for nothing more, in the order of their stamps."""
        for time_ns, number in sorted(target.waiting):
            overflows = len(target.waiting) > MOST_WAITING
            if not overflows and self._waits(target, time_ns, number, waiting_ns):
                return
            del target.waiting[time_ns, number]
            target.done_ns = time_ns
            if leads(number, time_ns, target.seen_by):
                outcome.estimates.append(self._estimate(target_id, target, time_ns, outcome))
            for seen in target.seen_by:
                seen.track.drop_before(time_ns)

    def _waits(self, target: _Target, time_ns: int, number: int, waiting_ns: int) -> bool:
        """True while a theodolite that reports on the target may still report on the moment of a waiting direction.

        The next report is expected one interval after the last. While a theodolite has sent one report only, its
        interval is taken to be that of the theodolite that waits.
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

    def _estimate(self, target_id: str, target: _Target, time_ns: int, outcome: PlacingOutcome) -> PlaceEstimate:
        try:
            placed = placed_at(time_ns, target.seen_by, self.config)
        except Exception as error:
            outcome.failures.append((time_ns, failure(error)))
            return _no_place(target_id, time_ns, (), None, failure(error))
        place = placed.place
        if isinstance(place, Refusal):
            return _no_place(target_id, time_ns, placed.stations, None, place)
        if place.refusal is not None:
            return _no_place(target_id, time_ns, placed.stations, place, place.refusal)
        status, text = placed.status, ""
        if status is not Status.VALID:
            text = f"a direction to it is {status.name}"
        doubt = self._doubt(time_ns, placed.stations)
        if doubt and status is not Status.DEGRADED:
            status, text = Status.DEGRADED, doubt
        return PlaceEstimate(
            time_ns, target_id, place.position_n, place.covariance_n, status, text, placed.stations, place, None
        )

    def _doubt(self, time_ns: int, stations: tuple[str, ...]) -> str:
        """Why the directions of some theodolites are in doubt; empty where they are not."""
        sources = {f"station.{name}" for name in stations}
        return self._contradictions.text(sources & self._contradictions.at(time_ns).keys())


def _no_place(
    target_id: str, time_ns: int, stations: tuple[str, ...], compared: TriangulatedPlace | None, refusal: Refusal
) -> PlaceEstimate:
    """No place is claimed."""
    unknown, unknown_covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
    return PlaceEstimate(
        time_ns, target_id, unknown, unknown_covariance, Status.INVALID, refusal.text, stations, compared, refusal
    )
