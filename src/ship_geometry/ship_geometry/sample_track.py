"""Samples of one source in the order of their stamps, whatever the order of their arrival, to be interpolated."""

import bisect
from collections.abc import Iterable, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

RECENT = 8
"""How many samples are kept to tell the motion of the newest one, beside all of the last second."""


class Stamped(Protocol):
    """Anything with a stamp."""

    @property
    def time_ns(self) -> int:
        """Time in the source's own stamps."""
        ...


Sample = TypeVar("Sample", bound=Stamped)


def hermite_weights(fraction: float) -> tuple[float, float, float, float]:
    """Weights, in the value of a cubic at a fraction of [0, 1], of its value at 0, slope at 0, value at 1, slope at 1.

    Example:
        >>> print(hermite_weights(0.5))
        (0.5, 0.125, 0.5, -0.125)
    """
    s = fraction
    return (1 - s) ** 2 * (1 + 2 * s), s * (1 - s) ** 2, s * s * (3 - 2 * s), s * s * (s - 1)


class SampleTrack(Generic[Sample]):
    """Samples between which a cubic is drawn; its slopes are measured rates, or differences of the neighbours.

    Args:
        max_gap_ns: neighbours further apart than this are not joined.

    Example:
        :class:`ship_geometry.attitude_track.AttitudeTrack` and :class:`ship_geometry.vector_track.VectorTrack` are used
        like this:

        >>> from ship_geometry.vector_track import VectorSample, VectorTrack
        >>> track = VectorTrack(max_gap_ns=2 * SECOND_NS)
        >>> for second in (0, 2, 1, 3):  # in any order
        ...     _ = track.insert(VectorSample(second * SECOND_NS, np.array([second**2 * 1.0])))
        >>> print(track.newest.time_ns // SECOND_NS, track.at(3 * SECOND_NS // 2).vector)
        3 [2.25]
    """

    keeps_ns = 0
    """Samples up to so long before a moment are kept for it, beside those that interpolation needs."""

    def __init__(self, max_gap_ns: int) -> None:
        self.max_gap_ns = max_gap_ns
        self._times: list[int] = []
        self._samples: list[Sample] = []
        self._cuts_ns: list[int] = []

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def newest(self) -> Sample | None:
        """The sample with the latest stamp."""
        return self._samples[-1] if self._samples else None

    @property
    def times_ns(self) -> tuple[int, ...]:
        """The stamps of all samples that are kept, increasing."""
        return tuple(self._times)

    def get(self, time_ns: int) -> Sample | None:
        """The sample stamped exactly ``time_ns``."""
        index = bisect.bisect_left(self._times, time_ns)
        found = index < len(self._times) and self._times[index] == time_ns
        return self._samples[index] if found else None

    def last_before(self, time_ns: int) -> Sample | None:
        """The last sample stamped at or before ``time_ns``."""
        index = bisect.bisect_right(self._times, time_ns) - 1
        return self._samples[index] if index >= 0 else None

    def between(self, first_ns: int, last_ns: int) -> list[Sample]:
        """The samples stamped at or between two moments, in the order of their stamps, as far as they are kept."""
        return self._samples[bisect.bisect_left(self._times, first_ns) : bisect.bisect_right(self._times, last_ns)]

    def last_cut_ns(self, until_ns: int) -> int | None:
        """The last moment up to ``until_ns`` across which is not interpolated; None for none that is kept."""
        return max((cut_ns for cut_ns in self._cuts_ns if cut_ns <= until_ns), default=None)

    def insert(self, sample: Sample) -> int | None:
        """Put a sample in its place; one with the same stamp is replaced.

        Returns:
            The stamp after which interpolated values may have changed; None where the sample is the newest one. Then
            no value has changed for which :meth:`covers` was true.
        """
        if not self._times or sample.time_ns > self._times[-1]:
            self._times.append(sample.time_ns)
            self._samples.append(sample)
            return None
        index = bisect.bisect_left(self._times, sample.time_ns)
        if self._times[index] == sample.time_ns:
            self._samples[index] = sample
        else:
            self._times.insert(index, sample.time_ns)
            self._samples.insert(index, sample)
        return self._changed_after_ns(index)

    def extend(self, samples: Sequence[Sample]) -> None:
        """Put samples behind the newest one, all of them later than it and in the order of their stamps."""
        self._times.extend(sample.time_ns for sample in samples)
        self._samples.extend(samples)

    def cut(self, time_ns: int) -> int | None:
        """Do not interpolate across a moment, because the quantity has jumped there.

        Returns:
            The stamp after which interpolated values have changed; None where no sample is later than the moment.
        """
        self._cuts_ns.append(time_ns)
        later = bisect.bisect_right(self._times, time_ns)
        return None if later == len(self._times) else self._changed_after_ns(later)

    def _changed_after_ns(self, index: int) -> int:
        """The stamp after which interpolated values may have changed where sample ``index`` is new, or begins anew."""
        # A differenced rate uses one sample beyond the interval itself. Near the start of the track the first sample's
        # own rate changes, or there was no value at all before.
        return self._times[index - 2] if index >= 2 else self._times[0] - 1

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed to interpolate at or after ``time_ns``, or to move the newest sample."""
        # Three samples before the moment stay: the start of its interval, and two that tell the interpolation's error.
        keep_from = bisect.bisect_right(self._times, time_ns - self.keeps_ns) - 3
        if keep_from <= 0:
            return
        keep_from = min(keep_from, self._recent_from())
        if keep_from > 0:
            del self._times[:keep_from]
            del self._samples[:keep_from]
            self._cuts_ns = [cut_ns for cut_ns in self._cuts_ns if cut_ns > self._times[0]]

    @property
    def covered_until_ns(self) -> int | None:
        """The latest moment at which later samples can no longer change the value, arriving in order; None for none."""
        if self._times and self._has_rate(len(self._times) - 1):
            return self._times[-1]
        # A differenced rate at the newest sample needs a later neighbour.
        return self._times[-2] if len(self._times) > 1 else None

    def covers(self, time_ns: int) -> bool:
        """Whether no sample that is still to come, in order, can change the value at a moment."""
        until_ns = self.covered_until_ns
        return until_ns is not None and time_ns <= until_ns

    def _has_rate(self, index: int) -> bool:
        """Whether the source measures a rate with sample ``index``."""
        return False

    def _recent_from(self) -> int:
        """Index of the oldest sample that may have a part in moving the newest one."""
        if not self._times:
            return 0
        return max(min(bisect.bisect_left(self._times, self._times[-1] - SECOND_NS), len(self._times) - RECENT), 0)

    def _around(self, left: int) -> list[int]:
        """Indices of the samples that tell the error of a cubic without measured rates.

        The two ends of the interval that begins at sample ``left`` come first. A sample that could still change once
        the interval is covered (:meth:`covers`) is not among them.
        """
        around = [left, left + 1]
        earlier = left > 0 and self._joined(left - 1)
        if earlier:
            around.append(left - 1)
        if not self._has_rate(left + 1) and left + 2 < len(self._samples) and self._joined(left + 1):
            around.append(left + 2)
        if earlier and left > 1 and self._joined(left - 2):
            around.append(left - 2)
        return around

    def _fractions(self, indices: list[int], left: int) -> FloatArray:
        """Where samples are, in units of the interval that begins at sample ``left``, from its start."""
        start_ns = self._times[left]
        since_ns = np.array([self._times[index] - start_ns for index in indices], dtype=float)
        return since_ns / (self._times[left + 1] - start_ns)

    def _interval(self, time_ns: int) -> tuple[int, float] | None:
        """Index of the sample before a moment, and the fraction of the way to the next; None outside or in a gap.

        At the stamp of a sample the index is its own and the fraction is 0.
        """
        if not self._times or not self._times[0] <= time_ns <= self._times[-1]:
            return None
        right = bisect.bisect_left(self._times, time_ns)
        if self._times[right] == time_ns:
            return right, 0.0
        left = right - 1
        start_ns, end_ns = self._times[left], self._times[right]
        if end_ns - start_ns > self.max_gap_ns or self._cut_between(start_ns, end_ns):
            return None
        return left, (time_ns - start_ns) / (end_ns - start_ns)

    def _seconds(self, first: int, second: int) -> float:
        """Time between two samples, s."""
        return (self._times[second] - self._times[first]) / SECOND_NS

    def _neighbours(self, index: int) -> tuple[int, int]:
        """Indices of the samples whose difference gives the rate at sample ``index``; itself where one is missing."""
        before = index - 1 if index > 0 and self._joined(index - 1) else index
        after = index + 1 if index + 1 < len(self._samples) and self._joined(index) else index
        return before, after

    def _joined(self, left: int) -> bool:
        start_ns, end_ns = self._times[left], self._times[left + 1]
        return end_ns - start_ns <= self.max_gap_ns and not self._cut_between(start_ns, end_ns)

    def _cut_between(self, start_ns: int, end_ns: int) -> bool:
        """Whether the quantity has jumped between two moments."""
        return bool(self._cuts_ns) and any(start_ns <= cut_ns < end_ns for cut_ns in self._cuts_ns)

    def noise_gain_of_mean(self, moments: Iterable[tuple[int, float]]) -> float:
        """Variance of a weighted sum of interpolated values per variance of the samples' independent noise.

        Args:
            moments: (ns, weight) of each value; none outside the track or in a gap.
        """
        return sum(weight * weight for weight in self._weights_of_sum(moments).values())

    def noise_covariance_of_sums(self, sums: Sequence[Iterable[tuple[int, float]]]) -> FloatArray:
        """Covariance of weighted sums of interpolated values per variance of the samples' independent noise.

        Two values between the same samples have most of their noise in common, and their difference has little.

        Args:
            sums: for each of m sums (ns, weight) of its values; none outside the track or in a gap.

        Returns:
            Shape (m, m).

        Example:
            Two values a tenth of an interval apart, and their difference:

            >>> from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
            >>> track = AttitudeTrack(max_gap_ns=SECOND_NS)
            >>> for second in range(4):
            ...     _ = track.insert(AttitudeSample(second * SECOND_NS, np.eye(3), np.zeros(3)))
            >>> one, other = [(1_450_000_000, 1.0)], [(1_550_000_000, 1.0)]
            >>> covariance = track.noise_covariance_of_sums([one, other])
            >>> print(covariance.round(3).tolist(), round(float(np.array([1, -1]) @ covariance @ [1, -1]), 3))
            [[0.511, 0.489], [0.489, 0.511]] 0.045
        """
        weights = [self._weights_of_sum(moments) for moments in sums]
        columns = {index: column for column, index in enumerate(sorted(set().union(*weights)))}
        by_sample = np.zeros((len(weights), len(columns)))
        for row, of_sum in enumerate(weights):
            for index, weight in of_sum.items():
                by_sample[row, columns[index]] = weight
        covariance: FloatArray = by_sample @ by_sample.T
        return covariance

    def _weights_of_sum(self, moments: Iterable[tuple[int, float]]) -> dict[int, float]:
        """Weight of each sample in a weighted sum of interpolated values."""
        weights: dict[int, float] = {}
        for time_ns, share in moments:
            interval = self._interval(time_ns)
            assert interval is not None
            left, fraction = interval
            for index, weight in self._weights(left, fraction).items():
                weights[index] = weights.get(index, 0.0) + share * weight
        return weights

    def _noise_gain(self, left: int, fraction: float) -> float:
        """Sum of the squared weights of the samples' values."""
        return sum(weight * weight for weight in self._weights(left, fraction).values())

    def _weights(self, left: int, fraction: float) -> dict[int, float]:
        """Weight of each sample in an interpolated value; measured rates are taken as free of noise."""
        if fraction == 0.0:
            return {left: 1.0}
        value0, slope0, value1, slope1 = hermite_weights(fraction)
        weights = {left: value0, left + 1: value1}
        interval_ns = self._times[left + 1] - self._times[left]
        for index, slope in ((left, slope0), (left + 1, slope1)):
            if not self._has_rate(index):
                before, after = self._neighbours(index)
                share = slope * interval_ns / (self._times[after] - self._times[before])
                weights[before] = weights.get(before, 0.0) - share
                weights[after] = weights.get(after, 0.0) + share
        return weights
