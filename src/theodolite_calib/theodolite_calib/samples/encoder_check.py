"""Check of the encoders: reject implausible readings, accept a persistent jump, and mark readings as unconfirmed.

Theodolites at rest and theodolites with stuck encoders repeat their readings. The encoders are stuck if, by the
beacons, the telescope has rotated in the deck. Readings that stop during a motion are unconfirmed. A reading is
rejected if it would need more acceleration than the mount has. A few such readings that are consistent with one another
are a slip of the encoders.

For smaller steps, each reading is predicted by a cubic through the readings before it, which a moving mount follows. A
prediction error far outside its estimated noise is a pending step, which the error of the next reading resolves. If
both errors are equal, the encoders have slipped, or the mount has moved and stopped between two readings. If the second
error is larger, a motion has begun or ended. If the second error is small, one reading was wrong. The step is a slip if
the mount could not have moved and stopped in time. Otherwise readings are unconfirmed until beacons confirm them.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ship_estimation.fault_detection.exclusion import UnconfirmedStep
from ship_estimation.plausibility.predictions import (
    JumpCheck,
    JumpDecision,
    PredictionBound,
    PredictionMatch,
    step_by_motion,
)
from ship_estimation.plausibility.stuck_check import ROUNDING_SPREAD, MotionReference, StuckCheck
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray, vector_length
from ship_geometry.tracks.sample_track import VectorTrack
from ship_kernels import compiled_tracks
from theodolite_calib.samples.samples import EncoderSample

_MOTION_SIGMAS = 5.0
"""Minimum change between two readings that counts as a motion, in standard deviations of a reading."""
_MAX_INTERVAL_NS = SECOND_NS
"""Maximum interval between readings that are compared, ns."""
_LARGEST_ELEVATION = 3.0 * np.pi
"""Largest elevation reading, rad, one and a half turns; azimuth readings are used modulo a turn."""
_UNIT_READINGS = 20
"""Number of consecutive readings beyond the largest elevation that show a wrong unit, or within it that end this."""

_FIT_READINGS = 12
"""Maximum number of readings in the fit of a cubic."""
_MIN_READINGS = 7
"""Minimum number of readings in the fit of a cubic."""
_DETECTION_SIGMAS = 6.5
"""Threshold of a pending step in standard deviations; at fifty readings a second at most one false step in some hours
exceeds it."""
_LOWER_BOUND_SIGMAS = 3.0
_NOISE_READINGS = 200
"""Number of readings over which the noise is averaged."""
_WARM_UP_READINGS = 50
"""Number of readings after which the noise is known; no step is detected before."""
_MAX_NOISE_RATIO = 3.0
"""Limit to which prediction errors are reduced in the noise estimate, in multiples of the noise."""
_MIN_PERSISTENCE, _MAX_PERSISTENCE = 0.5, 1.25
"""Least and greatest ratio of the second prediction error to the first for a step. If a motion has begun, the ratio is
at least 1.5."""
_FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class EncoderJump:
    """Permanent slip of the encoders.

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


class _Step(NamedTuple):
    """Step of the encoders, which a motion of the mount may also have caused.

    Attributes:
        jump: the step, as a slip of the encoders.
        lower_bound_rad: lower bound of the larger component, three standard deviations below the smaller of the two
            prediction errors, rad.
        interval_s: interval between the readings before and after the step.
    """

    jump: EncoderJump
    lower_bound_rad: float
    interval_s: float


class EncoderCheck:
    """Check of the encoder readings of one run, in the order of their stamps.

    Args:
        sigma_rad: noise of a reading, rad; at least an arcsecond is used.
        max_acceleration: maximum acceleration of the mount, rad/s².
    """

    def __init__(self, sigma_rad: float, max_acceleration: float) -> None:
        self._stuck_check, self._jump_check = StuckCheck(), JumpCheck()
        self._prediction_bound, self._step_detector = PredictionBound(sigma_rad), _StepDetector()
        # Two readings predict the next reading: the last two accepted readings, or the last two of all readings.
        # Without rejections both pairs are equal.
        self._last_accepted: tuple[EncoderSample, ...] = ()
        self._last_readings: tuple[EncoderSample, ...] = ()
        self._newest_ns: int | None = None
        self._last: tuple[EncoderSample, FloatArray] | None = None
        self._wrong_unit, self._opposite_count = False, 0
        self._unchanged_since_ns: int | None = None
        self._halted_since_ns: int | None = None
        self._unconfirmed_jump: UnconfirmedStep | None = None
        self._unconfirmed_step_ns, self._unconfirmed_step_rad = 0, 0.0
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
        if self._unconfirmed_step_rad:
            step_arcsec = self._unconfirmed_step_rad / ARCSEC
            return f"the encoders have stepped by {step_arcsec:.0f}″, not yet confirmed by a light"
        if self._step_detector.pending_step_rad:
            return "the encoder readings are not as predicted: the mount moved, or an encoder slipped"
        return ""

    @property
    def unconfirmed_sigma_rad(self) -> float:
        """Standard deviation about each axis of unconfirmed readings, in addition to their noise, rad."""
        return math.hypot(self._step_detector.pending_step_rad, self._unconfirmed_step_rad)

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
            self._motion_references["lights"] = MotionReference(time_ns, telescope_dt, sigma_rad)

    def confirm(self, time_ns: int) -> None:
        """Record that beacons were consistent with the readings at a time."""
        if self._halted_since_ns is not None and time_ns > self._halted_since_ns:
            self._halted_since_ns = None
        if self._unconfirmed_jump is not None:
            self._unconfirmed_jump = self._unconfirmed_jump.with_confirmation(time_ns)
        self.set_encoder_offset_from_beacons(time_ns)

    def set_encoder_offset_from_beacons(self, time_ns: int) -> None:
        """Record that beacons have determined the encoders' offset, which includes all earlier steps."""
        if time_ns > self._unconfirmed_step_ns:
            self._unconfirmed_step_rad = 0.0

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
        fits = match is None or (match.fits if step is None or step is match else match.is_consistent_with(step))
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

    def _check_step(self, step: _Step) -> CheckedReading:
        time_ns, step_rad = step.jump.time_ns, vector_length(step.jump.jump)
        # The mount goes from rest to rest, half of the way with maximum acceleration and half of it braking.
        reached_rad = 0.25 * self._max_acceleration * step.interval_s**2
        if not step.lower_bound_rad > reached_rad:
            self._unconfirmed_step_ns = time_ns
            self._unconfirmed_step_rad = math.hypot(self._unconfirmed_step_rad, step_rad)
            return CheckedReading()
        self._unconfirmed_jump = UnconfirmedStep(time_ns, "the encoders have jumped", "lights")
        text = f"step of {step_rad / ARCSEC:.0f}″: the mount can reach {reached_rad / ARCSEC:.0f}″"
        return CheckedReading(Rejection(Reason.GATE, text), step.jump)

    def _match(self, before: tuple[EncoderSample, ...], sample: EncoderSample) -> PredictionMatch | None:
        """Compare a reading with the prediction from two readings before it; None if these are missing or too old."""
        if len(before) < 2:
            return None
        first, second = before
        turned_ns, interval_ns = second.time_ns - first.time_ns, sample.time_ns - second.time_ns
        if max(turned_ns, interval_ns) > _MAX_INTERVAL_NS:
            return None
        turned_s, seconds = turned_ns * 1e-9, interval_ns * 1e-9
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
    second = track.last_before(time_ns - 1)
    first = None if second is None else track.last_before(second.time_ns - 1)
    return tuple(sample for sample in (first, second) if sample is not None)


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


class _PredictionError(NamedTuple):
    """Prediction error of a reading relative to the cubic.

    Attributes:
        time_ns: stamp of the reading.
        angles: the reading, without jumps of a full turn, rad, shape (2,).
        error: error of azimuth and elevation, rad, shape (2,).
        gain: sigma of each component per sigma of a reading.
        sigma_rad: standard deviation of each component due to noise, rad.
        bound_rad: bound of the error without a step, rad.
    """

    time_ns: int
    angles: FloatArray
    error: FloatArray
    gain: float
    sigma_rad: float
    bound_rad: float


class _StepDetector:
    """Step detector for the readings of one run, in the order of their stamps."""

    def __init__(self) -> None:
        self._previous: deque[tuple[int, FloatArray]] = deque(maxlen=_FIT_READINGS)
        self._pending_step: _PredictionError | None = None
        self._variance, self._count = 0.0, 0

    @property
    def pending_step_rad(self) -> float:
        """Prediction error of the last reading if it is a pending step, rad; else 0."""
        return 0.0 if self._pending_step is None else math.hypot(*self._pending_step.error)

    def restart(self) -> None:
        """Restart the prediction with the next reading; the noise estimate is kept."""
        self._previous.clear()
        self._pending_step = None

    def observe(self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float) -> _Step | None:
        """Add the next reading; return the pending step if this reading confirms it, else None.

        ``coarseness_rad`` is the resolution of the readings; 0 if no reading repeats the one before.
        """
        if self._previous:
            before_ns, before = self._previous[-1]
            if time_ns - before_ns > _MAX_INTERVAL_NS:
                self.restart()
            angles = before + wrap_angles(angles - before)
        prediction_error = self._prediction_error(time_ns, angles, sigma_rad, coarseness_rad)
        first, self._pending_step = self._pending_step, None
        if first is not None:
            assert prediction_error is not None  # predicted from the same readings as the first error
            return self._resolve_step(first, prediction_error)
        if prediction_error is not None:
            azimuth, elevation = map(abs, prediction_error.error.tolist())
            is_within_bound = azimuth <= prediction_error.bound_rad and elevation <= prediction_error.bound_rad
            if self._count >= _WARM_UP_READINGS and not is_within_bound:
                self._pending_step = prediction_error
                return None
            self._update_noise(prediction_error)
        self._previous.append((time_ns, angles))
        return None

    def _prediction_error(
        self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float
    ) -> _PredictionError | None:
        """Return the prediction error of a reading; None if there are too few readings before it."""
        if len(self._previous) < _MIN_READINGS:
            return None
        weights, gain = _weights_at_zero(tuple([before_ns - time_ns for before_ns, _ in self._previous]))
        predicted = weights @ np.array([before.tolist() for _, before in self._previous])
        noise_rad = max(sigma_rad, math.sqrt(self._variance))
        bound_rad = gain * (_DETECTION_SIGMAS * noise_rad + ROUNDING_SPREAD * math.sqrt(0.5) * coarseness_rad)
        return _PredictionError(time_ns, angles, angles - predicted, gain, gain * noise_rad, bound_rad)

    def _resolve_step(self, first: _PredictionError, second: _PredictionError) -> _Step | None:
        """Resolve a pending step at the first reading by the next reading."""
        axis = int(np.argmax(np.abs(first.error)))
        ratio, before_ns = second.error[axis] / first.error[axis], self._previous[-1][0]
        if ratio > _MIN_PERSISTENCE:
            # The readings before the change do not predict the readings after it.
            self._previous.clear()
            self._previous.append((first.time_ns, first.angles))
        self._previous.append((second.time_ns, second.angles))
        if not _MIN_PERSISTENCE < ratio < _MAX_PERSISTENCE:
            return None
        smaller_rad = min(abs(first.error[axis]), abs(second.error[axis]))
        lower_bound_rad = smaller_rad - _LOWER_BOUND_SIGMAS * first.sigma_rad
        jump = EncoderJump(first.time_ns - 1, first.error, first.sigma_rad)
        return _Step(jump, lower_bound_rad, interval_s=(first.time_ns - before_ns) / SECOND_NS)

    def _update_noise(self, found: _PredictionError) -> None:
        """Update the estimated noise of a reading, each axis, with a prediction error."""
        self._count = min(self._count + 1, _NOISE_READINGS)
        one = 0.5 * float(found.error @ found.error) / found.gain**2
        if self._count > _WARM_UP_READINGS:
            one = min(one, _MAX_NOISE_RATIO**2 * self._variance)
        self._variance += (one - self._variance) / self._count


@lru_cache(maxsize=64)
def _weights_at_zero(since_ns: tuple[int, ...]) -> tuple[FloatArray, float]:
    """Return the weights of earlier values in the least-squares prediction at zero, and the gain of its error.

    The gain is the standard deviation of value minus prediction per standard deviation of a value.
    """
    seconds = np.array(since_ns) / SECOND_NS
    weights = compiled_tracks.weights_at_zero(seconds / np.max(np.abs(seconds)))
    return weights, math.sqrt(1.0 + weights @ weights)


def wrap_angles(angles: FloatArray) -> FloatArray:
    """Return angles wrapped to at most half a turn, rad."""
    wrapped: FloatArray = angles - _FULL_TURN * np.rint(angles / _FULL_TURN)
    return wrapped
