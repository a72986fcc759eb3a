"""Track of one source: its samples in the order of their stamps, whatever the order of arrival, with interpolation.

Vectors, such as baselines and encoder angles, are interpolated by a cubic (:class:`VectorTrack`), whose slopes are
differences of neighbouring samples. Attitudes have :mod:`ship_geometry.tracks.attitude_track`.
"""

import bisect
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.interpolation_error import ANY_DIRECTION, MOST_SAMPLES, NEXT_TERM_SHARE
from ship_kernels import compiled_tracks

RECENT_COUNT = 8
"""Minimum number of samples kept to propagate the newest one; all samples of the last second are kept too."""


class Stamped(Protocol):
    """Object with a stamp."""

    @property
    def time_ns(self) -> int:
        """Stamp of the source, ns."""
        ...


Sample = TypeVar("Sample", bound=Stamped)


def hermite_weights(fraction: float) -> tuple[float, float, float, float]:
    """Return the weights of value and slope at 0, and of value and slope at 1, in a cubic on [0, 1] at a fraction.

    Example:
        >>> print(hermite_weights(0.5))
        (0.5, 0.125, 0.5, -0.125)
    """
    s = fraction
    return (1 - s) ** 2 * (1 + 2 * s), s * (1 - s) ** 2, s * s * (3 - 2 * s), s * s * (s - 1)


class OrderedSamples(Generic[Sample]):
    """Samples of one source in the order of their stamps, with gaps and jumps between them.

    Args:
        max_gap_ns: maximum interval between two samples without a gap.
    """

    history_ns = 0
    """Additional time before the time of :meth:`drop_before` for which samples are kept, ns."""

    def __init__(self, max_gap_ns: int) -> None:
        self.max_gap_ns = max_gap_ns
        self._times: list[int] = []
        self._samples: list[Sample] = []
        self._cuts_ns: list[int] = []

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def newest(self) -> Sample | None:
        """The sample with the latest stamp; None for an empty track."""
        return self._samples[-1] if self._samples else None

    @property
    def is_newest_joined(self) -> bool:
        """True if the newest sample has a predecessor without a gap or a jump between them."""
        return len(self._samples) > 1 and self._are_joined(len(self._samples) - 2)

    @property
    def times_ns(self) -> tuple[int, ...]:
        """Stamps of all samples in the track in ascending order."""
        return tuple(self._times)

    def get(self, time_ns: int) -> Sample | None:
        """Return the sample with exactly this stamp, or None."""
        index = bisect.bisect_left(self._times, time_ns)
        found = index < len(self._times) and self._times[index] == time_ns
        return self._samples[index] if found else None

    def last_before(self, time_ns: int) -> Sample | None:
        """Return the last sample with a stamp at or before ``time_ns``, or None."""
        index = bisect.bisect_right(self._times, time_ns) - 1
        return self._samples[index] if index >= 0 else None

    def samples_between(self, first_ns: int, last_ns: int) -> list[Sample]:
        """Return the samples from one stamp to another, both included, in order."""
        return self._samples[bisect.bisect_left(self._times, first_ns) : bisect.bisect_right(self._times, last_ns)]

    def last_cut_ns(self, until_ns: int) -> int | None:
        """Return the last cut (:meth:`add_cut`) at or before ``until_ns``, or None."""
        return max((cut_ns for cut_ns in self._cuts_ns if cut_ns <= until_ns), default=None)

    def insert(self, sample: Sample) -> int | None:
        """Insert a sample in time order, or replace the sample with the same stamp.

        Returns:
            The stamp after which interpolated values may have changed. None if the sample is later than all
            others: such a sample changes no value for which :meth:`SampleTrack.is_final_at` was true.
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
        """Append samples that are all later than the newest sample and in the order of their stamps."""
        self._times.extend(sample.time_ns for sample in samples)
        self._samples.extend(samples)

    def add_cut(self, time_ns: int) -> int | None:
        """Add a cut: a time at which the quantity has jumped, and across which it is not interpolated.

        Returns:
            The stamp after which interpolated values have changed; None if no sample is later than the cut.
        """
        self._cuts_ns.append(time_ns)
        later = bisect.bisect_right(self._times, time_ns)
        return None if later == len(self._times) else self._changed_after_ns(later)

    def _changed_after_ns(self, index: int) -> int:
        """Return the stamp after which values may have changed if sample ``index`` is new or the first after a cut."""
        # A differenced rate uses one sample before or after the interval. Near the start of the track the rate of the
        # first sample changes too, or the times before the sample had no value.
        return self._times[index - 2] if index >= 2 else self._times[0] - 1

    def drop_before(self, time_ns: int) -> None:
        """Drop samples that are not needed to interpolate from ``time_ns`` on, or to propagate the newest sample."""
        # Three samples before the time are kept: the start of the time's interval, and two for the interpolation error.
        keep_from = bisect.bisect_right(self._times, time_ns - self.history_ns) - 3
        if keep_from <= 0:
            return
        keep_from = min(keep_from, self._recent_from())
        if keep_from > 0:
            del self._times[:keep_from]
            del self._samples[:keep_from]
            self._cuts_ns = [cut_ns for cut_ns in self._cuts_ns if cut_ns > self._times[0]]

    def _recent_from(self) -> int:
        """Return the index of the oldest sample for the propagation of the newest one."""
        if not self._times:
            return 0
        return max(
            min(bisect.bisect_left(self._times, self._times[-1] - SECOND_NS), len(self._times) - RECENT_COUNT), 0
        )

    def _seconds(self, first: int, second: int) -> float:
        """Return the time between two samples, s."""
        return (self._times[second] - self._times[first]) / SECOND_NS

    def _are_joined(self, left: int) -> bool:
        start_ns, end_ns = self._times[left], self._times[left + 1]
        return end_ns - start_ns <= self.max_gap_ns and not self._is_cut_between(start_ns, end_ns)

    def _joined_from(self, index: int, count: int) -> int:
        """Return the index of the first of at most ``count`` samples up to ``index`` without a gap or a jump."""
        first = index
        while first > max(index + 1 - count, 0) and self._are_joined(first - 1):
            first -= 1
        return first

    def _is_cut_between(self, start_ns: int, end_ns: int) -> bool:
        """True if the quantity has jumped between two times."""
        return bool(self._cuts_ns) and any(start_ns <= cut_ns < end_ns for cut_ns in self._cuts_ns)


class SampleTrack(OrderedSamples[Sample]):
    """Samples of one source, for cubic interpolation by a derived class.

    The slopes of the cubic are measured rates, or differences of the neighbouring samples. Derived classes are
    :class:`VectorTrack` and :class:`ship_geometry.tracks.attitude_track.AttitudeTrack`.

    Args:
        max_gap_ns: maximum interval between two samples for interpolation.

    Example:
        Samples arrive in any order:

        >>> track = VectorTrack(max_gap_ns=2 * SECOND_NS)
        >>> for second in (0, 2, 1, 3):
        ...     _ = track.insert(VectorSample(second * SECOND_NS, np.array([second**2 * 1.0])))
        >>> print(track.newest.time_ns // SECOND_NS, track.at(3 * SECOND_NS // 2).vector)
        3 [2.25]
    """

    @property
    def final_until_ns(self) -> int | None:
        """Latest time at which the value is final if later samples arrive in order; None without such a time."""
        if self._times and self._has_rate(len(self._times) - 1):
            return self._times[-1]
        # A differenced rate at the newest sample needs a later neighbour.
        return self._times[-2] if len(self._times) > 1 else None

    def is_final_at(self, time_ns: int) -> bool:
        """True if the value at a time is final, provided that later samples arrive in order."""
        until_ns = self.final_until_ns
        return until_ns is not None and time_ns <= until_ns

    def _has_rate(self, index: int) -> bool:
        """True if sample ``index`` has a measured rate; a derived class with measured rates overrides this method."""
        return False

    def _indices_around(self, left: int) -> list[int]:
        """Return the indices of the samples for the error of a cubic without measured rates.

        The two ends of the interval that begins at sample ``left`` are first. The samples are those that cannot change
        after the interval is final (:meth:`is_final_at`).
        """
        around = [left, left + 1]
        earlier = left > 0 and self._are_joined(left - 1)
        if earlier:
            around.append(left - 1)
        if not self._has_rate(left + 1) and left + 2 < len(self._samples) and self._are_joined(left + 1):
            around.append(left + 2)
        if earlier and left > 1 and self._are_joined(left - 2):
            around.append(left - 2)
        return around

    def _fractions(self, indices: list[int], left: int) -> FloatArray:
        """Return the times of samples after sample ``left``, in units of the interval that begins at this sample."""
        start_ns = self._times[left]
        since_ns = np.array([self._times[index] - start_ns for index in indices], dtype=float)
        return since_ns / (self._times[left + 1] - start_ns)

    def _interval(self, time_ns: int) -> tuple[int, float] | None:
        """Return the index of the sample at or before a time, and the fraction of the interval passed since the sample.

        The fraction is 0 at the stamp of a sample. The result is None outside the track, in a gap or across a cut.
        """
        if not self._times or not self._times[0] <= time_ns <= self._times[-1]:
            return None
        right = bisect.bisect_left(self._times, time_ns)
        if self._times[right] == time_ns:
            return right, 0.0
        left = right - 1
        start_ns, end_ns = self._times[left], self._times[right]
        if end_ns - start_ns > self.max_gap_ns or self._is_cut_between(start_ns, end_ns):
            return None
        return left, (time_ns - start_ns) / (end_ns - start_ns)

    def _neighbours(self, index: int) -> tuple[int, int]:
        """Return the indices of the two samples whose difference gives the rate at sample ``index``.

        ``index`` replaces a neighbour that is missing or beyond a gap or cut.
        """
        before = index - 1 if index > 0 and self._are_joined(index - 1) else index
        after = index + 1 if index + 1 < len(self._samples) and self._are_joined(index) else index
        return before, after

    def noise_gain_of_mean(self, times_and_weights: Iterable[tuple[int, float]]) -> float:
        """Return the variance of a weighted sum of interpolated values, divided by the variance of the samples' noise.

        Args:
            times_and_weights: time (ns) and weight of each value; each time is within the track and not in a gap.
        """
        return sum(weight * weight for weight in self._weights_of_sum(times_and_weights).values())

    def noise_covariance_of_sums(self, sums: Sequence[Iterable[tuple[int, float]]]) -> FloatArray:
        """Return the covariance of m weighted sums of interpolated values, divided by the samples' noise variance.

        Two values between the same samples have most of their noise in common; their difference has little noise.

        Args:
            sums: for each sum, time (ns) and weight of its values; each time is within the track and not in a gap.

        Returns:
            Covariance of the sums, shape (m, m).

        Example:
            Covariance of two values a tenth of an interval apart, and variance of their difference:

            >>> from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
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

    def _weights_of_sum(self, times_and_weights: Iterable[tuple[int, float]]) -> dict[int, float]:
        """Return the weight of each sample in a weighted sum of interpolated values."""
        weights: dict[int, float] = {}
        for time_ns, share in times_and_weights:
            interval = self._interval(time_ns)
            assert interval is not None
            left, fraction = interval
            for index, weight in self._weights(left, fraction).items():
                weights[index] = weights.get(index, 0.0) + share * weight
        return weights

    def _noise_gain(self, left: int, fraction: float) -> float:
        """Return the sum of the squared weights of the samples in an interpolated value."""
        return sum(weight * weight for weight in self._weights(left, fraction).values())

    def _weights(self, left: int, fraction: float) -> dict[int, float]:
        """Return the weight of each sample in an interpolated value; measured rates are assumed noise-free."""
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


@dataclass(frozen=True)
class VectorSample:
    """One vector of a track.

    Attributes:
        time_ns: time in the source's own stamps.
        vector: components of the vector, shape (k,).
    """

    time_ns: int
    vector: FloatArray

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated sample and to sort conflicting samples."""
        return self.vector.tobytes()


@dataclass(frozen=True)
class InterpolatedVector:
    """The vector at a time of the track.

    Attributes:
        vector: interpolated vector, shape (k,). A periodic component is not reduced to one period.
        noise_gain: variance of the vector, divided by the variance of the samples' independent noise.
        error_covariance: covariance of the interpolation error, estimated from neighbouring samples, shape (k, k).
    """

    vector: FloatArray
    noise_gain: float
    error_covariance: FloatArray


AnyVectorSample = TypeVar("AnyVectorSample", bound=VectorSample)


class VectorTrack(SampleTrack[AnyVectorSample]):
    """Vectors of one source.

    Args:
        max_gap_ns: maximum interval between two samples for interpolation.
        period: period of all components: 2 pi for angles, infinite for lengths.

    Example:
        An azimuth that passes north, between 359° and 1°:

        >>> track = VectorTrack(max_gap_ns=10**9, period=2.0 * np.pi)
        >>> _ = track.insert(VectorSample(0, np.deg2rad([359.0])))
        >>> _ = track.insert(VectorSample(10**9, np.deg2rad([361.0 - 360.0])))
        >>> print(np.rad2deg(track.at(5 * 10**8).vector).round(6))
        [360.]
    """

    def __init__(self, max_gap_ns: int, period: float = np.inf) -> None:
        super().__init__(max_gap_ns)
        self._period = period

    def at(self, time_ns: int) -> InterpolatedVector | None:
        """Return the vector at a time; None outside the track, in a gap or across a cut."""
        interval = self._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        if fraction == 0.0:
            vector = self._samples[left].vector
            return InterpolatedVector(vector, 1.0, np.zeros((vector.size, vector.size)))
        first = self._joined_from(left, 3)
        last = left + 2 if left + 2 < len(self._samples) and self._are_joined(left + 1) else left + 1
        around = slice(first, last + 1)
        found = compiled_tracks.interpolate_vector(
            np.array(self._times[around]),
            np.array([sample.vector for sample in self._samples[around]]),
            left - first,
            time_ns,
            self._period,
            *hermite_weights(fraction),
            NEXT_TERM_SHARE if last + 1 - first == MOST_SAMPLES else 1.0,
            ANY_DIRECTION,
        )
        return InterpolatedVector(*found)

    def _change(self, first: int, second: int) -> FloatArray:
        """Return the change from one sample to another; whole periods are removed from each step between neighbours."""
        if second < first:
            return -self._change(second, first)
        change = np.zeros_like(self._samples[first].vector)
        for index in range(first, second):
            step = self._samples[index + 1].vector - self._samples[index].vector
            change += step if self._period == np.inf else step - self._period * np.round(step / self._period)
        return change
