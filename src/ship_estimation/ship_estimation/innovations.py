"""Innovations of one source: how large they are, where their mean lies, and how long they last.

An innovation is the residual of a measurement against its prediction. A measurement has parts: stars, lights, or the
attitude as a whole. An :class:`InnovationTable` holds many of them; :class:`Parts` tells whether the sizes of the parts
are those predicted, :class:`Axis` whether their mean is zero and each independent of the one before. Medians make a few
that lie far off count little.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_innovations
from ship_estimation.chi_square import normal_value_above, probability_above, value_above
from ship_estimation.outcome import Decision
from ship_estimation.refusals import Reason
from ship_geometry.rotations import ARCSEC, FloatArray

LEAST_COUNT = 30
"""Fewer measurements are too few for a verdict."""

FALSE_VERDICT = 1e-7
"""Probability that one test speaks against a source that is as stated."""

TOLERATED_FACTOR = 1.25
"""Of a sigma that is off by less nothing is said."""

TOLERATED_BIAS = 0.25
"""Of a smaller mean of the innovations, in their sigmas, nothing is said."""

TOLERATED_CORRELATION = 0.2
"""Of a smaller correlation of each innovation with the one before nothing is said."""

_FAR = 1e-3
"""Parts that are less probable lie far off. The selection of stars leaves out about what is as improbable."""

_LEAST_OWN_SHARE = 0.5
"""A residual of which a larger part is the prediction's error says little of the source."""

_MANY_FAR = 0.25
_STEADY = 0.25
_MISFIT = (Reason.MISIDENTIFIED, Reason.LIGHT_CONFLICT)
_MOST_CORRELATED = 0.95
_CLIPPED_AT = 3.0
_SIGMAS = normal_value_above(0.5 * FALSE_VERDICT)
_MEDIAN_SIGMA = math.sqrt(0.5 * math.pi)
"""Sigma of the median of n normal values of sigma 1, times √n."""
_SIGMA_OF_SPREAD = 1.4826
"""Sigma of normal values over the median of their distances from their median."""


class Innovation(NamedTuple):
    """One measurement as it is judged.

    Attributes:
        time_ns: its stamp.
        squares: of each part, its normalised square, shape (p,); infinite where the part was left out.
        degrees: components of a part; 0 where no part was compared.
        nis: normalised square of the whole residual; 0 where nothing was compared.
        components: of the whole residual.
        own_share: the measurement's own noise over what is predicted of its residual.
        is_used: whether the estimate uses the source. If not, the prediction's error lasts: nothing corrects it.
        axes: axis → mean over the parts of the residual along it, in its sigma, and in rad.
    """

    time_ns: int
    squares: FloatArray
    degrees: int
    nis: float
    components: int
    own_share: float
    is_used: bool
    axes: Mapping[str, tuple[float, float]]


def innovation_of(decision: Decision[Any]) -> Innovation | None:
    """What a decision says of its source; None where it says nothing, as of a measurement that was never compared.

    Example:
        An error of 6″ where 3″ are predicted:

        >>> from ship_geometry.vector_track import VectorSample
        >>> residual, covariance = np.array([6.0]) * ARCSEC, np.array([[9.0]]) * ARCSEC**2
        >>> decision = Decision(VectorSample(1, residual), Reason.NONE, True, ("up",), residual,
        ...                     covariance=covariance, noise=covariance)
        >>> found = innovation_of(decision)
        >>> print(found.squares.round(6), round(found.own_share, 6), round(found.axes["up"][0], 6))
        [4.] 1.0 2.0
    """
    time_ns = decision.measurement.time_ns
    left_out = sum(refusal.reason in _MISFIT for _, refusal in decision.left_out)
    if not len(decision.residual):
        if decision.reason not in _MISFIT:
            return None
        return Innovation(time_ns, np.full(max(left_out, 1), np.inf), 0, 0.0, 0, 1.0, True, {})
    if len(decision.covariance) != len(decision.residual):
        return None  # its covariance is not known
    groups = _grouped(decision.components)
    found = compiled_innovations.innovation(decision.residual, decision.covariance, decision.noise, *groups[:4])
    if found is None:
        return None  # what is no number, or no covariance, says nothing
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
    """Which part and which axis each of m components belongs to.

    Attributes:
        part_of: number of its part, shape (m,).
        axis_of: number of its axis, shape (m,).
        parts: how many there are.
        axis_count: how many there are.
        axes: their names.
        degrees: components of the first part.
    """

    part_of: NDArray[np.intp]
    axis_of: NDArray[np.intp]
    parts: int
    axis_count: int
    axes: tuple[str, ...]
    degrees: int


@lru_cache(maxsize=256)
def _grouped(components: tuple[str, ...]) -> _Groups:
    """``"HIP 92420 up"`` is the axis ``up`` of the part ``HIP 92420``; remembered, as a source mostly has the same."""
    names = [name.rpartition(" ") for name in components]
    parts = list(dict.fromkeys(part for part, _, _ in names))
    axes = tuple(dict.fromkeys(axis for _, _, axis in names))
    part_of = np.array([parts.index(part) for part, _, _ in names], dtype=np.intp)
    axis_of = np.array([axes.index(axis) for _, _, axis in names], dtype=np.intp)
    return _Groups(part_of, axis_of, len(parts), len(axes), axes, int(np.count_nonzero(part_of == 0)))


_SINGLE_NUMBERS = 5
"""Columns of an :class:`InnovationTable` before those of the axes."""
_NO_AXIS = (math.nan, math.nan)


class InnovationTable:
    """Innovations of one source in order of time, one of each stamp.

    Attributes:
        axes: names of the axes that any of them has.
        times_ns: stamps, shape (n,).
        numbers: of each the degrees, the normalised square, the number of components, the own share and whether it is
            used; then for each axis what was measured along it, in sigmas and in rad; then the squares of its parts.
            What it does not have is NaN. Shape (n, c).

    Example:
        >>> table = InnovationTable()
        >>> one = Innovation(7, np.array([4.0]), degrees=1, nis=4.0, components=1, own_share=1.0,
        ...                  is_used=True, axes={"up": (2.0, 6.0 * ARCSEC)})
        >>> table.take([one, one])
        >>> print(len(table), table.squares, table.along("up")[:, 0])
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
        """Of the parts of each innovation, filled with NaN, shape (n, p)."""
        squares: FloatArray = self.numbers[:, self.first_square :]
        return squares

    @property
    def first_square(self) -> int:
        """Column of the first of them."""
        return _SINGLE_NUMBERS + 2 * len(self.axes)

    def along(self, axis: str) -> FloatArray:
        """What was measured along an axis, in sigmas and in rad, shape (k, 2), of the k innovations that have it."""
        start = _SINGLE_NUMBERS + 2 * self.axes.index(axis)
        along: FloatArray = self.numbers[:, start : start + 2]
        return along[~np.isnan(along[:, 0])]

    def take(self, innovations: Collection[Innovation]) -> None:
        """Add innovations; of those with one stamp the last one taken stays."""
        self._widen(innovations)
        added_ns = [one.time_ns for one in innovations]
        times_ns = np.concatenate([self.times_ns, np.array(added_ns, dtype=np.int64)])
        numbers = np.concatenate([self.numbers, self._rows(innovations)])
        if not all(before < after for before, after in pairwise([*self.times_ns[-1:].tolist(), *added_ns])):
            order = np.argsort(times_ns, kind="stable")
            order = order[np.append(np.diff(times_ns[order]) > 0, True)]
            times_ns, numbers = times_ns[order], numbers[order]
        self.times_ns, self.numbers = times_ns, numbers

    def forget(self, until_ns: int, most: int) -> None:
        """Forget those up to a stamp, and of the others all but the newest."""
        first = max(int(self.times_ns.searchsorted(until_ns, side="right")), len(self) - most)
        if first > 0:
            self.times_ns, self.numbers = self.times_ns[first:], self.numbers[first:]

    def _widen(self, innovations: Collection[Innovation]) -> None:
        """Make room for axes that the table does not have yet, and for more parts than any had."""
        axes = tuple(dict.fromkeys(chain(self.axes, *(one.axes for one in innovations))))
        known = self.squares
        parts = max(known.shape[1], *(len(one.squares) for one in innovations))
        if axes != self.axes or parts > known.shape[1]:
            old, first_square, self.axes = self.numbers, self.first_square, axes
            self.numbers = np.full((len(old), self.first_square + parts), np.nan)
            self.numbers[:, :first_square] = old[:, :first_square]
            self.squares[:, : known.shape[1]] = known

    def _rows(self, innovations: Collection[Innovation]) -> FloatArray:
        """Innovations as they stand in the table, shape (n, c)."""
        width, rows = self.numbers.shape[1], []
        for one in innovations:
            row = [one.degrees, one.nis, one.components, one.own_share, one.is_used]
            row += [*chain(*(one.axes.get(name, _NO_AXIS) for name in self.axes)), *one.squares.tolist()]
            rows.append(row + [math.nan] * (width - len(row)))
        return np.array(rows, dtype=np.float64)


class Parts:
    """The sizes of the parts of many measurements.

    What lies far off may be misidentified, or the tail of a wider noise: without it, the bulk tells which.

    Attributes:
        factor: true sigma of the source over the stated one; NaN where too few tell.
        far_share: share of the parts that lie far off, or were left out; NaN likewise.
        components: of all residuals.
        nis: mean normalised square of a component; NaN where there is none.
    """

    def __init__(self, table: InnovationTable) -> None:
        # In order, so that each share of them is a number of places.
        self._squares, degrees, self._own_share, nis, self.components = compiled_innovations.sizes(
            table.numbers, table.first_square, _LEAST_OWN_SHARE
        )
        self.nis = nis / self.components if self.components else math.nan
        self._degrees, self._count = degrees or 1, len(self._squares)
        self._near = int(self._squares.searchsorted(value_above(_FAR, self._degrees), side="right"))
        self.far_share = 1.0 - self._near / self._count if self._count >= LEAST_COUNT else math.nan
        by_all, by_near = self._factor(self._count), self._factor(self._near)
        self._bulk_factor = by_all if math.isnan(by_near) else by_near
        self.factor = by_all if self._bulk_factor > TOLERATED_FACTOR else self._bulk_factor

    @property
    def is_optimistic(self) -> bool:
        """Whether even those that are not far off are larger than predicted."""
        return self._bulk_factor > TOLERATED_FACTOR and (self._excess(self._count) > _SIGMAS or self._many_far)

    @property
    def is_conservative(self) -> bool:
        """Whether they are smaller than predicted."""
        return self._bulk_factor < 1.0 / TOLERATED_FACTOR and self._excess(self._near) < -_SIGMAS

    @property
    def is_misidentified(self) -> bool:
        """Whether many lie far off, and the others, where there are enough, are as predicted."""
        return self._many_far and not self._bulk_factor > TOLERATED_FACTOR

    @property
    def _many_far(self) -> bool:
        """Whether more lie far off than would with a sigma that is as optimistic as is tolerated."""
        count, expected = self._count, _expected_far(self._degrees)
        return count * (self.far_share - expected) > _SIGMAS * math.sqrt(count * expected * (1.0 - expected))

    def _factor(self, count: int) -> float:
        """True sigma over the stated one, by the median of the least squares; by the lower quarter where many are far.

        Of an exposure with too large errors not only the stars that lie far off are left out, but as many of the
        largest as make the others agree. That changes the median, but hardly the lower quarter.
        """
        if count < LEAST_COUNT:
            return math.nan
        share = 0.5 if max(count - self._near, 0) / count < _MANY_FAR else 0.25
        found = float(self._squares[math.ceil(share * count) - 1])
        if math.isinf(found):
            return math.nan  # so many were left out that nobody knows how far off they were
        # The square of a part is that of the prediction's error and that of the source's own, which alone is scaled.
        ratio = found / value_above(1.0 - share, self._degrees)
        return math.sqrt(max(1.0 + (ratio - 1.0) / self._own_share, 0.0))

    def _excess(self, count: int) -> float:
        """Of the least squares those above the predicted median, beyond half of them, in sigmas of that number."""
        below = min(int(self._squares.searchsorted(value_above(0.5, self._degrees), side="right")), count)
        return (count - 2 * below) / math.sqrt(count)


@cache
def _expected_far(degrees: int) -> float:
    """Share of the parts that lie far off where a sigma is as optimistic as is tolerated."""
    return probability_above(value_above(_FAR, degrees) / TOLERATED_FACTOR**2, degrees)


@dataclass(frozen=True)
class Axis:
    """The innovations along one axis, in order of time.

    Attributes:
        name: of the axis.
        count: how many there are.
        lasting: variance, in squares of their sigmas, of what of the prediction's error is the same in all of them.
        bias_sigma: median of the innovations, in their sigmas.
        spread: sigma of the innovations about their median, in predicted sigmas; at least 1.
        correlation: of each innovation with the one before, those that are far off clipped; 0 where all are the same.
    """

    name: str
    count: int
    lasting: float
    bias_sigma: float
    spread: float
    correlation: float

    @property
    def is_biased(self) -> bool:
        """Whether the median is not zero."""
        return abs(self.bias_sigma) > max(TOLERATED_BIAS, _SIGMAS * self._sigma_of_median)

    @property
    def is_lasting(self) -> bool:
        """Whether the innovations are not independent of one another, although the prediction's errors are."""
        most = max(TOLERATED_CORRELATION, _SIGMAS / math.sqrt(self.count))
        return self.lasting == 0.0 and abs(self.correlation) > most

    def bias_text(self, residual: FloatArray) -> str:
        """The size of a bias, and what it may come from, by what was measured along the axis, rad, shape (n,)."""
        # In rad, as the sigma changes with the prediction's; the noise by successive differences, free of a drift.
        half, bias = len(residual) // 2, float(np.median(residual))
        change = float(np.median(residual[half:]) - np.median(residual[:half]))
        noise = _SIGMA_OF_SPREAD * float(np.median(np.abs(np.diff(residual)))) / math.sqrt(2.0)
        size = f"bias of {bias / ARCSEC:+.1f} arcsec in {self.name} ({self.bias_sigma:+.1f} sigma)"
        if abs(change) < max(_STEADY * abs(bias), _SIGMAS * _MEDIAN_SIGMA * noise * math.sqrt(4.0 / half)):
            return f"{size}, steady: look at installation and alignment"
        return f"{size}, changing by {change / ARCSEC:+.1f} arcsec within the window: it drifts, or has just begun"

    @property
    def correlation_text(self) -> str:
        """What a correlation may come from."""
        if self.correlation > 0.0:
            return (
                f"errors last: innovations in {self.name} are like the ones before "
                f"(correlation {self.correlation:.2f}); an error of the source or of the INS lasts, or a clock is off"
            )
        return (
            f"innovations in {self.name} contradict the ones before (correlation {self.correlation:.2f}): "
            "the estimate follows its measurements too closely"
        )

    @property
    def _sigma_of_median(self) -> float:
        """Of the median of the innovations, in predicted sigmas: as of fewer where they are correlated."""
        alike = min(max(self.correlation, 0.0), _MOST_CORRELATED)
        variance = (_MEDIAN_SIGMA * self.spread) ** 2 * (1.0 + alike) / (1.0 - alike) / self.count
        return math.sqrt(variance + self.lasting)


def axes_of(table: InnovationTable) -> list[Axis]:
    """The axes along which enough was measured.

    Example:
        >>> table = InnovationTable()
        >>> table.take([Innovation(time_ns, np.array([4.0]), degrees=1, nis=4.0, components=1, own_share=1.0,
        ...                        is_used=True, axes={"up": (2.0, 6.0 * ARCSEC)}) for time_ns in range(LEAST_COUNT)])
        >>> [up] = axes_of(table)
        >>> print(up.name, up.bias_sigma, up.is_biased)
        up 2.0 True
    """
    figures, lasting = compiled_innovations.along_axes(
        table.numbers, len(table.axes), LEAST_COUNT, _SIGMA_OF_SPREAD, _CLIPPED_AT
    )
    return [
        Axis(name, int(count), lasting, *statistics)
        for name, (count, *statistics) in zip(table.axes, figures.tolist(), strict=True)
        if count >= LEAST_COUNT
    ]
