"""The ship's motion by its INS: the attitude of the deck and of its sensors, and turns from one moment to another.

The attitude helps to choose among stars. Turns move the stars of an exposure to its middle, and exposures of several
sensors to one moment.
"""

import numpy as np

from ship_attitude_star.guards.stream_guards import StreamGuards
from ship_attitude_star.stars.config import MountingConfig
from ship_attitude_star.stars.exposure import StarExposure, at_middle
from ship_attitude_star.stars.selection import StarPrior
from ship_estimation.ins import InsJump, StarInsConfig
from ship_estimation.refusals import Refusal, same_stamp
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack, InterpolatedAttitude
from ship_geometry.exposure_mean import turning_over
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.time_scales import SECOND_NS


class InsMotion:
    """Attitudes of the deck by their stamps, with the INS's errors as configured.

    Args:
        config: the INS.
        guards: watch its samples.

    Attributes:
        track: the samples by their stamps.
    """

    def __init__(self, config: StarInsConfig, guards: StreamGuards) -> None:
        self._config = config
        self._guards = guards
        self._max_gap_ns = round(config.max_gap_s * SECOND_NS)
        self._offset_ns = round(config.time_offset_s * SECOND_NS)
        self.track = AttitudeTrack(self._max_gap_ns)
        self._jumps: list[InsJump] = []

    def reconfigure(self, config: StarInsConfig) -> None:
        """Go on with other sigmas."""
        self._config = config
        self._guards.ins.reconfigure(config)

    def add(self, sample: AttitudeSample) -> Refusal | None:
        """Take a sample; the refusal where it is not used."""
        judged = self._guards.ins.judge(sample, self.track, self._guards.witnesses)
        if judged.rates_wrong_after_ns is not None:
            self.track.forget_rates(judged.rates_wrong_after_ns)
        if judged.refusal is not None:
            return judged.refusal
        if judged.jump is not None:
            self.track.cut(judged.jump.time_ns)
            self._jumps.append(judged.jump)
        sample = judged.sample
        known = self.track.get(sample.time_ns)
        taken, refusal = (True, None) if known is None else same_stamp(known, sample)
        if taken:
            self.track.insert(sample)
        return refusal

    def awaited(self, time_ns: int, reach_ns: int = 0) -> bool:
        """Whether samples still to come may tell the attitude from a moment until ``reach_ns`` later."""
        newest, stamp_ns = self.track.newest, time_ns - self._offset_ns
        if newest is None or stamp_ns - newest.time_ns >= self._max_gap_ns:
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

    def turn(self, to_ns: int, from_ns: int) -> tuple[FloatArray, FloatArray] | None:
        """The deck's turn between two moments.

        The slow error of the INS is the same at both and cancels. What is left is its noise, and its time offset where
        the rate changes.

        Returns:
            Rotation "deck at ``to_ns`` from deck at ``from_ns``", and the covariance of its rotation vector in the
            deck, rad²; None where the INS does not tell.
        """
        if to_ns == from_ns:
            return np.eye(3), np.zeros((3, 3))
        end, start = self._at(to_ns), self._at(from_ns)
        if end is None or start is None or np.any(self._jumped_n(to_ns) != self._jumped_n(from_ns)):
            return None
        rotation = end.rotation_nd.T @ start.rotation_nd
        shifted = self._config.time_offset_sigma_s * (rotation @ start.rate_d - end.rate_d)
        white_variance = (end.noise_gain + start.noise_gain) * (self._config.white_sigma_arcsec * ARCSEC) ** 2
        interpolated = end.error_covariance_d + rotation @ start.error_covariance_d @ rotation.T
        return rotation, white_variance * np.eye(3) + np.outer(shifted, shifted) + interpolated

    def sensor(self, time_ns: int, mounting: MountingConfig) -> StarPrior | None:
        """The attitude of a sensor (horizon from sensor) at a moment, with the errors of INS and mounting."""
        deck = self.deck(time_ns)
        if deck is None:
            return None
        rotation_ns = deck.rotation_nb @ mounting.rotation_ds
        mounting_n = rotation_ns * mounting.installation_sigma_s
        return StarPrior(rotation_ns, deck.covariance_n + mounting_n @ mounting_n.T)

    def at_middle(self, exposure: StarExposure, mounting: MountingConfig) -> tuple[StarExposure, float]:
        """The stars where they stood at the middle of the exposure, by the turning of the deck meanwhile.

        Constant errors of the INS have no part in the turning. Where the INS does not tell it, the stars stay where
        they were seen.

        Returns:
            The exposure, and the variance of the error that turns all its directions alike, each axis, rad²: of the
            INS's noise, or of the turn during the exposure, where no INS sample shows it.
        """
        length = exposure.length
        if length is None:
            return exposure, 0.0
        turning = turning_over(self.track, exposure.time_ns - self._offset_ns, length.nodes)
        if turning is None:
            untold = np.deg2rad(self._config.untold_acceleration_deg_per_s2)
            return exposure, length.untold_turn_variance(float(untold))
        white_variance = turning.correction_gain * (self._config.white_sigma_arcsec * ARCSEC) ** 2
        return at_middle(exposure, turning.mounted(mounting.rotation_ds)), white_variance + turning.correction_error

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed for moments at or after ``time_ns``."""
        self.track.drop_before(time_ns - self._offset_ns)

    def _jumped_n(self, time_ns: int) -> FloatArray:
        """Sum of all jumps of the INS until a moment, rotation vector, rad: its attitude may be wrong by as much."""
        before = [jump.jump_n for jump in self._jumps if jump.time_ns < time_ns - self._offset_ns]
        return np.sum(before, axis=0) if before else np.zeros(3)

    def _at(self, time_ns: int) -> InterpolatedAttitude | None:
        return self.track.at(time_ns - self._offset_ns)
