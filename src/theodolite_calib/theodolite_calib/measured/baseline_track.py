"""Baselines to one drone between their solutions, as far as they may be used."""

import numpy as np

from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import FloatArray
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.measured.samples import BaselineSample


class BaselineTrack(VectorTrack[BaselineSample]):
    """Solutions good and bad: nothing is drawn from or through a bad one."""

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

    def _joined(self, left: int) -> bool:
        both_good = self._samples[left].refusal is None and self._samples[left + 1].refusal is None
        return both_good and super()._joined(left)
