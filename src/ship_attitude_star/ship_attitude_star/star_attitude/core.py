"""Core of the node ``star_attitude``, shared with the replay: attitudes from exposures of star sensors.

The core uses no ROS, no files and no clock. Each exposure gives the attitude of its sensor at the time of the exposure
(:mod:`ship_attitude_star.star_attitude.exposure_solver`, with :mod:`ship_stars.attitude_from_stars.solution`);
exposures may arrive in any order within ``lag_s``. Exposures of different sensors that are near in time give the
attitude of the deck, in time order. An attitude does not depend on earlier attitudes, so the core needs no time-ordered
estimator, only its :class:`ship_estimation.time_order.time_ordered_estimator.LagWindow`. The timeout clock is described
at :class:`ship_node.adapters.adapter.Adapter`.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace

from ship_attitude_star.star_attitude.config import JointConfig, ObservingSensorConfig, StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import (
    AttitudeSolution,
    PlacedExposure,
    RejectedStar,
    StarOutcome,
    rejected_exposure,
    rejected_group,
    solve_deck,
    solve_exposure,
)
from ship_attitude_star.star_attitude.ins_motion import INS, InsMotion, MotionBatch
from ship_estimation.plausibility.stuck_check import MotionReference, StuckChecks, largest_sigma
from ship_estimation.rejection_rules import (
    CONFLICT_HOLD_S,
    Reason,
    Rejection,
    StampConflicts,
    failure_rejection,
    resolve_same_stamp,
)
from ship_estimation.time_order.time_ordered_estimator import LagWindow
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.tracks.attitude_track import AttitudeSample, SampleBlock
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S, exposure_nodes
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_samples import SkyInput
from ship_stars.sky.sky_model import SkyModel

_LONGEST_REACH_NS = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns


@dataclass(frozen=True)
class _PendingExposure:
    """An exposure that is not solved yet.

    Attributes:
        exposure: stars of the exposure.
        rejected_stars: stars of the message that were already rejected.
        arrival_ns: arrival time by the timeout clock.
    """

    exposure: StarExposure
    rejected_stars: tuple[RejectedStar, ...]
    arrival_ns: int


class JointWindow:
    """Grouping of exposures of different sensors for joint solutions.

    An exposure belongs to at most one group, and a group has at most one exposure of each sensor.

    Args:
        sources: names of all sensors.
        config: maximum time between the exposures of a group, and time for which a group waits for more exposures.
    """

    def __init__(self, sources: Collection[str], config: JointConfig) -> None:
        self._sources = frozenset(sources)
        self._window_ns = round(config.window_s * SECOND_NS)
        self._simultaneous_ns = round(config.simultaneous_s * SECOND_NS)
        self._wait_ns = round(config.wait_s * SECOND_NS)
        self._items: list[PlacedExposure] = []
        self._arrivals_ns: dict[tuple[int, str], int] = {}
        self._last_ns: int | None = None

    def add(self, item: PlacedExposure, arrival_ns: int | None = None) -> bool:
        """Add an exposure, or replace that of the same sensor and stamp; return False if the exposure is too late.

        Args:
            item: the exposure.
            arrival_ns: arrival time by the timeout clock; None if it equals the stamp.
        """
        if self._last_ns is not None and item.time_ns <= self._last_ns:
            return False
        key = item.time_ns, item.source
        self._items = [other for other in self._items if (other.time_ns, other.source) != key]
        self._items.append(item)
        self._items.sort(key=lambda other: (other.time_ns, other.source))
        self._arrivals_ns[key] = item.time_ns if arrival_ns is None else arrival_ns
        return True

    def complete_groups(
        self, is_turn_known: Callable[[int, int], bool], waiting_ns: int | None
    ) -> Iterator[list[PlacedExposure]]:
        """Remove and yield the groups that are complete or have waited long enough, in time order.

        Args:
            is_turn_known: function that returns True if the rotation of the deck between two times (ns) is known.
            waiting_ns: current time by the timeout clock; None if it is not known.
        """
        while self._items:
            group = self._group(is_turn_known)
            first_ns = group[0].time_ns
            # A sensor with a later exposure provides no more exposures for this group.
            missing_sources = self._sources - {item.source for item in self._items}
            since_ns = self._arrivals_ns[first_ns, group[0].source]
            if missing_sources and (waiting_ns is None or waiting_ns - since_ns < self._wait_ns):
                return
            used = {id(item) for item in group}
            self._items = [item for item in self._items if id(item) not in used]
            for item in group:
                del self._arrivals_ns[item.time_ns, item.source]
            self._last_ns = first_ns
            yield group

    def _group(self, is_turn_known: Callable[[int, int], bool]) -> list[PlacedExposure]:
        """Return the earliest exposure, and the first exposure of each other sensor that can be joined with it.

        Exposures can be joined within ``simultaneous_s``, or within ``window_s`` if the rotation is known.
        """
        first_ns = self._items[0].time_ns
        group: dict[str, PlacedExposure] = {}
        for item in self._items:
            later_ns = item.time_ns - first_ns
            if later_ns > self._window_ns and later_ns > self._simultaneous_ns:
                break
            if item.source not in group and (
                later_ns <= self._simultaneous_ns or is_turn_known(first_ns, item.time_ns)
            ):
                group[item.source] = item
        return list(group.values())


class StarCore:
    """Estimator of attitudes from stars alone.

    Args:
        config: parameters of the node.
        sky_model: sky model.

    Attributes:
        joined_by_ins: True if the INS attitude was known at the time of the last joint solution.
    """

    def __init__(self, config: StarAttitudeConfig, sky_model: SkyModel) -> None:
        self._config = config
        self._sky_model = sky_model
        self._wait_ns = round(config.joint.wait_s * SECOND_NS)
        self._sources = frozenset(f"star.{id_}" for id_ in config.star_sensors)
        # Conflicts of sensors, position and air, and conflicts of the INS.
        self._stamp_conflicts, self._ins_stamp_conflicts = StampConflicts(), StampConflicts()
        self.reset()

    def reset(self, clock_jumped: bool = False) -> None:
        """Discard all inputs; outputs may start again at earlier times, even if the clock has not jumped."""
        self._sky_model.reset()
        self._start_without_samples()

    def step_time_base(self, step_ns: int, _state: None = None) -> None:
        """Continue after a step of the time base: shift position and air data, discard exposures and INS samples."""
        self._sky_model.step_time_base(step_ns)
        self._start_without_samples()

    def _start_without_samples(self) -> None:
        self._stuck_checks = StuckChecks()
        # Two publishers of a source remain recorded.
        self._stamp_conflicts.reset()
        self._ins_stamp_conflicts.reset()
        self._ins = InsMotion(self._config.ins, self._stuck_checks.motion_references, self._ins_stamp_conflicts)
        self._received: dict[tuple[str, int], StarExposure] = {}
        self._pending: dict[tuple[str, int], _PendingExposure] = {}
        self._window = JointWindow(self._sources, self._config.joint)
        self._arrivals = LagWindow(self._config.lag_s)
        self.joined_by_ins = False

    def reconfigure(self, config: StarAttitudeConfig) -> None:
        """Continue with changed noise parameters; geometry and the set of sensors stay."""
        self._config = config
        self._ins.reconfigure(config.ins)

    def add_ins(self, sample: AttitudeSample) -> StarOutcome:
        """Add an INS sample, used to select stars and to propagate exposures to one time."""
        late = self._arrivals.late_rejection(sample.time_ns)
        if late is not None:
            return StarOutcome(late)
        outcome = StarOutcome(self._ins.add(sample))
        self._arrivals.advance_to(sample.time_ns)
        self._advance(outcome)
        return outcome

    def evaluate_block(self, block: SampleBlock, arrivals_ns: StampArray) -> MotionBatch | None:
        """Check the INS samples of a block as one batch; see :meth:`InsMotion.evaluate_block`."""
        return self._ins.evaluate_block(block, arrivals_ns, self._config.lag_s)

    def commit_block(self, batch: MotionBatch, stop: int) -> None:
        """Commit the samples of a batch before index ``stop``, and solve the exposures that waited for these samples.

        The solutions are stored in ``batch.pending_outcomes``.
        """
        while batch.committed_count < stop:
            # A pending exposure may need this sample. Pending groups wait for exposures only.
            end, outcome = batch.committed_count + 1 if self._pending else stop, StarOutcome()
            self._ins.commit_block(batch, end)
            self._arrivals.advance_to(batch.samples[end - 1].time_ns)
            self._advance(outcome)
            if outcome.solved or outcome.not_joined:
                batch.pending_outcomes.append((end - 1, outcome))

    def finish_block(self, batch: MotionBatch) -> StarOutcome | None:
        """Finish a batch; return the outcome of the sample that needs separate handling, None without such a sample."""
        rejection = self._ins.finish_block(batch)
        if batch.checked.last is None:
            return None
        outcome = StarOutcome(rejection)
        self._arrivals.advance_to(batch.checked.last.sample.time_ns)
        self._advance(outcome)
        return outcome

    def block_estimates(self, _turns: MotionBatch) -> list[tuple[slice, StarOutcome]]:
        """Return no estimates; INS samples give only the outcomes of :meth:`commit_block`."""
        return []

    def add_surroundings(self, given: SkyInput) -> Rejection | None:
        """Add a position fix or an air reading; return the rejection or a remark, None without either."""
        rejection = self._sky_model.surroundings.rejection(given)
        self._sky_model.surroundings.insert(given)
        return rejection

    def add_exposure(
        self, exposure: StarExposure, rejected_stars: tuple[RejectedStar, ...] = (), arrival_ns: int | None = None
    ) -> StarOutcome:
        """Add an exposure; of two different exposures of one sensor with one stamp, neither is solved.

        Args:
            exposure: stars of the exposure.
            rejected_stars: stars of the message that cannot be used.
            arrival_ns: arrival time by the timeout clock; None if it equals the stamp.
        """
        rejection = self._arrivals.late_rejection(exposure.time_ns)
        if rejection is not None:
            return StarOutcome(rejection)
        key = exposure.source, exposure.time_ns
        known = self._received.get(key)
        if known is None:
            by_ins = self._ins.ins_check.motion_references(exposure.time_ns, self._ins.track)
            rejection = self._stuck_checks.check(*key, exposure.stuck_value, by_ins)
            if rejection is not None:
                return StarOutcome(rejection)
        else:
            rejection = resolve_same_stamp(known, exposure)[1]
            if rejection.reason is Reason.DUPLICATE:
                return StarOutcome(rejection)
            # Neither exposure is solved; a published solution is replaced by an INVALID solution.
            self._stamp_conflicts.record(*key, rejection)
            text = "the same stamp with different content: do two sensors publish on one topic?"
            rejection = replace(rejection, text=text)
        self._received[key] = exposure
        self._arrivals.advance_to(exposure.time_ns)
        arrival_ns = exposure.time_ns if arrival_ns is None else arrival_ns
        self._pending[key] = _PendingExposure(exposure, rejected_stars, arrival_ns)
        outcome = StarOutcome(rejection)
        self._advance(outcome)
        return outcome

    def set_duplicate_publishers(self, source: str, text: str) -> None:
        """Record that two publishers send data of one source; an empty text ends this state."""
        contradictions = self._ins_stamp_conflicts if source == INS else self._stamp_conflicts
        contradictions.set_duplicate_publishers(source, self._arrivals.newest_ns, text)

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> StarOutcome:
        """Solve exposures and groups that are complete or have waited for the maximum time.

        Args:
            now_ns: current time.
            waiting_ns: current time by the timeout clock; None if it equals ``now_ns``.
        """
        outcome = StarOutcome()
        self._solve(outcome, now_ns if waiting_ns is None else waiting_ns)
        return outcome

    def unmeasured_quantities(self) -> list[str]:
        """Return the names of the air quantities that are taken from parameters at the newest time of the data."""
        return self._sky_model.surroundings.unmeasured_quantities(self._arrivals.newest_ns)

    # -- solutions in time order ----------------------------------------------------------------------------

    def _advance(self, outcome: StarOutcome) -> None:
        """Solve pending exposures where possible, and discard data that no later exposure needs."""
        self._solve(outcome, None)
        oldest_ns = self._arrivals.oldest_ns - self._wait_ns
        self._sky_model.surroundings.drop_before(oldest_ns)
        self._received = {key: one for key, one in self._received.items() if one.time_ns >= oldest_ns}
        self._ins.drop_before(oldest_ns - _LONGEST_REACH_NS)

    def _solve(self, outcome: StarOutcome, waiting_ns: int | None) -> None:
        for key, waiting in list(self._pending.items()):
            overdue = waiting_ns is not None and waiting_ns - waiting.arrival_ns >= self._wait_ns
            if self._ins.is_awaited(waiting.exposure.time_ns, waiting.exposure.reach_ns) and not overdue:
                continue
            del self._pending[key]
            try:
                placed, solved = self._solve_one(waiting)
            except Exception as error:
                _, solved = rejected_exposure(waiting.exposure, waiting.rejected_stars, failure_rejection(error))
                outcome.solved.append(solved)
                continue
            outcome.solved.append(solved)
            if not self._window.add(placed, waiting.arrival_ns):
                outcome.not_joined.append((placed.source, placed.time_ns))
        for group in self._window.complete_groups(self._ins.is_turn_known, waiting_ns):
            try:
                joint = self._joint(group)
            except Exception as error:
                joint = rejected_group(group[0].time_ns, failure_rejection(error))
            outcome.solved.append(joint)

    def _solve_one(self, waiting: _PendingExposure) -> tuple[PlacedExposure, AttitudeSolution]:
        """Solve the attitude of a sensor from one exposure; a solved attitude becomes a motion reference of checks."""
        contradiction = self._contradiction(waiting.exposure.source, waiting.exposure.time_ns)
        if contradiction is not None:
            return rejected_exposure(waiting.exposure, waiting.rejected_stars, contradiction)
        sensor = _sensor_config(self._config, waiting.exposure.source)
        exposure, noise_variance, error_variance = self._ins.at_middle(waiting.exposure, sensor)
        prior = self._ins.sensor_prior(exposure.time_ns, sensor)
        if prior is not None and exposure.length is not None and exposure.smear_s is None:
            # The solution would be compared with the INS, but the errors along the streaks are not known.
            return rejected_exposure(exposure, waiting.rejected_stars, exposure.length.coverage_rejection)
        placed, solved = solve_exposure(
            exposure, waiting.rejected_stars, prior, self._sky_model, noise_variance, error_variance
        )
        if exposure.length is not None and exposure.smear_s is None and solved.is_valid:
            text = f"no rotation of the ship from ins/imu during the exposure of {exposure.length.exposure_s:g} s"
            solved = replace(solved, text="; ".join(filter(None, [solved.text, text])))
        if solved.sources:
            rotation_ns, covariance_n = solved.solution.rotation_nb, solved.solution.covariance_n
            noise_s = rotation_ns.T @ covariance_n @ rotation_ns
            self._stuck_checks.motion_references[placed.source] = MotionReference(
                solved.time_ns, rotation_ns, largest_sigma(noise_s)
            )
        return placed, solved

    def _contradiction(self, source: str, time_ns: int) -> Rejection | None:
        """Return the rejection for conflicting data of the sensor, the position or the air; None without a conflict."""
        conflicts = self._stamp_conflicts
        contested = [name for name in conflicts.duplicate_publishers if name == source or name not in self._sources]
        if contested:
            return Rejection(Reason.CONFLICT, conflicts.text(contested))
        if source not in conflicts.active_at(time_ns):
            return None
        text = f"its stars are used again after {CONFLICT_HOLD_S:g} s without a contradiction"
        return Rejection(Reason.CONFLICT, f"{conflicts.text([source])}: {text}")

    def _joint(self, group: list[PlacedExposure]) -> AttitudeSolution:
        time_ns = group[0].time_ns
        # A conflict of a sensor may have been detected after its exposure was solved.
        group = [
            placed if self._contradiction(placed.source, placed.time_ns) is None else replace(placed, stars=None)
            for placed in group
        ]
        # An unknown rotation is neglected: that exposure is within ``simultaneous_s`` of the first exposure.
        turns, covariance_d = self._ins.deck_turns(time_ns, [placed.exposure for placed in group])
        mounted = [
            replace(placed, rotation_ds=turn @ _sensor_config(self._config, placed.source).rotation_ds)
            for placed, turn in zip(group, turns, strict=True)
        ]
        prior = self._ins.deck_prior(time_ns)
        self.joined_by_ins = prior is not None
        return solve_deck(time_ns, mounted, covariance_d, self._config.star_sensors, prior)


def _sensor_config(config: StarAttitudeConfig, source: str) -> ObservingSensorConfig:
    return config.star_sensors[source.partition(".")[2]]
