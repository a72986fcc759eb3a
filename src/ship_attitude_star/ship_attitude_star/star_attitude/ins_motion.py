"""Ship motion from the INS: attitudes of the deck and of sensors, and rotations between two times.

The attitude is used to select stars. Rotations propagate the stars of an exposure to its middle, and exposures of
several sensors to one time.

A rotation is the difference of two INS attitudes, its ends, and has the noise of both. An interpolated attitude is a
weighted mean of the samples around it, so attitudes close together share the noise of the same samples. A sample with
the weight w1 at one end and w2 at the other end adds (w1 - w2)² times its variance to the variance of the rotation. The
variance of the rotation is zero if the ends coincide. If the ends have no sample in common, the variance is the sum of
the variances of the ends. Several rotations to one time share the noise at that time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ship_attitude_star.star_attitude.exposure_solver import StarOutcome
from ship_estimation.parameters.ship_devices import StarInsConfig
from ship_estimation.plausibility.checked_ins import CheckedBlock, CheckedInsSample, InsJump
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.plausibility.stuck_check import MotionReference
from ship_estimation.rejection_rules import Rejection, StampConflicts, resolve_same_stamp
from ship_estimation.time_order.time_ordered_estimator import is_within_lag
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack, InterpolatedAttitude, SampleBlock
from ship_geometry.tracks.exposure_mean import exposure_motion
from ship_geometry.tracks.interpolation_error import joint_covariance
from ship_stars.attitude_from_stars.exposure import StarExposure, reduce_to_mid_exposure
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.camera.config import MountingConfig

INS = "ins"


@dataclass
class MotionBatch:
    """A batch of checked INS samples.

    Attributes:
        samples: accepted samples of the batch, which are the first samples of the block.
        values: attitudes of all checked samples, shape (N, 3, 3).
        checked: results of the INS check, including a last sample that needs separate handling.
        committed_count: number of committed samples.
        pending_outcomes: outcomes that are not yet retrieved, each with the index of its sample.
    """

    samples: list[AttitudeSample]
    values: FloatArray
    checked: CheckedBlock
    committed_count: int = 0
    pending_outcomes: list[tuple[int, StarOutcome]] = field(default_factory=list)


class InsMotion:
    """Attitudes and rotations of the deck from the INS, with the configured INS errors.

    Args:
        config: parameters of the INS.
        motion_references: attitude by each other source, by name of the source; None without other sources.
        stamp_conflicts: conflicts of INS samples with one stamp; None for a new record.

    Attributes:
        track: INS samples in time order.
        ins_check: plausibility checks of the samples.
    """

    def __init__(
        self,
        config: StarInsConfig,
        motion_references: Mapping[str, MotionReference] | None = None,
        stamp_conflicts: StampConflicts | None = None,
    ) -> None:
        self._config = config
        self.ins_check = InsCheck(config)
        self._motion_references = {} if motion_references is None else motion_references
        self._max_gap_ns = round(config.max_gap_s * SECOND_NS)
        self._offset_ns = round(config.time_offset_s * SECOND_NS)
        self.track = AttitudeTrack(self._max_gap_ns)
        self._stamp_conflicts = StampConflicts() if stamp_conflicts is None else stamp_conflicts
        self._jumps: list[InsJump] = []

    def reconfigure(self, config: StarInsConfig) -> None:
        """Continue with changed noise parameters."""
        self._config = config
        self.ins_check.reconfigure(config)

    def add(self, sample: AttitudeSample) -> Rejection | None:
        """Add a sample; return its rejection or a remark, None without either."""
        return self._use(self.ins_check.check(sample, self.track, self._motion_references))

    def evaluate_block(self, block: SampleBlock, arrivals_ns: StampArray, lag_s: float) -> MotionBatch | None:
        """Check the samples of a block as one batch, up to the first sample that needs separate handling.

        No other sample may be added until the batch is committed (:meth:`commit_block`, :meth:`finish_block`).

        Args:
            block: samples with rates, in the order of their stamps.
            arrivals_ns: arrival times by the clock that checks stamps, shape (N,).
            lag_s: maximum lateness of samples, s.

        Returns:
            The batch; None if the first sample needs separate handling.
        """
        newest = self.track.newest
        if newest is None or not self.ins_check.can_check_block(int(block.times_ns[0])):
            return None
        # A batch ends before a sample after a gap, and before a sample that may be too late.
        steps_ns = np.diff(block.times_ns, prepend=newest.time_ns)
        near = (steps_ns > 0) & (steps_ns <= self._max_gap_ns) & is_within_lag(block.times_ns, arrivals_ns, lag_s)
        block = block.subset(slice(len(near) if near.all() else int(np.argmin(near))))
        if not len(block.times_ns):
            return None
        samples = block.samples()
        checked = self.ins_check.check_block(samples, block)
        if not checked.count:
            return None
        return MotionBatch(samples[: checked.accepted_count], block.rotations_nd[: checked.count], checked)

    def commit_block(self, batch: MotionBatch, stop: int) -> None:
        """Commit the samples of a batch before index ``stop``."""
        self.track.extend(batch.samples[batch.committed_count : stop])
        batch.committed_count, self.ins_check.by_rates = stop, batch.checked.by_rates(stop - 1)

    def finish_block(self, batch: MotionBatch) -> Rejection | None:
        """Finish a batch with the sample that needs separate handling, if any; the result is as for :meth:`add`."""
        self.ins_check.commit_block(batch.values, batch.checked, self._motion_references)
        return None if batch.checked.last is None else self._use(batch.checked.last)

    def _use(self, checked: CheckedInsSample) -> Rejection | None:
        """Apply the results of a sample's check, and insert an accepted sample; the result is as for :meth:`add`."""
        if checked.rates_wrong_after_ns is not None:
            self.track.drop_rates(checked.rates_wrong_after_ns)
        for jump in checked.jumps:
            self.track.add_cut(jump.time_ns)
            self._jumps.append(jump)
        if checked.noise is not None:
            self.track.add_noise(checked.noise)
        if checked.rejection is not None:
            return checked.rejection
        sample = checked.sample
        known = self.track.get(sample.time_ns)
        is_kept, rejection = (True, None) if known is None else resolve_same_stamp(known, sample)
        self._stamp_conflicts.record(INS, sample.time_ns, rejection)
        if is_kept:
            self.track.insert(sample)
        return rejection

    def is_awaited(self, time_ns: int, reach_ns: int = 0) -> bool:
        """True if later samples may still determine the attitude up to ``reach_ns`` after a time."""
        newest, stamp_ns = self.track.newest, time_ns - self._offset_ns
        if newest is None or stamp_ns - newest.time_ns >= self._max_gap_ns or self._is_contradictory(stamp_ns):
            return False
        return not self.track.is_final_at(stamp_ns + reach_ns)

    def deck_prior(self, time_ns: int) -> StarPrior | None:
        """Return the attitude of the deck at a time, with all INS errors; None without an INS attitude."""
        found = self._attitude_at(time_ns)
        if found is None:
            return None
        config = self._config
        slow = np.array([config.tilt_sigma_arcsec, config.heading_sigma_arcsec, config.tilt_sigma_arcsec]) * ARCSEC
        white_variance = found.noise_gain * (config.white_sigma_arcsec * ARCSEC) ** 2
        shifted_n = config.time_offset_sigma_s * (found.rotation_nd @ found.rate_d)
        covariance_n = np.diag(slow**2 + white_variance) + np.outer(shifted_n, shifted_n)
        if self._jumps:
            jumped_n = self._ins_jumps_n(time_ns)
            covariance_n += np.outer(jumped_n, jumped_n)
        return StarPrior(found.rotation_nd, covariance_n + found.error_covariance_n)

    def is_turn_known(self, to_ns: int, from_ns: int) -> bool:
        """True if the times are equal, or if the INS gives the rotation of the deck between them without a jump."""
        if to_ns == from_ns:
            return True
        is_known = self._attitude_at(to_ns) is not None and self._attitude_at(from_ns) is not None
        return is_known and bool(np.all(self._ins_jumps_n(to_ns) == self._ins_jumps_n(from_ns)))

    def deck_turns(self, to_ns: int, exposures: Sequence[StarExposure]) -> tuple[FloatArray, FloatArray]:
        """Return the rotations of the deck from the middles of m exposures to one time.

        The correlated error of the INS is constant over these times and cancels. Noise and interpolation errors remain,
        and the time offset if the rate changes. The noise of the reduction to the middle (:meth:`at_middle`) is
        included, because the two noises are correlated. A rotation that is not known is assumed zero.

        Returns:
            Rotations "deck at this time from deck at the exposure", shape (m, 3, 3), and the error covariance of their
            rotation vectors in the deck frame, rad², shape (m, 3, m, 3).
        """
        turned_rows = [
            row
            for row, exposure in enumerate(exposures)
            if exposure.time_ns != to_ns and self.is_turn_known(to_ns, exposure.time_ns)
        ]
        noise = self.track.noise_covariance_of_sums(
            [self._noise_of_turn(to_ns if row in turned_rows else e.time_ns, e) for row, e in enumerate(exposures)]
        )
        noise *= self._noise_variance(to_ns)
        rotations = np.tile(np.eye(3), (len(exposures), 1, 1))
        covariance_d = noise[:, None, :, None] * np.eye(3)[:, None, :]
        if turned_rows:
            ends = [self._attitude_at(time_ns) for time_ns in (to_ns, *(exposures[row].time_ns for row in turned_rows))]
            known = [end for end in ends if end is not None]
            rotations[turned_rows], between = self._turns_between(known[0], known[1:])
            covariance_d[np.ix_(turned_rows, range(3), turned_rows, range(3))] += between
        return rotations, covariance_d

    def _turns_between(
        self, end: InterpolatedAttitude, starts: Sequence[InterpolatedAttitude]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the rotations from m INS attitudes to another INS attitude, and their error covariance without noise.

        Returns:
            Rotations, shape (m, 3, 3), and covariance of their rotation vectors, rad², shape (m, 3, m, 3).
        """
        to_end = np.array([end.rotation_nd.T @ start.rotation_nd for start in (end, *starts)])
        rates_d = np.array([found.rate_d for found in (end, *starts)])
        # The interpolation error is zero at a sample; between samples it has one or two estimates.
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

    def sensor_prior(self, time_ns: int, mounting: MountingConfig) -> StarPrior | None:
        """Return the attitude of a sensor (horizon from sensor) at a time, with the errors of INS and mounting."""
        deck = self.deck_prior(time_ns)
        if deck is None:
            return None
        rotation_ns = deck.rotation_nb @ mounting.rotation_ds
        mounting_n = rotation_ns * mounting.installation_sigma_s
        return StarPrior(rotation_ns, deck.covariance_n + mounting_n @ mounting_n.T)

    def at_middle(self, exposure: StarExposure, mounting: MountingConfig) -> tuple[StarExposure, float, float]:
        """Return an exposure reduced to its middle, from the rotation of the deck during the exposure.

        Constant INS errors do not affect the rotation. If the rotation is not known, the stars are not changed.

        Returns:
            The exposure, and two variances of a rotation of all directions, each axis, rad². The first is due to INS
            noise. The second is an upper bound for the interpolation error, or due to the unmeasured rotation.
        """
        length = exposure.length
        if length is None:
            return exposure, 0.0, 0.0
        stamp_ns = exposure.time_ns - self._offset_ns
        turning = None if self._is_contradictory(stamp_ns) else exposure_motion(self.track, stamp_ns, length.nodes)
        if turning is None:
            unmeasured_acceleration = np.deg2rad(self._config.untold_acceleration_deg_per_s2)
            return exposure, 0.0, length.unmeasured_turn_variance(float(unmeasured_acceleration))
        white_variance = turning.correction_gain * (self._config.white_sigma_arcsec * ARCSEC) ** 2
        corrected = reduce_to_mid_exposure(exposure, turning.in_device_frame(mounting.rotation_ds).turns)
        return corrected, white_variance, turning.correction_error

    def drop_before(self, time_ns: int) -> None:
        """Discard data that are not needed for times from ``time_ns`` on."""
        self.track.drop_before(time_ns - self._offset_ns)

    def _noise_of_turn(self, to_ns: int, exposure: StarExposure) -> list[tuple[int, float]]:
        """Return INS stamps (ns) and weights of the attitudes whose weighted sum is the rotation from an exposure."""
        middle_ns, length = exposure.time_ns - self._offset_ns, exposure.length
        if length is not None and exposure.smear_s is not None:
            return [*length.nodes.times_and_weights(middle_ns), (to_ns - self._offset_ns, -1.0)]
        if to_ns == exposure.time_ns:
            return []
        return [(middle_ns, 1.0), (to_ns - self._offset_ns, -1.0)]

    def _noise_variance(self, time_ns: int) -> float:
        """Return the largest noise variance of an INS attitude about an axis at a time, rad²."""
        stated = (self._config.white_sigma_arcsec * ARCSEC) ** 2
        extra, found = self.track.extra_noise(time_ns - self._offset_ns), self._attitude_at(time_ns)
        if extra is None or found is None:
            return stated
        return stated + extra.white_rad2 + extra.jitter_s2 * float(found.rate_d @ found.rate_d)

    def _ins_jumps_n(self, time_ns: int) -> FloatArray:
        """Return the sum of all INS jumps before a time, rotation vector, rad; the INS attitude may have this error."""
        before = [jump.jump_n for jump in self._jumps if jump.time_ns < time_ns - self._offset_ns]
        return np.sum(before, axis=0) if before else np.zeros(3)

    def _attitude_at(self, time_ns: int) -> InterpolatedAttitude | None:
        stamp_ns = time_ns - self._offset_ns
        return None if self._is_contradictory(stamp_ns) else self.track.at(stamp_ns)

    def _is_contradictory(self, stamp_ns: int) -> bool:
        """True if the INS is not used, because of two publishers or recent different samples with one stamp."""
        return INS in self._stamp_conflicts.active_at(stamp_ns)
