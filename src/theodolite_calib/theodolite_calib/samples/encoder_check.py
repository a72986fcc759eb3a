"""Check of the encoders: reject implausible readings, accept a persistent jump, and mark readings as unconfirmed.

A theodolite at rest repeats its readings for hours, and so does a theodolite with stuck encoders. Beacons show the
difference: the encoders are stuck if the telescope has rotated in the deck. Readings that stop during a motion are
unconfirmed. A reading is rejected if it would need more acceleration than the mount has. A few such readings that are
consistent with one another are a slip of the encoders. After a smaller step
(:mod:`theodolite_calib.samples.stream_steps`) readings are unconfirmed until beacons confirm them. The step is a slip
if the mount could not have moved and stopped between two readings.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ship_estimation.fault_detection.detector import UnconfirmedStep
from ship_estimation.plausibility.motion_check import MotionReference
from ship_estimation.plausibility.value_checks import (
    JumpCheck,
    JumpDecision,
    PredictionBound,
    PredictionMatch,
    StuckCheck,
    step_by_motion,
    vector_length,
)
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.sample_track import VectorTrack
from theodolite_calib.samples.samples import EncoderSample
from theodolite_calib.samples.stream_steps import EncoderStep, EncoderStepDetector, wrap_angles

_BEACONS = "lights"
"""Name of the beacons as a motion reference."""
_MOTION_SIGMAS = 5.0
"""Minimum change between two readings that counts as a motion, in standard deviations of a reading."""
_MAX_INTERVAL_S = 1.0
"""Maximum interval between readings that are compared, s."""
_LARGEST_ELEVATION = 3.0 * np.pi
"""Largest elevation reading, rad, one and a half turns; azimuth readings are used modulo a turn."""
_UNIT_READINGS = 20
"""Number of consecutive readings beyond the largest elevation after which the unit counts as wrong; the same number
within the limit ends this state."""


@dataclass(frozen=True)
class EncoderJump:
    """Permanent slip of the encoders, after which the reading for each direction of the axis differs.

    Attributes:
        time_ns: time just before the first reading after the slip.
        jump: change of azimuth and elevation, rad, shape (2,).
        sigma_rad: standard deviation of each change.
    """

    time_ns: int
    jump: FloatArray
    sigma_rad: float


class CheckedReading(NamedTuple):
    """Result of the check of a reading.

    Attributes:
        rejection: rejection of the reading; None if it is accepted.
        jump: slip that is accepted with this reading, even if the reading is rejected; None without a slip.
    """

    rejection: Rejection | None = None
    jump: EncoderJump | None = None


class EncoderCheck:
    """Check of the encoder readings of one run, in the order of their stamps.

    Args:
        sigma_rad: noise of a reading, rad; at least an arcsecond is used.
        max_acceleration: maximum acceleration of the mount, rad/s².
    """

    def __init__(self, sigma_rad: float, max_acceleration: float) -> None:
        self._stuck_check, self._jump_check, self._prediction_bound = (
            StuckCheck(),
            JumpCheck(),
            PredictionBound(sigma_rad),
        )
        # Two readings predict the next reading: the last two accepted readings, or the last two of all readings.
        # Without rejections both pairs are equal.
        self._last_accepted: tuple[EncoderSample, ...] = ()
        self._last_readings: tuple[EncoderSample, ...] = ()
        self._last: tuple[EncoderSample, FloatArray] | None = None
        self._newest_ns: int | None = None
        self._wrong_unit, self._opposite_count = False, 0
        self._unchanged_since_ns: int | None = None
        self._halted_since_ns: int | None = None
        self._unconfirmed_jump: UnconfirmedStep | None = None
        self._step_detector = EncoderStepDetector()
        self._unconfirmed_step: tuple[int, float] | None = None
        self._motion_references: dict[str, MotionReference] = {}
        self.reconfigure(sigma_rad, max_acceleration)

    def reconfigure(self, sigma_rad: float, max_acceleration: float) -> None:
        """Apply a changed noise and maximum acceleration."""
        self._prediction_bound.sigma_rad = self._sigma_rad = max(sigma_rad, ARCSEC)
        self._max_acceleration = max_acceleration

    @property
    def unconfirmed_reason(self) -> str:
        """Reason why the readings are unconfirmed until the next beacons; empty if confirmed."""
        if self._unconfirmed_jump is not None:
            return self._unconfirmed_jump.text
        if self._halted_since_ns is not None:
            return "the encoders stopped during a motion: at rest, or stuck"
        if self._unconfirmed_step is not None:
            return (
                f"the encoders have stepped by {self._unconfirmed_step[1] / ARCSEC:.0f}″, not yet confirmed by a light"
            )
        if self._step_detector.pending_step_rad:
            return "the encoder readings are not as predicted: the mount moved, or an encoder slipped"
        return ""

    @property
    def unconfirmed_sigma_rad(self) -> float:
        """Standard deviation about each axis of unconfirmed readings, in addition to their noise, rad."""
        return math.hypot(
            self._step_detector.pending_step_rad, 0.0 if self._unconfirmed_step is None else self._unconfirmed_step[1]
        )

    def check(
        self, sample: EncoderSample, track: VectorTrack[EncoderSample], late: Rejection | None = None
    ) -> CheckedReading:
        """Check a reading.

        Args:
            sample: the reading.
            track: readings accepted before, for the check of a reading that comes out of order.
            late: rejection if the reading comes too late, else None; the unit is checked in both cases.
        """
        rejection = self._units_rejection(sample, counts=late is None) or late
        if rejection is not None:
            return CheckedReading(rejection)
        if self._newest_ns is not None and sample.time_ns <= self._newest_ns:
            match = self._match(_readings_before(track, sample.time_ns), sample)
            return CheckedReading(None if match is None or match.fits else _gate_rejection(match))
        self._newest_ns = sample.time_ns
        result = self._check_jump(sample)
        if result.rejection is not None:
            return result
        if result.jump is not None:
            self._unconfirmed_jump = UnconfirmedStep(result.jump.time_ns, "the encoders have jumped", "lights")
            self._step_detector.restart()
        step = self._step_detector.observe(
            sample.time_ns, sample.vector, self._sigma_rad, self._stuck_check.coarseness_rad
        )
        if step is not None:
            result = self._check_step(step)
        self._check_motion(sample)
        if self._stuck_check.observe(sample.time_ns, sample.vector, self._sigma_rad, self._motion_references):
            # Stuck readings do not predict the next reading.
            self._last_accepted = self._last_readings = ()
            self._step_detector.restart()
            self._unconfirmed_jump = UnconfirmedStep(sample.time_ns, "the encoders were stuck", "lights")
            text = "both encoders stuck: unchanged while, by the lights, the telescope rotates in the deck"
            return CheckedReading(Rejection(Reason.STUCK, text))
        return result

    def record_beacon_attitude(self, time_ns: int, telescope_dt: FloatArray, sigma_rad: float) -> None:
        """Record the telescope's attitude in the deck from beacons, shape (3, 3), with sigma about its worst axis."""
        # Rotations before the readings stopped do not count.
        if self._unchanged_since_ns is not None and time_ns >= self._unchanged_since_ns:
            self._motion_references[_BEACONS] = MotionReference(time_ns, telescope_dt, sigma_rad)

    def confirm(self, time_ns: int) -> None:
        """Record that beacons were consistent with the readings at a time."""
        if self._halted_since_ns is not None and time_ns > self._halted_since_ns:
            self._halted_since_ns = None
        if self._unconfirmed_jump is not None:
            self._unconfirmed_jump = self._unconfirmed_jump.with_confirmation(time_ns)
        self.set_encoder_offset_from_beacons(time_ns)

    def set_encoder_offset_from_beacons(self, time_ns: int) -> None:
        """Record that beacons have determined the encoders' offset, which includes all earlier steps."""
        if self._unconfirmed_step is not None and time_ns > self._unconfirmed_step[0]:
            self._unconfirmed_step = None

    def _units_rejection(self, sample: EncoderSample, counts: bool) -> Rejection | None:
        """Return the rejection of a reading that cannot be in radians; None otherwise.

        A run of such readings shows that the unit is wrong. All readings are then rejected until a run of valid
        readings.
        """
        azimuth, elevation = sample.vector.tolist()
        beyond = not abs(elevation) <= _LARGEST_ELEVATION
        if counts:
            self._opposite_count = self._opposite_count + 1 if beyond is not self._wrong_unit else 0
            if self._opposite_count >= _UNIT_READINGS:
                self._wrong_unit, self._opposite_count = beyond, 0
        if not (beyond or self._wrong_unit):
            return None
        text = f"azimuth {azimuth:.6g}, elevation {elevation:.6g}: expected radians, at most 1.5 turns; degrees?"
        return Rejection(Reason.UNITS, text)

    def _check_jump(self, sample: EncoderSample) -> CheckedReading:
        """Check the latest reading against the prediction from the two readings before it."""
        match = self._match(self._last_accepted, sample)
        step = match if self._last_readings is self._last_accepted else self._match(self._last_readings, sample)
        fits = match is None or (match.fits if step is None else match.is_consistent_with(step))
        is_after_rejection = self._jump_check.rejected_count > 0
        result = self._jump_check.check(sample.time_ns, fits, step is None or step.fits)
        if result is JumpDecision.REJECTED:
            assert match is not None
            is_first_rejection = self._jump_check.rejected_count == 1
            self._last_readings = (
                _extrapolate_back(sample, *self._last_accepted) if is_first_rejection else self._last_readings[-1],
                sample,
            )
            return CheckedReading(_gate_rejection(match))
        has_no_rejection = self._last_readings is self._last_accepted
        self._last_readings = (*self._last_readings[-1:], sample)
        if result is JumpDecision.JUMPED:
            assert match is not None
            self._last_accepted = self._last_readings
            return CheckedReading(jump=EncoderJump(self._jump_check.since_ns - 1, match.difference, match.sigma_rad))
        self._last_accepted = self._last_readings if has_no_rejection else (*self._last_accepted[-1:], sample)
        if match is not None and not is_after_rejection:
            self._prediction_bound.learn(match.difference)
        return CheckedReading()

    def _check_step(self, step: EncoderStep) -> CheckedReading:
        """Check the reading that proves a step."""
        step_rad = vector_length(step.step)
        # The mount goes from rest to rest, half of the way with maximum acceleration and half of it braking.
        reached_rad = 0.25 * self._max_acceleration * step.interval_s**2
        if not step.lower_bound_rad > reached_rad:
            before_rad = 0.0 if self._unconfirmed_step is None else self._unconfirmed_step[1]
            self._unconfirmed_step = step.time_ns, math.hypot(before_rad, step_rad)
            return CheckedReading()
        self._unconfirmed_jump = UnconfirmedStep(step.time_ns, "the encoders have jumped", "lights")
        text = f"step of {step_rad / ARCSEC:.0f}″: the mount can reach {reached_rad / ARCSEC:.0f}″"
        return CheckedReading(Rejection(Reason.GATE, text), EncoderJump(step.time_ns, step.step, step.sigma_rad))

    def _match(self, before: tuple[EncoderSample, ...], sample: EncoderSample) -> PredictionMatch | None:
        """Compare a reading with the prediction from two readings before it; None if these are missing or too old."""
        if len(before) < 2:
            return None
        first, second = before
        turned_s, seconds = (second.time_ns - first.time_ns) * 1e-9, (sample.time_ns - second.time_ns) * 1e-9
        if max(turned_s, seconds) > _MAX_INTERVAL_S:
            return None
        extrapolation = seconds / turned_s * wrap_angles(second.vector - first.vector)
        difference = wrap_angles(sample.vector - second.vector - extrapolation)
        step = step_by_motion(turned_s, seconds, self._max_acceleration, self._stuck_check.coarseness_rad)
        return self._prediction_bound.match(difference, step)

    def _check_motion(self, sample: EncoderSample) -> None:
        """Mark readings as unconfirmed after two equal readings in a motion."""
        if self._last is None:
            self._last, self._unchanged_since_ns = (sample, np.zeros(2)), sample.time_ns
            return
        last, rate = self._last
        step = wrap_angles(sample.vector - last.vector)
        interval_s = (sample.time_ns - last.time_ns) * 1e-9
        if step.any():
            self._motion_references, self._unchanged_since_ns, self._halted_since_ns = {}, sample.time_ns, None
        elif np.abs(rate).max() * interval_s > _MOTION_SIGMAS * self._sigma_rad and self._halted_since_ns is None:
            self._halted_since_ns = sample.time_ns
        self._last = sample, step / interval_s


def _readings_before(track: VectorTrack[EncoderSample], time_ns: int) -> tuple[EncoderSample, ...]:
    """Return the last two readings before a time, or fewer."""
    found: tuple[EncoderSample, ...] = ()
    while len(found) < 2:
        sample = track.last_before(time_ns - 1)
        if sample is None:
            break
        found = (sample, *found)
        time_ns = sample.time_ns
    return found


def _extrapolate_back(sample: EncoderSample, first: EncoderSample, second: EncoderSample) -> EncoderSample:
    """Return the reading extrapolated back from ``sample`` to the time of ``second``.

    The rate is taken from ``first`` to ``second``. After a slip the extrapolated reading predicts the next reading.
    """
    ratio = (sample.time_ns - second.time_ns) / (second.time_ns - first.time_ns)
    return replace(second, vector=sample.vector - ratio * wrap_angles(second.vector - first.vector))


def _gate_rejection(match: PredictionMatch) -> Rejection:
    offset, bound = vector_length(match.difference) / ARCSEC, match.bound_rad / ARCSEC
    text = f"{offset:.0f}″ from the predicted reading: the mount can reach {bound:.0f}″"
    return Rejection(Reason.GATE, text)
