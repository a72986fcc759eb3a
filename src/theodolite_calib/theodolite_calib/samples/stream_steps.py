"""Steps in the streams of encoders and ship's attitude: detected at each reading, or after a contradiction.

:class:`EncoderStepDetector` predicts each reading by a cubic through the readings before it, which a rotating or
roll-compensating mount follows. A prediction error far outside its estimated noise is a pending step, which the error
of the next reading resolves. If both errors are equal, the encoders have slipped, or the mount has moved and stopped
between two readings. If the second error is larger, a motion has begun or ended. If the second error is small, one
reading was wrong.

:func:`stream_consistency` evaluates both streams between the last accepted beacons and a contradiction. A slip of the
encoders, a step of the ship's attitude and a mounting shift of the telescope have the same effect on the beacons. The
slip and the step are visible in their own streams. A polynomial through the readings, or a line through the residuals
of attitudes against rates, is fitted to some samples before and after each time, with a step at that time. If neither
stream has stepped by the offset of the beacons, the telescope has shifted. A drift has no step. A drifting ship's
attitude departs from the integral of its rates. Encoders have no such reference.
"""

import itertools
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ship_estimation.plausibility.value_checks import ROUNDING_SPREAD
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray, log_rotation
from ship_geometry.tracks.sample_track import Stamped
from ship_kernels import compiled_tracks
from theodolite_calib.samples.samples import EncoderSample, ShipSample

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


class EncoderStep(NamedTuple):
    """Step of the encoders.

    Attributes:
        time_ns: time just before the first reading after the step.
        step: step of azimuth and elevation, rad, shape (2,).
        sigma_rad: standard deviation of each component.
        lower_bound_rad: lower bound of the larger component, three standard deviations below the smaller of the two
            prediction errors, rad.
        interval_s: interval between the readings before and after the step.
    """

    time_ns: int
    step: FloatArray
    sigma_rad: float
    lower_bound_rad: float
    interval_s: float


class _PredictionError(NamedTuple):
    """Prediction error of a reading relative to the cubic.

    Attributes:
        time_ns: stamp of the reading.
        error: error of azimuth and elevation, rad, shape (2,).
        gain: sigma of each component per sigma of a reading.
        sigma_rad: standard deviation of each component due to noise, rad.
        bound_rad: bound of the error without a step, rad.
    """

    time_ns: int
    error: FloatArray
    gain: float
    sigma_rad: float
    bound_rad: float

    @property
    def exceeds_bound(self) -> bool:
        """True if the error exceeds its bound, which makes it a pending step."""
        azimuth, elevation = self.error.tolist()
        return not (abs(azimuth) <= self.bound_rad and abs(elevation) <= self.bound_rad)


class EncoderStepDetector:
    """Step detector for the readings of one run, in the order of their stamps."""

    def __init__(self) -> None:
        self._previous: deque[tuple[int, FloatArray]] = deque(maxlen=_FIT_READINGS)
        self._pending_step: tuple[_PredictionError, FloatArray] | None = None
        self._variance, self._count = 0.0, 0

    @property
    def pending_step_rad(self) -> float:
        """Prediction error of the last reading if it is a pending step, rad; else 0."""
        return 0.0 if self._pending_step is None else math.hypot(*self._pending_step[0].error)

    def restart(self) -> None:
        """Restart the prediction with the next reading; the noise estimate is kept."""
        self._previous.clear()
        self._pending_step = None

    def observe(
        self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float, max_gap_ns: int = SECOND_NS
    ) -> EncoderStep | None:
        """Add the next reading; return the pending step if this reading confirms it, else None.

        Args:
            time_ns: stamp of the reading.
            angles: azimuth and elevation, rad, shape (2,).
            sigma_rad: stated noise of each angle.
            coarseness_rad: resolution of the readings; 0 if no reading repeats the one before.
            max_gap_ns: maximum interval between readings that are compared.
        """
        if self._previous:
            before_ns, before = self._previous[-1]
            if time_ns - before_ns > max_gap_ns:
                self.restart()
            angles = before + wrap_angles(angles - before)
        prediction_error = self._prediction_error(time_ns, angles, sigma_rad, coarseness_rad)
        first, self._pending_step = self._pending_step, None
        if first is not None:
            assert prediction_error is not None  # predicted from the same readings as the first error
            return self._resolve_step(*first, prediction_error, angles)
        if prediction_error is not None and self._count >= _WARM_UP_READINGS and prediction_error.exceeds_bound:
            self._pending_step = prediction_error, angles
            return None
        if prediction_error is not None:
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
        return _PredictionError(time_ns, angles - predicted, gain, gain * noise_rad, bound_rad)

    def _resolve_step(
        self, first: _PredictionError, angles: FloatArray, prediction_error: _PredictionError, now: FloatArray
    ) -> EncoderStep | None:
        """Resolve a pending step at the reading ``angles`` by the next reading, ``now``."""
        axis = int(np.argmax(np.abs(first.error)))
        ratio, before_ns = prediction_error.error[axis] / first.error[axis], self._previous[-1][0]
        if ratio > _MIN_PERSISTENCE:
            # The readings before the change do not predict the readings after it.
            self._previous.clear()
            self._previous.append((first.time_ns, angles))
        self._previous.append((prediction_error.time_ns, now))
        if not _MIN_PERSISTENCE < ratio < _MAX_PERSISTENCE:
            return None
        lower_bound_rad = (
            min(abs(first.error[axis]), abs(prediction_error.error[axis])) - _LOWER_BOUND_SIGMAS * first.sigma_rad
        )
        within_s = (first.time_ns - before_ns) / SECOND_NS
        return EncoderStep(first.time_ns - 1, first.error, first.sigma_rad, lower_bound_rad, within_s)

    def _update_noise(self, prediction_error: _PredictionError) -> None:
        """Update the estimated noise of a reading, each axis, with a prediction error."""
        self._count = min(self._count + 1, _NOISE_READINGS)
        one = 0.5 * float(prediction_error.error @ prediction_error.error) / prediction_error.gain**2
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


_MAX_SIDE_SAMPLES = 8
"""Maximum number of samples on either side of a step."""
_MIN_SIDE_SAMPLES = 6
"""Minimum number of samples on either side of a step."""
_MOTION_DEGREES: tuple[int, ...] = (2, 4)
"""Degrees of the polynomials through a motion; the polynomial with the smallest step sigma is used."""
_RATE_DEGREES: tuple[int, ...] = (1,)
"""Degrees of the polynomials through the residuals against rates."""
_STEP_SIGMAS = 5.5
"""Threshold of a step in standard deviations."""
_UNDERESTIMATE_SIGMAS = 3.0
"""Assumed maximum underestimate of a step, in standard deviations."""

_MEAN_WINDOW_S = 0.5
"""Duration of each mean in the evaluation of a drift of the ship's attitude, s."""
_MIN_DRIFT_S = 3.0
"""Minimum time span for evaluating a drift, s."""
_DRIFT_SIGMAS = 8.0
"""Difference between two means above which the attitude has drifted, in standard deviations of an attitude."""
_TRAPEZOID_ERROR_RATIO = 2.0 / 3.0
"""Twice the error of the trapezoidal rule, divided by the difference between the results with double and single steps.
Double steps have four times the error, so that the difference is three times the error."""
_NO_DRIFT_SIGMAS = 5.0
"""Difference between two means below which the attitude has not drifted, in standard deviations of an attitude."""
_STATED_CHANGE_SIGMAS = 5.0
"""Possible change of the attitude by a star correction, in multiples of the root of the change of stated variance."""


class LargestStep(NamedTuple):
    """Largest possible step of a stream.

    Attributes:
        size_rad: size of the step's largest component.
        sigma_rad: standard deviation of this component.
    """

    size_rad: float
    sigma_rad: float

    def is_detected(self, expected_rad: float) -> bool:
        """True if the step is significant, and larger than half of the expected step."""
        return self.size_rad > _STEP_SIGMAS * self.sigma_rad and self.size_rad > 0.5 * expected_rad

    def is_ruled_out(self, step_rad: float) -> bool:
        """True if a step of the size ``step_rad`` is ruled out; False for NaN."""
        would_be_seen = step_rad > 1.5 * _STEP_SIGMAS * self.sigma_rad
        return would_be_seen and self.size_rad < min(step_rad - _UNDERESTIMATE_SIGMAS * self.sigma_rad, 0.5 * step_rad)


@dataclass(frozen=True)
class StreamConsistency:
    """Consistency of the encoder and ship attitude streams in a time range.

    Attributes:
        encoder: largest step of the encoders; None if the readings do not allow a test.
        ship: largest step of the ship's attitude; None if the attitudes do not allow a test.
        is_ship_unreliable: True if the ship's attitude was DEGRADED or had a gap.
    """

    encoder: LargestStep | None
    ship: LargestStep | None
    is_ship_unreliable: bool


def stream_consistency(
    since_ns: int,
    encoder: list[EncoderSample],
    ship: list[ShipSample],
    gaps_ns: tuple[int, int],
    ship_sigma_rad: float,
) -> StreamConsistency:
    """Return the consistency of the streams after a time; the samples begin one second before that time.

    Args:
        since_ns: time since which steps are searched.
        encoder: readings, in the order of their stamps.
        ship: attitudes, in the order of their stamps, which are in the time scale of the readings.
        gaps_ns: maximum intervals of readings and of attitudes; larger intervals are gaps.
        ship_sigma_rad: noise of an attitude about each axis.
    """
    is_ship_unreliable = _has_gap(ship, gaps_ns[1]) or any(sample.status is Status.DEGRADED for sample in ship)
    by_encoder = None
    if encoder and not _has_gap(encoder, gaps_ns[0]):
        turns = wrap_angles(np.diff(np.array([sample.vector for sample in encoder]), axis=0))
        cumulative_angles = np.vstack([np.zeros(2), np.cumsum(turns, axis=0)])
        # There is no test if some readings repeat exactly and others do not, because the encoders may be stuck.
        is_unchanged = np.all(turns == 0.0, axis=1)
        if np.all(is_unchanged) or not np.any(is_unchanged):
            by_encoder = _find_largest_step(
                _seconds(encoder, since_ns), cumulative_angles, encoder[-1].sigma, _MOTION_DEGREES
            )
    by_ship = None
    if ship and not _has_gap(ship, gaps_ns[1]):
        by_ship = _ship_step(ship, since_ns, ship_sigma_rad)
    return StreamConsistency(by_encoder, by_ship, is_ship_unreliable)


def has_ship_drifted(ship: list[ShipSample], longest_gap_ns: int, sigma_rad: float) -> bool | None:
    """True if the ship's attitude has departed from the integral of its rates; None if unknown.

    Args:
        ship: attitudes, in the order of their stamps.
        longest_gap_ns: maximum interval of attitudes; a larger interval is a gap.
        sigma_rad: noise of an attitude about each axis.
    """
    usable = [sample for sample in ship if sample.status is not Status.DEGRADED]
    if len(usable) < 2 or _has_gap(usable, longest_gap_ns) or any(sample.rate_d is None for sample in usable):
        return None
    seconds = _seconds(usable, usable[0].time_ns)
    if seconds[-1] < _MIN_DRIFT_S:
        return None
    places = (seconds / _MEAN_WINDOW_S).astype(int)
    count = np.bincount(places)
    rotation_nd, rate_d = _attitudes(usable)
    left_n = _rate_residuals(rotation_nd, rate_d, seconds)
    means_n = np.stack([np.bincount(places, axis_n) for axis_n in left_n.T], axis=1) / count[:, None]
    spread_rad = float(np.max(np.ptp(means_n, axis=0)))
    stated_n = np.array([one.correlated_covariance_n for one in usable if one.correlated_covariance_n is not None])
    allowance_rad = (
        _STATED_CHANGE_SIGMAS * float(np.sqrt(np.ptp(stated_n.trace(axis1=1, axis2=2)))) if len(stated_n) else 0.0
    )
    coarse_n = _rate_residuals(rotation_nd[::2], rate_d[::2], seconds[::2])
    allowance_rad += _TRAPEZOID_ERROR_RATIO * float(np.max(np.ptp(left_n[::2] - coarse_n, axis=0)))
    if spread_rad > _DRIFT_SIGMAS * sigma_rad + allowance_rad:
        return True
    return False if spread_rad < _NO_DRIFT_SIGMAS * sigma_rad else None  # NaN is neither


def _attitudes(ship: list[ShipSample]) -> tuple[FloatArray, FloatArray]:
    """Return horizon from deck, shape (k, 3, 3), and rates in the deck, rad/s, (k, 3), of samples with rates."""
    return np.array([sample.rotation_nd for sample in ship]), np.array([sample.rate_d for sample in ship])


def _rate_residuals(rotation_nd: FloatArray, rate_d: FloatArray, seconds: FloatArray) -> FloatArray:
    """Return the residuals of attitudes against their integrated rates, rotation vectors in n, rad, shape (k, 3)."""
    rate_n = (rotation_nd @ rate_d[..., None])[..., 0]
    turns_n = log_rotation(rotation_nd[1:] @ rotation_nd[:-1].swapaxes(-1, -2))
    turns_n = turns_n - 0.5 * (rate_n[1:] + rate_n[:-1]) * np.diff(seconds)[:, None]
    return np.vstack([np.zeros(3), np.cumsum(turns_n, axis=0)])


def _ship_step(ship: list[ShipSample], since_ns: int, sigma_rad: float) -> LargestStep | None:
    """Return the largest step of the ship's attitude, using its rates if all samples have them."""
    seconds = _seconds(ship, since_ns)
    if all(sample.rate_d is not None for sample in ship):
        return _find_largest_step(seconds, _rate_residuals(*_attitudes(ship), seconds), sigma_rad, _RATE_DEGREES)
    rotation_nd = np.array([sample.rotation_nd for sample in ship])
    turns_n = log_rotation(rotation_nd[1:] @ rotation_nd[:-1].swapaxes(-1, -2))
    cumulative_rotation_n = np.vstack([np.zeros(3), np.cumsum(turns_n, axis=0)])
    return _find_largest_step(seconds, cumulative_rotation_n, sigma_rad, _MOTION_DEGREES)


def _find_largest_step(
    seconds: FloatArray, values: FloatArray, sigma_rad: float, degrees: Sequence[int]
) -> LargestStep | None:
    """Return the largest step between two consecutive values, in addition to a polynomial; None if values are too few.

    Args:
        seconds: times relative to the start of the search, shape (k,).
        values: values at these times, rad, shape (k, c).
        sigma_rad: noise of each value; a larger scatter of the residuals replaces it.
        degrees: degrees of the polynomials; the polynomial with the smallest step sigma is used.
    """
    largest: LargestStep | None = None
    for first_after in range(_MIN_SIDE_SAMPLES, len(seconds) - _MIN_SIDE_SAMPLES + 1):
        if seconds[first_after] <= 0.0:
            continue
        window = slice(max(first_after - _MAX_SIDE_SAMPLES, 0), first_after + _MAX_SIDE_SAMPLES)
        since_s = seconds[window] - seconds[first_after]
        steps = [_step(since_s, values[window], sigma_rad, degree) for degree in degrees]
        step = min(steps, key=lambda one: one.sigma_rad)
        if largest is None or step.size_rad > largest.size_rad:
            largest = step
    return largest


def _step(since_s: FloatArray, values: FloatArray, sigma_rad: float, degree: int) -> LargestStep:
    """Return the step of values at time zero, in addition to a polynomial."""
    design = np.column_stack([(since_s >= 0.0).astype(float), np.vander(since_s / np.ptp(since_s), degree + 1)])
    found = np.linalg.lstsq(design, values, rcond=None)[0]
    left = values - design @ found
    noise_rad = max(sigma_rad, float(np.sqrt(np.max(np.sum(left**2, axis=0)) / (len(since_s) - design.shape[1]))))
    gain = float(np.sqrt(np.linalg.inv(design.T @ design)[0, 0]))
    return LargestStep(float(np.max(np.abs(found[0]))), gain * noise_rad)


def _seconds(samples: Sequence[Stamped], since_ns: int) -> FloatArray:
    """Return the stamps relative to a time, s."""
    return np.array([sample.time_ns - since_ns for sample in samples]) / SECOND_NS


def _has_gap(samples: Sequence[Stamped], longest_ns: int) -> bool:
    """True if two consecutive samples are too far apart."""
    return any(later.time_ns - one.time_ns > longest_ns for one, later in itertools.pairwise(samples))
