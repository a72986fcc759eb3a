"""Exposures of star sensors in, attitudes out: the core that the node ``star_attitude`` and the replay share.

Knows no ROS, no files, no clock. Each exposure gives the attitude of its sensor, at its own time and in any order
within ``lag_s``; exposures of different sensors near in time give the attitude of the deck, in order of time. How long
something waits is measured in the time of waiting (:mod:`ship_estimation.estimator_shell`).
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.guards.stream_guards import StreamGuards
from ship_attitude_star.measurements.readings import SkyInput
from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.star_attitude.config import ObservingSensorConfig, StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import (
    Mounted,
    PlacedExposure,
    RefusedStar,
    Solved,
    StarOutcome,
    solve_deck,
    solve_exposure,
)
from ship_attitude_star.star_attitude.ins_motion import InsMotion
from ship_attitude_star.star_attitude.joint_window import JointWindow
from ship_attitude_star.stars.config import JOINT
from ship_attitude_star.stars.exposure import StarExposure, at_middle
from ship_attitude_star.stars.selection import AttitudePrior
from ship_attitude_star.stars.solution import no_attitude
from ship_estimation.refusals import Reason, Refusal, failure
from ship_estimation.stamped_values import StampedValues
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S, exposure_nodes
from ship_geometry.rotations import FloatArray

_SECOND_NS = 1_000_000_000
_LONGEST_REACH_NS = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns
_AT_REST: FloatArray = np.eye(3)
_EXACT: FloatArray = np.zeros((3, 3))


@dataclass(frozen=True)
class _Waiting:
    """An exposure that has not been solved yet, those of its stars that were refused already, and when it came."""

    exposure: StarExposure
    refused: tuple[RefusedStar, ...]
    arrival_ns: int


class StarCore:
    """Attitudes from stars.

    Args:
        config: the node's parameters.
        watch: the sky.

    Attributes:
        joined_by_ins: whether the INS could move the exposures of the last joint solution to one moment.
    """

    def __init__(self, config: StarAttitudeConfig, watch: SkyWatch) -> None:
        self._config = config
        self._watch = watch
        self._lag_ns = round(config.lag_s * _SECOND_NS)
        self._wait_ns = round(config.joint.wait_s * _SECOND_NS)
        self.reset()

    def reset(self) -> None:
        """Forget all inputs."""
        self._watch.reset()
        self._guards = StreamGuards(self._config.ins)
        self._ins = InsMotion(self._config.ins, self._guards)
        self._sources = [f"star.{id_}" for id_ in self._config.star_sensors]
        self._taken: dict[str, StampedValues[StarExposure]] = {source: StampedValues() for source in self._sources}
        self._waiting: list[_Waiting] = []
        self._window: JointWindow[PlacedExposure] = JointWindow(self._sources, self._config.joint)
        self._newest_ns = 0
        self.joined_by_ins = False

    def reconfigure(self, config: StarAttitudeConfig) -> None:
        """Go on with other sigmas; geometry and the set of sensors stay."""
        self._config = config
        self._ins.reconfigure(config.ins)

    def add_ins(self, sample: AttitudeSample) -> StarOutcome:
        """The attitude of the deck as the INS has it: it chooses among stars, and its turn moves them to one moment."""
        if self._too_late(sample.time_ns):
            return StarOutcome(self._late(sample.time_ns))
        outcome = StarOutcome(self._ins.add(sample))
        self._advance(sample.time_ns, outcome)
        return outcome

    def add_surroundings(self, given: SkyInput) -> Refusal | None:
        """Where the ship is, or the air around it; returns why it is not used."""
        refusal = self._watch.refusal(given)
        self._watch.insert(given)
        return refusal

    def add_exposure(
        self, exposure: StarExposure, refused: tuple[RefusedStar, ...] = (), arrival_ns: int | None = None
    ) -> StarOutcome:
        """The stars of a sensor; of two exposures of one stamp that whose bytes sort first holds.

        Args:
            exposure: the stars.
            refused: further stars of the message that cannot be used.
            arrival_ns: when it came, in the time of waiting; None where each comes at its stamp.
        """
        refusal = self._refusal(exposure)
        if refusal is not None and refusal.reason is not Reason.CONFLICT:
            return StarOutcome(refusal)
        if self._taken[exposure.source].insert(exposure.time_ns, exposure) is None:
            return StarOutcome(refusal)
        self._wait(_Waiting(exposure, refused, exposure.time_ns if arrival_ns is None else arrival_ns))
        outcome = StarOutcome(refusal)
        self._advance(exposure.time_ns, outcome)
        return outcome

    def tick(self, waiting_ns: int) -> StarOutcome:
        """The time of waiting now: nothing waits any longer than it should."""
        outcome = StarOutcome()
        self._solve(outcome, waiting_ns)
        return outcome

    def not_measured(self) -> list[str]:
        """Which quantities of the air are taken from parameters, at the newest time of the data."""
        return self._watch.not_measured(self._newest_ns)

    # -- what is used ---------------------------------------------------------------------------------------

    def _refusal(self, exposure: StarExposure) -> Refusal | None:
        if self._too_late(exposure.time_ns):
            return self._late(exposure.time_ns)
        refusal = self._taken[exposure.source].refusal(exposure.time_ns, exposure)
        if refusal is not None and refusal.reason is Reason.CONFLICT:
            return replace(refusal, text=f"{refusal.text}; do two sensors publish on one topic?")
        return refusal or self._guards.check(exposure, self._ins.track)

    def _wait(self, new: _Waiting) -> None:
        """Put an exposure among those to be solved, in the place of a refused one of its stamp where that waits too."""
        key = new.exposure.source, new.exposure.time_ns
        for index, old in enumerate(self._waiting):
            if (old.exposure.source, old.exposure.time_ns) == key:
                self._waiting[index] = new
                return
        self._waiting.append(new)

    def _too_late(self, time_ns: int) -> bool:
        return time_ns < self._newest_ns - self._lag_ns

    def _late(self, time_ns: int) -> Refusal:
        late_s = (self._newest_ns - time_ns) / _SECOND_NS
        return Refusal(Reason.LATE, f"{late_s:.3f} s behind the newest data: more than lag_s = {self._config.lag_s:g}")

    # -- in order of time -----------------------------------------------------------------------------------

    def _advance(self, time_ns: int, outcome: StarOutcome) -> None:
        """Solve what can be solved now, and forget what no exposure can ask for any more."""
        self._newest_ns = max(self._newest_ns, time_ns)
        self._solve(outcome, None)
        oldest_ns = self._newest_ns - self._lag_ns - self._wait_ns
        self._watch.drop_before(oldest_ns)
        self._ins.drop_before(oldest_ns - _LONGEST_REACH_NS)
        for taken in self._taken.values():
            taken.drop_before(oldest_ns)

    def _solve(self, outcome: StarOutcome, waiting_ns: int | None) -> None:
        still_waiting = []
        for waiting in self._waiting:
            overdue = waiting_ns is not None and waiting_ns - waiting.arrival_ns >= self._wait_ns
            if self._ins.awaited(waiting.exposure.time_ns, waiting.exposure.reach_ns) and not overdue:
                still_waiting.append(waiting)
                continue
            try:
                placed, solved = self._solve_one(waiting)
            except Exception as error:
                solution = no_attitude(np.zeros(len(waiting.exposure), dtype=bool), failure(error))
                sensor_id, time_ns = waiting.exposure.source.partition(".")[2], waiting.exposure.time_ns
                outcome.solved.append(Solved(sensor_id, time_ns, solution, waiting.refused, ()))
                continue
            self._note(solved)
            outcome.solved.append(solved)
            if not self._window.add(placed, waiting.arrival_ns):
                outcome.not_joined.append((placed.source, placed.time_ns))
        self._waiting = still_waiting
        for group in self._window.closed(self._movable, waiting_ns):
            try:
                joint = self._joint(group)
            except Exception as error:
                joint = Solved(JOINT, group[0].time_ns, no_attitude(np.zeros(0, dtype=bool), failure(error)), (), ())
            outcome.solved.append(joint)

    def _solve_one(self, waiting: _Waiting) -> tuple[PlacedExposure, Solved]:
        """The attitude of one sensor by one exposure."""
        prior = self._prior(waiting.exposure)
        exposure, turn_variance = self._at_middle(waiting.exposure)
        placed, solved = solve_exposure(exposure, waiting.refused, prior, self._watch, turn_variance)
        if exposure.length is not None and exposure.smear_s is None and solved.valid:
            text = f"ins/imu does not tell how the ship turned in {exposure.length.exposure_s:g} s of exposure"
            solved = replace(solved, text="; ".join(filter(None, [solved.text, text])))
        return placed, solved

    def _prior(self, exposure: StarExposure) -> AttitudePrior | None:
        """The attitude of a sensor by the INS and its mounting, with the errors of both."""
        deck, sensor = self._ins.deck(exposure.time_ns), self._sensor(exposure.source)
        if deck is None:
            return None
        rotation_ns = deck.rotation_nb @ sensor.rotation_ds
        mounting_n = rotation_ns * sensor.installation_sigma_s
        return AttitudePrior(rotation_ns, deck.covariance_n + mounting_n @ mounting_n.T)

    def _at_middle(self, exposure: StarExposure) -> tuple[StarExposure, float]:
        """The stars where they stood at the middle, and the variance of that turn of all of them, each axis, rad².

        Where the INS does not tell how the ship turned, they are as they were seen, with what it may have turned.
        """
        if exposure.length is None:
            return exposure, 0.0
        told = self._ins.turning(exposure.time_ns, exposure.length.nodes)
        if told is None:
            untold = np.deg2rad(self._config.ins.untold_acceleration_deg_per_s2)
            return exposure, exposure.length.untold_turn_variance(float(untold))
        turning, variance = told
        return at_middle(exposure, turning.mounted(self._sensor(exposure.source).rotation_ds)), variance

    def _joint(self, group: list[PlacedExposure]) -> Solved:
        time_ns = group[0].time_ns
        mounted = []
        for placed in group:
            # Exposures so close that the ship is at rest need no turn.
            turn, covariance_d = self._ins.turn(time_ns, placed.time_ns) or (_AT_REST, _EXACT)
            covariance_d = covariance_d + placed.turn_variance * np.eye(3)
            mounted.append(Mounted(placed, turn @ self._sensor(placed.source).rotation_ds, covariance_d))
        prior = self._ins.deck(time_ns)
        self.joined_by_ins = prior is not None
        return solve_deck(time_ns, mounted, self._config.star_sensors, prior)

    def _movable(self, to_ns: int, from_ns: int) -> bool:
        return self._ins.turn(to_ns, from_ns) is not None

    def _note(self, solved: Solved) -> None:
        """A sensor's attitude tells whether other sensors stand still."""
        if solved.valid:
            rotation_ns, covariance_n = solved.solution.rotation_nb, solved.solution.covariance_n
            noise_s = rotation_ns.T @ covariance_n @ rotation_ns
            self._guards.used(AttitudeMeasurement(f"star.{solved.sensor_id}", solved.time_ns, rotation_ns, noise_s))

    def _sensor(self, source: str) -> ObservingSensorConfig:
        return self._config.star_sensors[source.partition(".")[2]]
