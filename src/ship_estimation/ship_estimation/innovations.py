"""Innovations of one source: how large they are, where their mean lies, and how long they last.

An innovation is the residual of a measurement against its prediction. A measurement has parts: stars, lights, or the
attitude as a whole. :class:`Parts` tells whether their sizes are those predicted, :class:`Axis` whether their mean is
zero and each independent of the one before. Medians make a few that lie far off count little.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ship_estimation.chi_square import normal_value_above, probability_above, value_above
from ship_estimation.gates import normalized_error_squared
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


@dataclass(frozen=True)
class Innovation:
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
        >>> print(found.squares.round(6), found.own_share, round(found.axes["up"][0], 6))
        [4.] 1.0 2.0
    """
    time_ns = decision.measurement.time_ns
    left_out = sum(refusal.reason in _MISFIT for _, refusal in decision.left_out)
    if not len(decision.residual):
        if decision.reason not in _MISFIT:
            return None
        return Innovation(time_ns, np.full(max(left_out, 1), np.inf), 0, 0.0, 0, 1.0, True, {})
    if not (np.all(np.isfinite(decision.residual)) and np.all(np.isfinite(decision.covariance))):
        return None
    if len(decision.covariance) != len(decision.residual):
        return None  # its covariance is not known
    parts, axes = _grouped(decision.components)
    residual, covariance = decision.residual, decision.covariance
    squares = [float(normalized_error_squared(residual[rows], covariance[np.ix_(rows, rows)])) for rows in parts]
    normalised = residual / np.sqrt(np.diagonal(covariance))
    return Innovation(
        time_ns=time_ns,
        squares=np.array(squares + [np.inf] * left_out),
        degrees=len(parts[0]),
        nis=decision.nis,
        components=len(residual),
        own_share=float(np.trace(np.linalg.solve(covariance, decision.noise))) / len(residual),
        is_used=decision.reason is not Reason.EXCLUDED,
        axes={name: _along(rows, normalised, residual, covariance) for name, rows in axes.items()},
    )


def _along(
    rows: Sequence[int], normalised: FloatArray, residual: FloatArray, covariance: FloatArray
) -> tuple[float, float]:
    """Mean of the residuals of several parts along an axis, in its sigma, and in rad."""
    sigma = np.sqrt(np.diagonal(covariance)[rows])
    correlation = covariance[np.ix_(rows, rows)] / np.outer(sigma, sigma)
    return float(np.sum(normalised[rows]) / np.sqrt(np.sum(correlation))), float(np.mean(residual[rows]))


def _grouped(components: tuple[str, ...]) -> tuple[list[list[int]], dict[str, list[int]]]:
    """Rows of each part, and rows of each axis: ``"HIP 92420 up"`` is the axis ``up`` of the part ``HIP 92420``."""
    parts: dict[str, list[int]] = {}
    axes: dict[str, list[int]] = {}
    for row, name in enumerate(components):
        part, _, axis = name.rpartition(" ")
        parts.setdefault(part, []).append(row)
        axes.setdefault(axis, []).append(row)
    return list(parts.values()), axes


class Parts:
    """The sizes of the parts of many measurements.

    What lies far off may be misidentified, or the tail of a wider noise: without it, the bulk tells which.

    Attributes:
        factor: true sigma of the source over the stated one; NaN where too few tell.
        far_share: share of the parts that lie far off, or were left out; NaN likewise.
    """

    def __init__(self, innovations: Sequence[Innovation]) -> None:
        telling = [one for one in innovations if one.own_share >= _LEAST_OWN_SHARE]
        squares = np.concatenate([one.squares for one in telling]) if telling else np.empty(0)
        self._degrees = max((one.degrees for one in telling), default=0) or 1
        self._own_share = float(np.mean([one.own_share for one in telling])) if telling else math.nan
        self._least_far = value_above(_FAR, self._degrees)
        self._all, self._near = squares, squares[squares <= self._least_far]
        self.far_share = 1.0 - len(self._near) / len(squares) if len(squares) >= LEAST_COUNT else math.nan
        by_all, by_near = self._factor(self._all), self._factor(self._near)
        self._bulk_factor = by_all if math.isnan(by_near) else by_near
        self.factor = by_all if self._bulk_factor > TOLERATED_FACTOR else self._bulk_factor

    @property
    def is_optimistic(self) -> bool:
        """Whether even those that are not far off are larger than predicted."""
        return self._bulk_factor > TOLERATED_FACTOR and (self._excess(self._all) > _SIGMAS or self._many_far)

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
        count, expected = len(self._all), probability_above(self._least_far / TOLERATED_FACTOR**2, self._degrees)
        return count * (self.far_share - expected) > _SIGMAS * math.sqrt(count * expected * (1.0 - expected))

    def _factor(self, squares: FloatArray) -> float:
        """True sigma over the stated one, by the median; by the lower quarter where many lie far off.

        Of an exposure with too large errors not only the stars that lie far off are left out, but as many of the
        largest as make the others agree. That changes the median, but hardly the lower quarter.
        """
        if len(squares) < LEAST_COUNT:
            return math.nan
        share = 0.5 if np.mean(squares > self._least_far) < _MANY_FAR else 0.25
        found = float(np.quantile(squares, share, method="inverted_cdf"))
        if math.isinf(found):
            return math.nan  # so many were left out that nobody knows how far off they were
        # The square of a part is that of the prediction's error and that of the source's own, which alone is scaled.
        ratio = found / value_above(1.0 - share, self._degrees)
        return math.sqrt(max(1.0 + (ratio - 1.0) / self._own_share, 0.0))

    def _excess(self, squares: FloatArray) -> float:
        """Number of parts above the predicted median beyond half of them, in sigmas of that number."""
        above = int(np.sum(squares > value_above(0.5, self._degrees)))
        return (2 * above - len(squares)) / math.sqrt(len(squares))


@dataclass(frozen=True)
class Axis:
    """The innovations along one axis, in order of time.

    Attributes:
        name: of the axis.
        normalised: in their sigmas, shape (n,).
        residual: in rad, shape (n,).
        lasting: variance, in squares of their sigmas, of what of the prediction's error is the same in all of them.
    """

    name: str
    normalised: FloatArray
    residual: FloatArray
    lasting: float

    @cached_property
    def bias_sigma(self) -> float:
        """Median of the innovations, in their sigmas."""
        return float(np.median(self.normalised))

    @cached_property
    def correlation(self) -> float:
        """Of each innovation with the one before, those that are far off clipped; 0 where all are the same."""
        around = np.clip((self.normalised - self.bias_sigma) / self._spread, -_CLIPPED_AT, _CLIPPED_AT)
        squares = float(np.sum(around * around))
        return float(np.sum(around[1:] * around[:-1])) / squares if squares > 0.0 else 0.0

    @property
    def is_biased(self) -> bool:
        """Whether the median is not zero."""
        return abs(self.bias_sigma) > max(TOLERATED_BIAS, _SIGMAS * self._sigma_of_median(len(self.normalised)))

    @property
    def is_lasting(self) -> bool:
        """Whether the innovations are not independent of one another, although the prediction's errors are."""
        most = max(TOLERATED_CORRELATION, _SIGMAS / math.sqrt(len(self.normalised)))
        return self.lasting == 0.0 and abs(self.correlation) > most

    @property
    def bias_text(self) -> str:
        """The size of a bias, and what it may come from."""
        # In rad, as the sigma changes with the prediction's; the noise by successive differences, free of a drift.
        half, bias = len(self.residual) // 2, float(np.median(self.residual))
        change = float(np.median(self.residual[half:]) - np.median(self.residual[:half]))
        noise = _SIGMA_OF_SPREAD * float(np.median(np.abs(np.diff(self.residual)))) / math.sqrt(2.0)
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

    @cached_property
    def _spread(self) -> float:
        """Sigma of the innovations about their median, in predicted sigmas; at least 1."""
        return max(1.0, _SIGMA_OF_SPREAD * float(np.median(np.abs(self.normalised - self.bias_sigma))))

    def _sigma_of_median(self, count: int) -> float:
        """Of the median of ``count`` innovations, in predicted sigmas: as of fewer where they are correlated."""
        alike = min(max(self.correlation, 0.0), _MOST_CORRELATED)
        variance = (_MEDIAN_SIGMA * self._spread) ** 2 * (1.0 + alike) / (1.0 - alike) / count
        return math.sqrt(variance + self.lasting)


def axes_of(innovations: Sequence[Innovation]) -> list[Axis]:
    """The axes along which enough was measured.

    Example:
        >>> one = Innovation(1, np.array([4.0]), degrees=1, nis=4.0, components=1, own_share=1.0,
        ...                  is_used=True, axes={"up": (2.0, 6.0 * ARCSEC)})
        >>> [up] = axes_of([one] * LEAST_COUNT)
        >>> print(up.name, up.bias_sigma, up.is_biased)
        up 2.0 True
    """
    by_name: dict[str, list[tuple[float, float]]] = {}
    for one in innovations:
        for name, values in one.axes.items():
            by_name.setdefault(name, []).append(values)
    lasting = max((1.0 - one.own_share for one in innovations if not one.is_used), default=0.0)
    enough = {name: np.array(values) for name, values in by_name.items() if len(values) >= LEAST_COUNT}
    return [Axis(name, values[:, 0], values[:, 1], lasting) for name, values in enough.items()]
