"""Consistency of the streams of encoders and ship's attitude after a contradiction with beacons, and drift of the ship.

:func:`stream_consistency` evaluates both streams between the last accepted beacons and the contradiction. A slip of the
encoders, a step of the ship's attitude and a mounting shift of the telescope have the same effect on the beacons. The
slip and the step are visible in their own streams. A polynomial through the readings, or a line through the residuals
of attitudes against rates, is fitted to some samples before and after each time, with a step at that time. If neither
stream has stepped by the offset of the beacons, the telescope has shifted. A drift has no step. A drifting ship's
attitude departs from the integral of its rates. Encoders have no such reference.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray, log_rotation
from ship_geometry.tracks.sample_track import Stamped
from theodolite_calib.samples.encoder_check import wrap_angles
from theodolite_calib.samples.samples import EncoderSample, ShipSample

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
    return np.array([sample.time_ns - since_ns for sample in samples]) / SECOND_NS


def _has_gap(samples: Sequence[Stamped], longest_ns: int) -> bool:
    return any(later.time_ns - one.time_ns > longest_ns for one, later in itertools.pairwise(samples))
