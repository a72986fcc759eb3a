"""Statistics of the innovations of one source: size, mean and correlation.

An innovation is the residual of a measurement against its prediction. A measurement has parts: stars, beacons, or the
attitude as a whole. An :class:`InnovationTable` holds many innovations. :class:`PartStatistics` compares the sizes of
the parts with the prediction; :class:`AxisStatistics` tests for a mean of zero and for independence in time. Medians
limit the effect of a few outliers.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import normal_value_above, probability_above, value_above
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_innovations

LEAST_COUNT = 30
"""Minimum number of measurements for a diagnosis."""

FALSE_DIAGNOSIS_PROBABILITY = 1e-7
"""Probability of a false alarm of one test, for a source whose errors agree with its stated sigma."""

TOLERATED_FACTOR = 1.25
"""Ratio of true to stated sigma, or its inverse, up to which the sigma is not reported."""

TOLERATED_BIAS = 0.25
"""Median of the innovations, in their sigmas, up to which no bias is reported."""

TOLERATED_CORRELATION = 0.2
"""Correlation of successive innovations up to which no correlation is reported."""

_OUTLIER_PROBABILITY = 1e-3
"""Probability below which a part is an outlier; the selection of stars rejects parts at a similar limit."""

_LEAST_OWN_SHARE = 0.5
"""Minimum share of the measurement noise in the innovations used to assess the source's sigma."""

_MANY_OUTLIERS_SHARE = 0.25
_STEADY = 0.25
_MISFIT = (Reason.MISIDENTIFIED, Reason.LIGHT_CONFLICT)
_MOST_CORRELATED = 0.95
_CLIPPED_AT = 3.0
_SIGMAS = normal_value_above(0.5 * FALSE_DIAGNOSIS_PROBABILITY)
_MEDIAN_SIGMA = math.sqrt(0.5 * math.pi)
"""Sigma of the median of n normal values of sigma 1, times √n."""
_SIGMA_OF_SPREAD = 1.4826
"""Ratio of the sigma of normal values to their median absolute deviation."""

_SINGLE_NUMBERS = 5
"""Number of columns of an :class:`InnovationTable` before the columns of the axes."""

_NO_AXIS = (math.nan, math.nan)


class Innovation(NamedTuple):
    """Innovation of one measurement.

    Attributes:
        time_ns: stamp of the measurement.
        squares: normalised square of each part, shape (p,); infinite for a rejected part.
        degrees: number of components of a part; 0 if no part was compared.
        nis: normalised innovation squared; 0 if nothing was compared.
        components: number of components of the innovation.
        own_share: share of the measurement noise in the innovation covariance.
        is_used: True if the filter uses the source; False if the source is excluded and only monitored.
        axes: mean innovation of all parts along each axis, in sigmas and in rad.
    """

    time_ns: int
    squares: FloatArray
    degrees: int
    nis: float
    components: int
    own_share: float
    is_used: bool
    axes: Mapping[str, tuple[float, float]]


def innovation_of(decision: MeasurementDecision[Any]) -> Innovation | None:
    """Return the innovation of a measurement decision; None without a valid comparison with a prediction.

    A measurement without a residual has an innovation only if the reason of the decision is in ``_MISFIT``.

    Example:
        An innovation of 6″ with a predicted sigma of 3″:

        >>> from ship_geometry.tracks.sample_track import VectorSample
        >>> residual, covariance = np.array([6.0]) * ARCSEC, np.array([[9.0]]) * ARCSEC**2
        >>> decision = MeasurementDecision(VectorSample(1, residual), Reason.NONE, True, ("up",), residual,
        ...                     covariance=covariance, noise=covariance)
        >>> found = innovation_of(decision)
        >>> print(found.squares.round(6), round(found.own_share, 6), round(found.axes["up"][0], 6))
        [4.] 1.0 2.0
    """
    time_ns = decision.measurement.time_ns
    left_out = sum(rejection.reason in _MISFIT for _, rejection in decision.rejected_parts)
    if not len(decision.residual):
        if decision.reason not in _MISFIT:
            return None
        return Innovation(time_ns, np.full(max(left_out, 1), np.inf), 0, 0.0, 0, 1.0, True, {})
    if len(decision.covariance) != len(decision.residual):
        return None  # unknown covariance
    groups = _groups(decision.components)
    found = compiled_innovations.innovation_statistics(
        decision.residual, decision.covariance, decision.noise, *groups[:3], len(groups.axes)
    )
    if found is None:
        return None  # NaN, or a covariance that is not positive definite
    squares, own_share, along = found
    return Innovation(
        time_ns=time_ns,
        squares=np.append(squares, [np.inf] * left_out) if left_out else squares,
        degrees=groups.degrees,
        nis=decision.nis,
        components=len(decision.residual),
        own_share=own_share,
        is_used=decision.reason is not Reason.EXCLUDED,
        axes=dict(zip(groups.axes, along.tolist(), strict=True)),
    )


class _Groups(NamedTuple):
    """Part and axis of each of m components.

    Attributes:
        part_of: index of the part of each component, shape (m,).
        axis_of: index of the axis of each component, shape (m,).
        parts: number of parts.
        axes: names of the axes.
        degrees: number of components of the first part.
    """

    part_of: NDArray[np.intp]
    axis_of: NDArray[np.intp]
    parts: int
    axes: tuple[str, ...]
    degrees: int


@lru_cache(maxsize=256)
def _groups(components: tuple[str, ...]) -> _Groups:
    """Return parts and axes of component names: ``"HIP 92420 up"`` is the axis ``up`` of the part ``HIP 92420``."""
    names = [name.rpartition(" ") for name in components]
    parts = list(dict.fromkeys(part for part, _, _ in names))
    axes = tuple(dict.fromkeys(axis for _, _, axis in names))
    part_of = np.array([parts.index(part) for part, _, _ in names], dtype=np.intp)
    axis_of = np.array([axes.index(axis) for _, _, axis in names], dtype=np.intp)
    return _Groups(part_of, axis_of, len(parts), axes, int(np.count_nonzero(part_of == 0)))


class InnovationTable:
    """Innovations of one source in order of time, one for each stamp.

    Attributes:
        axes: names of all axes.
        times_ns: stamps, shape (n,).
        numbers: one row per innovation, shape (n, c). The columns are ``degrees``, ``nis``, ``components``,
            ``own_share`` and ``is_used`` of :class:`Innovation`, then for each axis the innovation in sigmas and in
            rad, then the squares of the parts. Missing values are NaN.

    Example:
        >>> table = InnovationTable()
        >>> one = Innovation(7, np.array([4.0]), degrees=1, nis=4.0, components=1, own_share=1.0,
        ...                  is_used=True, axes={"up": (2.0, 6.0 * ARCSEC)})
        >>> table.add_all([one, one])
        >>> print(len(table), table.squares, table.on_axis("up")[:, 0])
        1 [[4.]] [2.]
    """

    def __init__(self) -> None:
        self.axes: tuple[str, ...] = ()
        self.times_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self.numbers: FloatArray = np.empty((0, _SINGLE_NUMBERS))

    def __len__(self) -> int:
        return len(self.times_ns)

    @property
    def squares(self) -> FloatArray:
        """Normalised squares of the parts of each innovation, padded with NaN, shape (n, p)."""
        squares: FloatArray = self.numbers[:, self.first_square :]
        return squares

    @property
    def first_square(self) -> int:
        """Column of the first square."""
        return _SINGLE_NUMBERS + 2 * len(self.axes)

    def on_axis(self, axis: str) -> FloatArray:
        """Return the k innovations that have an axis, along this axis, in sigmas and in rad, shape (k, 2)."""
        start = _SINGLE_NUMBERS + 2 * self.axes.index(axis)
        values: FloatArray = self.numbers[:, start : start + 2]
        return values[~np.isnan(values[:, 0])]

    def add_all(self, innovations: Collection[Innovation]) -> None:
        """Add innovations; the last of several innovations with the same stamp is kept."""
        self._widen(innovations)
        added_ns = [one.time_ns for one in innovations]
        times_ns = np.concatenate([self.times_ns, np.array(added_ns, dtype=np.int64)])
        numbers = np.concatenate([self.numbers, self._rows(innovations)])
        if not all(before < after for before, after in pairwise([*self.times_ns[-1:].tolist(), *added_ns])):
            order = np.argsort(times_ns, kind="stable")
            order = order[np.append(np.diff(times_ns[order]) > 0, True)]
            times_ns, numbers = times_ns[order], numbers[order]
        self.times_ns, self.numbers = times_ns, numbers

    def drop_old(self, until_ns: int, most: int) -> None:
        """Drop the innovations up to a stamp, and all but the newest ``most`` of the later innovations."""
        first = max(int(self.times_ns.searchsorted(until_ns, side="right")), len(self) - most)
        if first > 0:
            self.times_ns, self.numbers = self.times_ns[first:], self.numbers[first:]

    def _widen(self, innovations: Collection[Innovation]) -> None:
        """Add columns for new axes and for additional parts."""
        axes = tuple(dict.fromkeys(chain(self.axes, *(one.axes for one in innovations))))
        known = self.squares
        parts = max(known.shape[1], *(len(one.squares) for one in innovations))
        if axes != self.axes or parts > known.shape[1]:
            old, first_square, self.axes = self.numbers, self.first_square, axes
            self.numbers = np.full((len(old), self.first_square + parts), np.nan)
            self.numbers[:, :first_square] = old[:, :first_square]
            self.squares[:, : known.shape[1]] = known

    def _rows(self, innovations: Collection[Innovation]) -> FloatArray:
        """Return innovations as rows of the table, shape (n, c)."""
        width, rows = self.numbers.shape[1], []
        for one in innovations:
            row = [one.degrees, one.nis, one.components, one.own_share, one.is_used]
            row += [*chain(*(one.axes.get(name, _NO_AXIS) for name in self.axes)), *one.squares.tolist()]
            rows.append(row + [math.nan] * (width - len(row)))
        return np.array(rows, dtype=np.float64)


class PartStatistics:
    """Statistics of the sizes of the parts of many measurements.

    Outliers may be misidentifications or the tail of a larger noise. The sizes of the other parts distinguish the two.

    Attributes:
        factor: ratio of true to stated sigma of the source; NaN with too few parts.
        outlier_share: share of the parts that are outliers or were rejected; NaN with too few parts.
        components: number of components of all innovations.
        nis: mean normalised square of a component; NaN without components.
    """

    def __init__(self, table: InnovationTable) -> None:
        # The squares are sorted, so that a quantile is found by its index.
        self._squares, degrees, self._own_share, nis, self.components = compiled_innovations.part_sizes(
            table.numbers, table.first_square, _LEAST_OWN_SHARE
        )
        self.nis = nis / self.components if self.components else math.nan
        self._degrees, self._count = degrees or 1, len(self._squares)
        self._inlier_count = int(
            self._squares.searchsorted(value_above(_OUTLIER_PROBABILITY, self._degrees), side="right")
        )
        self.outlier_share = 1.0 - self._inlier_count / self._count if self._count >= LEAST_COUNT else math.nan
        by_all, by_near = self._factor(self._count), self._factor(self._inlier_count)
        self._bulk_factor = by_all if math.isnan(by_near) else by_near
        self.factor = by_all if self._bulk_factor > TOLERATED_FACTOR else self._bulk_factor

    @property
    def is_optimistic(self) -> bool:
        """True if the stated sigma is too small: the parts that are not outliers are larger than predicted."""
        return self._bulk_factor > TOLERATED_FACTOR and (self._excess(self._count) > _SIGMAS or self._has_many_outliers)

    @property
    def is_conservative(self) -> bool:
        """True if the stated sigma is too large: the parts are smaller than predicted."""
        return self._bulk_factor < 1.0 / TOLERATED_FACTOR and self._excess(self._inlier_count) < -_SIGMAS

    @property
    def is_misidentified(self) -> bool:
        """True if there are many outliers, and the other parts, if enough, are not larger than predicted."""
        return self._has_many_outliers and not self._bulk_factor > TOLERATED_FACTOR

    @property
    def _has_many_outliers(self) -> bool:
        """True if outliers are significantly more frequent than if sigma were optimistic by the tolerated factor."""
        count, expected = self._count, _expected_outlier_share(self._degrees)
        return count * (self.outlier_share - expected) > _SIGMAS * math.sqrt(count * expected * (1.0 - expected))

    def _factor(self, count: int) -> float:
        """Return the ratio of true to stated sigma, from the median of the ``count`` smallest squares.

        If there are many outliers, the lower quartile is used instead of the median. In an exposure with large errors
        the selection of stars rejects the largest parts until the others are consistent. This rejection changes the
        median, but hardly the lower quartile.
        """
        if count < LEAST_COUNT:
            return math.nan
        share = 0.5 if max(count - self._inlier_count, 0) / count < _MANY_OUTLIERS_SHARE else 0.25
        found = float(self._squares[math.ceil(share * count) - 1])
        if math.isinf(found):
            return math.nan  # too many rejected parts of unknown size
        # The innovation variance is the variance of the prediction plus the variance of the source. Only the latter is
        # scaled.
        ratio = found / value_above(1.0 - share, self._degrees)
        return math.sqrt(max(1.0 + (ratio - 1.0) / self._own_share, 0.0))

    def _excess(self, count: int) -> float:
        """Return the number of counted squares above the predicted median minus half of the counted squares, in sigmas.

        Args:
            count: number of smallest squares that are counted.
        """
        below = min(int(self._squares.searchsorted(value_above(0.5, self._degrees), side="right")), count)
        return (count - 2 * below) / math.sqrt(count)


@cache
def _expected_outlier_share(degrees: int) -> float:
    """Return the share of outliers for a sigma that is optimistic by the tolerated factor."""
    return probability_above(value_above(_OUTLIER_PROBABILITY, degrees) / TOLERATED_FACTOR**2, degrees)


@dataclass(frozen=True)
class AxisStatistics:
    """Statistics of the innovations along one axis, in order of time.

    Attributes:
        name: name of the axis.
        count: number of innovations.
        common_variance: variance of the prediction error that all innovations share, in squared sigmas of the
            innovations; 0 if the filter uses the source.
        bias_sigma: median of the innovations, in their sigmas.
        spread: sigma of the innovations about their median, in predicted sigmas; at least 1.
        correlation: correlation of successive innovations, outliers clipped; 0 if all are equal.
    """

    name: str
    count: int
    common_variance: float
    bias_sigma: float
    spread: float
    correlation: float

    @property
    def is_biased(self) -> bool:
        """True if the median differs significantly from zero."""
        return abs(self.bias_sigma) > max(TOLERATED_BIAS, _SIGMAS * self._sigma_of_median)

    @property
    def is_correlated(self) -> bool:
        """True if successive innovations are correlated although the prediction errors are uncorrelated."""
        most = max(TOLERATED_CORRELATION, _SIGMAS / math.sqrt(self.count))
        return self.common_variance == 0.0 and abs(self.correlation) > most

    def bias_text(self, residual: FloatArray) -> str:
        """Return the text of a bias and its possible cause, from the innovations along the axis, rad, shape (n,)."""
        # The medians are compared in rad, because the sigma of an innovation changes with that of the prediction. The
        # noise is computed from successive differences, which a drift hardly changes.
        half, bias = len(residual) // 2, float(np.median(residual))
        change = float(np.median(residual[half:]) - np.median(residual[:half]))
        noise = _SIGMA_OF_SPREAD * float(np.median(np.abs(np.diff(residual)))) / math.sqrt(2.0)
        size = f"bias of {bias / ARCSEC:+.1f} arcsec in {self.name} ({self.bias_sigma:+.1f} sigma)"
        if abs(change) < max(_STEADY * abs(bias), _SIGMAS * _MEDIAN_SIGMA * noise * math.sqrt(4.0 / half)):
            return f"{size}, steady: check installation and alignment"
        return f"{size}, changing by {change / ARCSEC:+.1f} arcsec in the window: a drift, or a new bias"

    @property
    def correlation_text(self) -> str:
        """Text of a correlation and its possible cause."""
        if self.correlation > 0.0:
            return (
                f"errors correlated: innovations in {self.name} resemble the previous ones "
                f"(correlation {self.correlation:.2f}); correlated error of the source or the INS, or a clock offset"
            )
        return (
            f"innovations in {self.name} have the opposite sign of the previous ones "
            f"(correlation {self.correlation:.2f}): the filter follows its measurements too closely"
        )

    @property
    def _sigma_of_median(self) -> float:
        """Sigma of the median, in predicted sigmas; correlated innovations count as fewer innovations."""
        correlation = min(max(self.correlation, 0.0), _MOST_CORRELATED)
        variance = (_MEDIAN_SIGMA * self.spread) ** 2 * (1.0 + correlation) / (1.0 - correlation) / self.count
        return math.sqrt(variance + self.common_variance)


def axis_statistics(table: InnovationTable) -> list[AxisStatistics]:
    """Return the statistics of each axis with enough innovations.

    Example:
        >>> table = InnovationTable()
        >>> table.add_all([Innovation(time_ns, np.array([4.0]), degrees=1, nis=4.0, components=1, own_share=1.0,
        ...                        is_used=True, axes={"up": (2.0, 6.0 * ARCSEC)}) for time_ns in range(LEAST_COUNT)])
        >>> [up] = axis_statistics(table)
        >>> print(up.name, up.bias_sigma, up.is_biased)
        up 2.0 True
    """
    figures, common_variance = compiled_innovations.axis_statistics(
        table.numbers, len(table.axes), LEAST_COUNT, _SIGMA_OF_SPREAD, _CLIPPED_AT
    )
    return [
        AxisStatistics(name, int(count), common_variance, *statistics)
        for name, (count, *statistics) in zip(table.axes, figures.tolist(), strict=True)
        if count >= LEAST_COUNT
    ]
