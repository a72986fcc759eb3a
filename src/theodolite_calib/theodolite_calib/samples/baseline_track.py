"""Track of the baselines to one drone: interpolation between valid baselines, and detection of jumps.

A receiver with wrong ambiguities still reports FIXED, with an error of decimetres. A change to or from such a solution
is a step in an otherwise smooth path. Over one or two seconds the path of a drone is a cubic polynomial. Cubics are
fitted to the last solutions by least squares, with a step at each solution in turn. The noise is the larger of the
solutions' scatter about the cubic and their stated noise. In gusts a step may therefore be missed, but gusts are not
reported as a step.
"""

import math
from dataclasses import dataclass

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.vector_track import VectorTrack
from ship_kernels import compiled_tracks
from theodolite_calib.samples.samples import BaselineSample

_MAX_SOLUTIONS, _MIN_BEFORE_STEP = 14, 5
"""Maximum number of solutions in the fit, and minimum number of solutions before a step."""
_MAX_SPAN_NS = 2 * SECOND_NS
"""Maximum time over which the path of a drone is a cubic, ns."""
_JUMP_SIGMAS = 7.0
"""Threshold of a jump in standard deviations. With ten solutions a second and ten candidate steps, less than one false
jump per voyage exceeds it."""
_CUBIC, _COMPONENTS = 3, 3
_MIN_DEGREES = 9
"""Minimum degrees of freedom of the scatter for the test of a jump."""


@dataclass(frozen=True)
class BaselineJump:
    """Jump of a baseline that the flight of the drone cannot explain.

    Attributes:
        time_ns: stamp of the first solution after the jump.
        jump_n: size of the jump (North, Up, East), m, shape (3,).
        sigma_m: standard deviation of each component.
    """

    time_ns: int
    jump_n: FloatArray
    sigma_m: float


class BaselineTrack(VectorTrack[BaselineSample]):
    """Baselines to one drone, valid and rejected; rejected baselines are not used, nor interpolated across."""

    history_ns = _MAX_SPAN_NS

    def baseline_at(self, time_ns: int) -> tuple[FloatArray, FloatArray] | Rejection:
        """Return the baseline at a time (N, U, E), m, and the covariance of its white error, m²; or a rejection."""
        interval = self._interval(time_ns)
        if interval is None:
            return Rejection(Reason.GAP, "no baselines on both sides of the exposure")
        left, fraction = interval
        around = self._samples[left : left + (1 if fraction == 0.0 else 2)]
        for sample in around:
            if sample.rejection is not None:
                return sample.rejection
        baseline = self.at(time_ns)
        assert baseline is not None  # in an interval of good samples
        nearest = around[0] if fraction < 0.5 else around[-1]
        return baseline.vector, baseline.noise_gain * nearest.covariance_n + baseline.error_covariance

    def velocity_at(self, time_ns: int) -> FloatArray:
        """Return the drone's velocity relative to the ship (N, U, E) where :meth:`baseline_at` is valid, m/s.

        The velocity is zero at the stamp of a baseline without a valid neighbour.
        """
        interval = self._interval(time_ns)
        assert interval is not None
        left, fraction = interval
        before, after = self._neighbours(left) if fraction == 0.0 else (left, left + 1)
        if before == after:
            return np.zeros(3)
        velocity: FloatArray = self._change(before, after) / self._seconds(before, after)
        return velocity

    def latest_jump(self, time_ns: int) -> BaselineJump | None:
        """Return the most significant jump among the last solutions; None without a jump.

        The newest of these solutions is the first solution at or after ``time_ns``. Later solutions are not used, so
        that the result does not depend on their arrival.
        """
        interval = self._interval(time_ns)
        if interval is None:
            return None
        last = interval[0] + (interval[1] > 0.0)
        first = last
        while first > 0 and last - first + 1 < _MAX_SOLUTIONS and self._are_joined(first - 1):
            if self._times[last] - self._times[first - 1] > _MAX_SPAN_NS:
                break
            first -= 1
        return self._jump_among(first, last + 1)

    def _jump_among(self, first: int, end: int) -> BaselineJump | None:
        count = end - first
        degrees = _COMPONENTS * (count - _CUBIC - 2)
        if degrees < _MIN_DEGREES:
            return None
        samples = self._samples[first:end]
        position_m = np.array([sample.vector for sample in samples]) - samples[-1].vector
        since = (np.array(self._times[first:end]) - self._times[end - 1]) / _MAX_SPAN_NS
        place, jump_m, weight, squares = compiled_tracks.clearest_step(since, position_m, _MIN_BEFORE_STEP)
        stated = sum(sample.variance_m2 for sample in samples) / (count * _COMPONENTS)
        sigma_m = math.sqrt(max(stated, squares / degrees, 0.0) / weight)
        if not math.hypot(*jump_m.tolist()) > _JUMP_SIGMAS * sigma_m:
            return None
        return BaselineJump(samples[place].time_ns, jump_m, sigma_m)

    def _are_joined(self, left: int) -> bool:
        both_good = self._samples[left].rejection is None and self._samples[left + 1].rejection is None
        return both_good and super()._are_joined(left)
