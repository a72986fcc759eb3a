"""The ship's motion by its INS: the attitude of the deck and of its sensors, and turns from one moment to another.

The attitude helps to choose among stars. Turns move the stars of an exposure to its middle, and exposures of several
sensors to one moment.

A turn is the difference of two attitudes by the INS, and has the noise of both. Between two samples an attitude is a
weighted mean of the samples around, so attitudes that lie close together share the noise of the same samples. The noise
of a turn with the weights w1 at one end and w2 at the other is therefore (w1 - w2)² of each sample: nothing where the
ends meet, and the sum of both where they are samples apart. Several turns to one moment share its noise likewise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ship_attitude_star.guards.stream_guards import StreamGuards
from ship_attitude_star.measurements.samples import StampArray
from ship_attitude_star.star_attitude.exposure_solver import StarOutcome
from ship_attitude_star.stars.config import MountingConfig
from ship_attitude_star.stars.exposure import StarExposure, at_middle
from ship_attitude_star.stars.selection import StarPrior
from ship_estimation.estimator_shell import surely_in_time
from ship_estimation.ins import InsJump, StarInsConfig
from ship_estimation.ins_guard import Followed, JudgedIns
from ship_estimation.refusals import Contradictions, Refusal, same_stamp
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack, InterpolatedAttitude, SampleBlock
from ship_geometry.exposure_mean import turning_over
from ship_geometry.interpolation_error import joint_covariance
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.time_scales import SECOND_NS

INS = "ins"


@dataclass(frozen=True)
class MiddleOfExposure:
    """The stars of an exposure where they stood at its middle, as far as the INS tells it.

    Attributes:
        exposure: the stars.
        noise_variance: variance that the noise of the INS's samples gives to a turn of all directions alike, each
            axis, rad².
        error_variance: the same of what else is wrong with the correction: of the interpolation, or of the whole turn
            during an exposure over which the INS has no samples.
    """

    exposure: StarExposure
    noise_variance: float
    error_variance: float


@dataclass(frozen=True)
class DeckTurns:
    """How the deck turned from each of m exposures to one moment.

    Attributes:
        rotations: "deck at that moment from deck at the exposure", shape (m, 3, 3).
        covariance_d: of the errors of all of them, rotation vectors in the deck, rad², shape (m, 3, m, 3).
    """

    rotations: FloatArray
    covariance_d: FloatArray


@dataclass
class InsTurns:
    """Samples of a block that were judged ahead, and have their turn among the other inputs.

    Attributes:
        samples: those that go the usual way, from the first one on.
        values: attitudes of all that were judged, shape (N, 3, 3).
        followed: what the guard said of them, and of one more where that does not go the usual way.
        taken: how many had their turn.
        told: number of a sample, and what its turn led to, as far as nobody has asked for it.
    """

    samples: list[AttitudeSample]
    values: FloatArray
    followed: Followed
    taken: int = 0
    told: list[tuple[int, StarOutcome]] = field(default_factory=list)


class InsMotion:
    """Attitudes of the deck by their stamps, with the INS's errors as configured.

    Args:
        config: the INS.
        guards: watch its samples.
        contradictions: of the INS; None for new ones.

    Attributes:
        track: the samples by their stamps.
    """

    def __init__(
        self, config: StarInsConfig, guards: StreamGuards, contradictions: Contradictions | None = None
    ) -> None:
        self._config = config
        self._guards = guards
        self._max_gap_ns = round(config.max_gap_s * SECOND_NS)
        self._offset_ns = round(config.time_offset_s * SECOND_NS)
        self.track = AttitudeTrack(self._max_gap_ns)
        self._contradictions = Contradictions() if contradictions is None else contradictions
        self._jumps: list[InsJump] = []

    def reconfigure(self, config: StarInsConfig) -> None:
        """Go on with other sigmas."""
        self._config = config
        self._guards.ins.reconfigure(config)

    def add(self, sample: AttitudeSample) -> Refusal | None:
        """Take a sample; the refusal where it is not used."""
        return self._use(self._guards.ins.judge(sample, self.track, self._guards.witnesses))

    def look_ahead(self, block: SampleBlock, arrivals_ns: StampArray, lag_s: float) -> InsTurns | None:
        """Judge samples before their turn, from the first one on, as long as they go the usual way.

        Until all of them had their turn (:meth:`take`, :meth:`end`) no other sample is taken.

        Args:
            block: samples with rates, in the order of their stamps.
            arrivals_ns: when each comes, by the clock that judges stamps, shape (N,).
            lag_s: samples so late are not used.

        Returns:
            None where the first one is to be taken by itself.
        """
        newest, guard = self.track.newest, self._guards.ins
        if newest is None or not guard.looks_ahead(int(block.times_ns[0])):
            return None
        # No sample after a gap, and none that may be late, whatever else has come before its turn.
        steps_ns = np.diff(block.times_ns, prepend=newest.time_ns)
        near = (steps_ns > 0) & (steps_ns <= self._max_gap_ns) & surely_in_time(block.times_ns, arrivals_ns, lag_s)
        block = block.some(slice(len(near) if near.all() else int(np.argmin(near))))
        if not len(block.times_ns):
            return None
        samples = block.samples()
        followed = guard.look_ahead(samples, block)
        if not followed.count:
            return None
        return InsTurns(samples[: followed.usual], block.rotations_nd[: followed.count], followed)

    def take(self, turns: InsTurns, stop: int) -> None:
        """Samples that were judged ahead have their turn, up to one that is not included."""
        self.track.extend(turns.samples[turns.taken : stop])
        turns.taken, self._guards.ins.by_rates = stop, turns.followed.by_rates(stop - 1)

    def end(self, turns: InsTurns) -> Refusal | None:
        """All samples that were judged ahead had their turn, but for one that does not go the usual way."""
        self._guards.ins.arrive(turns.values, turns.followed, self._guards.witnesses)
        return None if turns.followed.last is None else self._use(turns.followed.last)

    def _use(self, judged: JudgedIns) -> Refusal | None:
        """Use a sample that was judged; the refusal where it is not used."""
        if judged.rates_wrong_after_ns is not None:
            self.track.forget_rates(judged.rates_wrong_after_ns)
        for jump in judged.jumps:
            self.track.cut(jump.time_ns)
            self._jumps.append(jump)
        if judged.noise is not None:
            self.track.add_noise(judged.noise)
        if judged.refusal is not None:
            return judged.refusal
        sample = judged.sample
        known = self.track.get(sample.time_ns)
        taken, refusal = (True, None) if known is None else same_stamp(known, sample)
        self._contradictions.note(INS, sample.time_ns, refusal)
        if taken:
            self.track.insert(sample)
        return refusal

    def awaited(self, time_ns: int, reach_ns: int = 0) -> bool:
        """Whether samples still to come may tell the attitude from a moment until ``reach_ns`` later."""
        newest, stamp_ns = self.track.newest, time_ns - self._offset_ns
        if newest is None or stamp_ns - newest.time_ns >= self._max_gap_ns or self._contradicts_itself(stamp_ns):
            return False
        return not self.track.covers(stamp_ns + reach_ns)

    def deck(self, time_ns: int) -> StarPrior | None:
        """The attitude of the deck at a moment, with all errors that the INS may have; None where it is not known."""
        found = self._at(time_ns)
        if found is None:
            return None
        config = self._config
        slow = np.array([config.tilt_sigma_arcsec, config.heading_sigma_arcsec, config.tilt_sigma_arcsec]) * ARCSEC
        white_variance = found.noise_gain * (config.white_sigma_arcsec * ARCSEC) ** 2
        shifted_n = config.time_offset_sigma_s * (found.rotation_nd @ found.rate_d)
        covariance_n = np.diag(slow**2 + white_variance) + np.outer(shifted_n, shifted_n)
        if self._jumps:
            jumped_n = self._jumped_n(time_ns)
            covariance_n += np.outer(jumped_n, jumped_n)
        return StarPrior(found.rotation_nd, covariance_n + found.error_covariance_n)

    def tells_turn(self, to_ns: int, from_ns: int) -> bool:
        """Whether it is known how the deck turned between two moments; at one and the same moment it did not turn."""
        if to_ns == from_ns:
            return True
        told = self._at(to_ns) is not None and self._at(from_ns) is not None
        return told and bool(np.all(self._jumped_n(to_ns) == self._jumped_n(from_ns)))

    def turns(self, to_ns: int, exposures: Sequence[StarExposure]) -> DeckTurns:
        """The turns of the deck from the middles of exposures to one moment.

        The slow error of the INS is the same at all moments and cancels. What is left is its noise, and its time offset
        where the rate changes. The noise of :meth:`at_middle` is included, because the turn to the middle and that from
        there on have it in common. Where the INS does not tell a turn, the deck is taken to have been at rest.
        """
        moved = [
            row
            for row, exposure in enumerate(exposures)
            if exposure.time_ns != to_ns and self.tells_turn(to_ns, exposure.time_ns)
        ]
        noise = self.track.noise_covariance_of_sums(
            [self._noise_of_turn(to_ns if row in moved else e.time_ns, e) for row, e in enumerate(exposures)]
        )
        noise *= self._noise_variance(to_ns)
        rotations = np.tile(np.eye(3), (len(exposures), 1, 1))
        covariance_d = noise[:, None, :, None] * np.eye(3)[:, None, :]
        if moved:
            ends = [self._at(time_ns) for time_ns in (to_ns, *(exposures[row].time_ns for row in moved))]
            told = [end for end in ends if end is not None]
            rotations[moved], between = self._turns_between(told[0], told[1:])
            covariance_d[np.ix_(moved, range(3), moved, range(3))] += between
        return DeckTurns(rotations, covariance_d)

    def _turns_between(
        self, end: InterpolatedAttitude, starts: Sequence[InterpolatedAttitude]
    ) -> tuple[FloatArray, FloatArray]:
        """Turns from m attitudes by the INS to one, and the covariance of what is wrong with them beside noise.

        Returns:
            Rotations, shape (m, 3, 3), and the covariance of their rotation vectors, rad², shape (m, 3, m, 3).
        """
        to_end = np.array([end.rotation_nd.T @ start.rotation_nd for start in (end, *starts)])
        rates_d = np.array([found.rate_d for found in (end, *starts)])
        # At a sample there is no error of interpolation, between samples there are one or two estimates of it.
        errors_d = np.zeros((len(to_end), 2, 3))
        for row, found in enumerate((end, *starts)):
            if found.errors_d:
                errors_d[row, : len(found.errors_d)] = found.errors_d
        interval = np.array([-1 if found.sample is None else found.sample.time_ns for found in (end, *starts)])
        errors = joint_covariance(errors_d @ np.swapaxes(to_end, -1, -2), interval)
        shifted_d = self._config.time_offset_sigma_s * (to_end @ rates_d[..., None])[..., 0]
        errors += np.multiply.outer(shifted_d, shifted_d)
        of_turns = errors[1:, :, 1:] - errors[1:, :, :1] - errors[:1, :, 1:] + errors[:1, :, :1]
        return to_end[1:], of_turns

    def sensor(self, time_ns: int, mounting: MountingConfig) -> StarPrior | None:
        """The attitude of a sensor (horizon from sensor) at a moment, with the errors of INS and mounting."""
        deck = self.deck(time_ns)
        if deck is None:
            return None
        rotation_ns = deck.rotation_nb @ mounting.rotation_ds
        mounting_n = rotation_ns * mounting.installation_sigma_s
        return StarPrior(rotation_ns, deck.covariance_n + mounting_n @ mounting_n.T)

    def at_middle(self, exposure: StarExposure, mounting: MountingConfig) -> MiddleOfExposure:
        """The stars where they stood at the middle of the exposure, by the turning of the deck meanwhile.

        Constant errors of the INS have no part in the turning. Where the INS does not tell it, the stars stay where
        they were seen.
        """
        length = exposure.length
        if length is None:
            return MiddleOfExposure(exposure, 0.0, 0.0)
        stamp_ns = exposure.time_ns - self._offset_ns
        turning = None if self._contradicts_itself(stamp_ns) else turning_over(self.track, stamp_ns, length.nodes)
        if turning is None:
            untold = np.deg2rad(self._config.untold_acceleration_deg_per_s2)
            return MiddleOfExposure(exposure, 0.0, length.untold_turn_variance(float(untold)))
        white_variance = turning.correction_gain * (self._config.white_sigma_arcsec * ARCSEC) ** 2
        corrected = at_middle(exposure, turning.mounted(mounting.rotation_ds).turns)
        return MiddleOfExposure(corrected, white_variance, turning.correction_error)

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``."""
        self.track.drop_before(time_ns - self._offset_ns)

    def _noise_of_turn(self, to_ns: int, exposure: StarExposure) -> list[tuple[int, float]]:
        """Moments (ns, stamps of the INS) whose attitudes make the turn from an exposure, each with its weight."""
        middle_ns, length = exposure.time_ns - self._offset_ns, exposure.length
        if length is not None and exposure.smear_s is not None:
            return [*length.nodes.moments(middle_ns), (to_ns - self._offset_ns, -1.0)]
        if to_ns == exposure.time_ns:
            return []
        return [(middle_ns, 1.0), (to_ns - self._offset_ns, -1.0)]

    def _noise_variance(self, time_ns: int) -> float:
        """Variance of an attitude's noise about its worst axis at a moment, rad²."""
        stated = (self._config.white_sigma_arcsec * ARCSEC) ** 2
        extra, found = self.track.extra_noise(time_ns - self._offset_ns), self._at(time_ns)
        if extra is None or found is None:
            return stated
        return stated + extra.white_rad2 + extra.jitter_s2 * float(found.rate_d @ found.rate_d)

    def _jumped_n(self, time_ns: int) -> FloatArray:
        """Sum of all jumps of the INS until a moment, rotation vector, rad: its attitude may be wrong by as much."""
        before = [jump.jump_n for jump in self._jumps if jump.time_ns < time_ns - self._offset_ns]
        return np.sum(before, axis=0) if before else np.zeros(3)

    def _at(self, time_ns: int) -> InterpolatedAttitude | None:
        stamp_ns = time_ns - self._offset_ns
        return None if self._contradicts_itself(stamp_ns) else self.track.at(stamp_ns)

    def _contradicts_itself(self, stamp_ns: int) -> bool:
        """Whether the INS said different things of one moment not long ago: then it tells nothing."""
        return INS in self._contradictions.at(stamp_ns)
