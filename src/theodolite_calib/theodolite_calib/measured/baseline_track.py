"""The baselines to one drone: interpolated between good ones, and watched for a jump that no flight explains.

A receiver that has fixed the wrong ambiguities says FIXED and is off by decimetres. The change from the right to the
wrong solution is a step in a path that is smooth otherwise: over a second or two a drone flies a cubic. The step is
found by least squares: a cubic through the last solutions, with and without a step at each place in turn. The
solutions' own scatter about it is their noise where it is larger than what they state, so that a flight in gusts hides
a step rather than being taken for one.
"""

import math
from dataclasses import dataclass

import numpy as np

from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.measured import compiled_cubics
from theodolite_calib.measured.samples import BaselineSample

_MOST, _BEFORE = 14, 5
"""Solutions that are looked at, and how many of them stand before a step at least."""
_LONGEST_NS = 2 * SECOND_NS
"""A drone flies a cubic for no longer."""
_SIGMAS = 7.0
"""At ten solutions a second with ten places for a step, good ones must not seem to jump once in a voyage."""
_CUBIC, _COMPONENTS = 3, 3
_LEAST_DEGREES = 9
"""Degrees of freedom of the scatter below which nothing is said."""


@dataclass(frozen=True)
class BaselineJump:
    """A baseline that has jumped although the drone cannot have.

    Attributes:
        time_ns: stamp of the first solution after the jump.
        jump_n: (North, Up, East), m, shape (3,).
        sigma_m: standard deviation of each component.
    """

    time_ns: int
    jump_n: FloatArray
    sigma_m: float


class BaselineTrack(VectorTrack[BaselineSample]):
    """Baselines to one drone, good and bad: nothing is interpolated from a bad one or across it."""

    keeps_ns = _LONGEST_NS

    def usable_at(self, time_ns: int) -> tuple[FloatArray, FloatArray] | Refusal:
        """The baseline at a moment (N, U, E), m, with the covariance of what is new in it, m²; or why there is none."""
        interval = self._interval(time_ns)
        if interval is None:
            return Refusal(Reason.GAP, "no baselines on both sides of the exposure")
        left, fraction = interval
        around = self._samples[left : left + (1 if fraction == 0.0 else 2)]
        for sample in around:
            if sample.refusal is not None:
                return sample.refusal
        baseline = self.at(time_ns)
        assert baseline is not None  # in an interval of good samples
        nearest = around[0] if fraction < 0.5 else around[-1]
        return baseline.vector, baseline.noise_gain * nearest.covariance_n + baseline.error_covariance

    def velocity_at(self, time_ns: int) -> FloatArray:
        """Of the drone against the ship (N, U, E) at a moment that a baseline is usable at, m/s; zero beside gaps."""
        interval = self._interval(time_ns)
        assert interval is not None
        left, fraction = interval
        before, after = self._neighbours(left) if fraction == 0.0 else (left, left + 1)
        if before == after:
            return np.zeros(3)
        velocity: FloatArray = self._change(before, after) / self._seconds(before, after)
        return velocity

    def jump_before(self, time_ns: int) -> BaselineJump | None:
        """The clearest jump among the last solutions up to the one that follows a moment; None where there is none.

        Solutions of later stamps have no part in it, so that it does not matter when they come.
        """
        interval = self._interval(time_ns)
        if interval is None:
            return None
        last = interval[0] + (interval[1] > 0.0)
        first = last
        while first > 0 and last - first + 1 < _MOST and self._joined(first - 1):
            if self._times[last] - self._times[first - 1] > _LONGEST_NS:
                break
            first -= 1
        return self._jump_among(first, last + 1)

    def _jump_among(self, first: int, end: int) -> BaselineJump | None:
        count = end - first
        degrees = _COMPONENTS * (count - _CUBIC - 2)
        if degrees < _LEAST_DEGREES:
            return None
        samples = self._samples[first:end]
        position_m = np.array([sample.vector for sample in samples]) - samples[-1].vector
        since = (np.array(self._times[first:end]) - self._times[end - 1]) / _LONGEST_NS
        place, jump_m, weight, squares = compiled_cubics.clearest_step(since, position_m, _BEFORE)
        stated = sum(sample.variance_m2 for sample in samples) / (count * _COMPONENTS)
        sigma_m = math.sqrt(max(stated, squares / degrees, 0.0) / weight)
        if not math.hypot(*jump_m.tolist()) > _SIGMAS * sigma_m:
            return None
        return BaselineJump(samples[place].time_ns, jump_m, sigma_m)

    def _joined(self, left: int) -> bool:
        both_good = self._samples[left].refusal is None and self._samples[left + 1].refusal is None
        return both_good and super()._joined(left)
