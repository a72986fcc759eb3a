"""Chi² distribution, parameters of innovation gates, and NEES and NIS with their acceptance bands.

The filters compare with the gate and reject: ``ship_attitude/filter``, ``theodolite_calib/filter/sighting_gate``. All
checks of a measurement are listed in :mod:`ship_estimation.rejection_rules`. Source: Bar-Shalom, Li, Kirubarajan 2001,
§5.4.

Tails and quantiles are computed in plain floats, because the import of scipy takes longer than all other imports of a
node. The probability that χ² of k degrees of freedom is below v is the regularised incomplete gamma function P(a, x)
with a = k/2 and x = v/2. It is computed by its series for x < a + 1, otherwise by the continued fraction of Q = 1 − P
(Press et al. 2007, §6.2). A small tail is computed directly and never as one minus the large tail.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from ship_estimation.parameters.fields import parameter
from ship_geometry.rotations import FloatArray

_EPSILON = 2.0**-53

_LEAST = 1e-300
"""Probability below which a quantile is that for zero; also replaces a zero denominator of the continued fraction."""

_LAST_STEP = 1e-9
"""Maximum relative size of Newton's last step. The relative error after this step is about the square of its size."""

_LARGE = 20.0
"""Argument from which the truncated Stirling series in :func:`_power` gives Γ to the last digit."""


def probability_above(value: float, degrees: int) -> float:
    """Return the probability that χ² with ``degrees`` degrees of freedom is above ``value``; NaN if ``value`` is NaN.

    Example:
        >>> print(round(probability_above(7.815, degrees=3), 4))
        0.05
    """
    return _tails(0.5 * value, 0.5 * degrees)[1]


@cache
def value_above(probability: float, degrees: int) -> float:
    """Return the value that χ² with ``degrees`` degrees of freedom exceeds with ``probability``.

    The value is infinite for a probability below 1e-300.

    Example:
        >>> print(round(value_above(0.05, degrees=3), 3))
        7.815
    """
    if probability > 0.5:
        return chi_square_gate(1.0 - probability, degrees)
    if not probability >= _LEAST:
        return math.nan if math.isnan(probability) else math.inf
    a, wanted = 0.5 * degrees, math.log(probability)
    value = _first_guess(math.sqrt(-2.0 * math.log(2.0 * probability)), degrees)
    # The logarithm of the tail is concave: from Newton's second step on the iteration converges monotonically.
    while True:
        tail = _tails(0.5 * value, a)[1]
        if tail == 0.0:
            value = 0.5 * (value + degrees)  # the tail at the first guess underflows
            continue
        step = (math.log(tail) - wanted) * value * tail / (a * _power(0.5 * value, a))
        value += step
        if not abs(step) > _LAST_STEP * value:
            return value


@cache
def chi_square_gate(probability: float, degrees: int) -> float:
    """Return the quantile ``probability`` of χ² with ``degrees`` degrees of freedom: the gate of the NIS.

    The quantile is infinite for probability 1.

    Example:
        With probability 99.99 % the NIS of a consistent attitude (three components) is below 21.1:

        >>> print(round(chi_square_gate(0.9999, 3), 2))
        21.11
    """
    if probability > 0.5:
        return value_above(1.0 - probability, degrees)
    if not probability >= _LEAST:
        return math.nan if math.isnan(probability) else 0.0
    a, wanted = 0.5 * degrees, math.log(probability)
    # P(a, x) is at most xᵃ / Γ(a + 1).
    least = 2.0 * math.exp((wanted + math.lgamma(a + 1.0)) / a)
    if least == 0.0:
        return 0.0
    value = max(least, _first_guess(-math.sqrt(-2.0 * math.log(2.0 * probability)), degrees))
    # The logarithm of the tail is also concave in the logarithm of the value, so this iteration converges
    # monotonically.
    while True:
        tail = _tails(0.5 * value, a)[0]
        step = (wanted - math.log(tail)) * tail / (a * _power(0.5 * value, a))
        value = max(least, value * math.exp(step))
        if not abs(step) > _LAST_STEP:
            return value


def normal_value_above(probability: float) -> float:
    """Return the value that a normal error of sigma 1 exceeds, one-sided, with ``probability`` (at most 0.5).

    Example:
        >>> print(round(normal_value_above(0.025), 2))
        1.96
    """
    return math.sqrt(value_above(2.0 * probability, 1))


def _tails(x: float, a: float) -> tuple[float, float]:
    """Return P(a, x) and Q(a, x)."""
    if not 0.0 < x < math.inf:
        return (math.nan, math.nan) if math.isnan(x) else (0.0, 1.0) if x <= 0.0 else (1.0, 0.0)
    if x < a + 1.0:
        below = _power(x, a) * _series(x, a)
        return below, 1.0 - below
    above = a * _power(x, a) * _continued_fraction(x, a)
    return 1.0 - above, above


def _series(x: float, a: float) -> float:
    """Return 1 + x / (a + 1) + x² / ((a + 1) (a + 2)) + …."""
    term = total = 1.0
    while term > total * _EPSILON:
        a += 1.0
        term *= x / a
        total += term
    return total


def _continued_fraction(x: float, a: float) -> float:
    """Return Q(a, x) Γ(a) / (xᵃ e⁻ˣ), by Lentz's method."""
    b = x + 1.0 - a
    c, d = 1.0 / _LEAST, 1.0 / b
    total, n, factor = d, 0.0, 0.0
    while not abs(factor - 1.0) <= 2.0 * _EPSILON:
        n += 1.0
        numerator = n * (a - n)
        b += 2.0
        d = 1.0 / ((b + numerator * d) or _LEAST)
        c = (b + numerator / c) or _LEAST
        factor = c * d
        total *= factor
    return total


def _power(x: float, a: float) -> float:
    """Return xᵃ e⁻ˣ / Γ(a + 1), for large a without a difference of large logarithms."""
    if a < _LARGE:
        return math.exp(a * math.log(x) - x) / math.gamma(a + 1.0)
    beyond = (x - a) / a
    w = 1.0 / (a * a)
    stirling = (1.0 / 12.0 - w * (1.0 / 360.0 - w * (1.0 / 1260.0 - w * (1.0 / 1680.0 - w / 1188.0)))) / a
    return math.exp(a * (math.log1p(beyond) - beyond) - stirling) / math.sqrt(2.0 * math.pi * a)


def _first_guess(sigmas: float, degrees: int) -> float:
    """Return the approximate χ² quantile that corresponds to the normal quantile ``sigmas`` (Wilson, Hilferty 1931)."""
    variance = 2.0 / (9.0 * degrees)
    return float(degrees * max(1.0 - variance + sigmas * math.sqrt(variance), 0.0) ** 3)


@dataclass(frozen=True, kw_only=True)
class GateConfig:
    """Parameters of the innovation gate, and of successive rejections of one source."""

    probability: float = parameter(
        0.9999, doc="a consistent measurement passes with this probability", minimum=0.5, maximum=0.999999999, live=True
    )
    conflict_after: int = parameter(
        10, doc="successive rejections of one source that are reported as a conflict", minimum=1, live=True
    )
    degraded_after: int = parameter(
        3,
        doc="successive rejections after which a source is inconsistent; if all sources are, the output is DEGRADED",
        minimum=1,
        maximum=1000,
        live=True,
    )
    reopen_after: int = parameter(
        0, doc="successive rejections of one source that inflate the covariance; 0 never", minimum=0, live=True
    )
    reopen_factor: float = parameter(
        100.0, doc="factor of this inflation of the covariance", minimum=1.0, maximum=1e9, live=True
    )


def normalized_error_squared(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return NEES or NIS, error^T P^-1 error, shape (...), for errors (..., n) and covariances (..., n, n).

    Example:
        Independent errors of 3″ and 4″ with predicted sigmas of 3″ and 2″:

        >>> print(normalized_error_squared(np.array([3.0, 4.0]), np.diag([9.0, 4.0])))
        5.0
    """
    solution = np.linalg.solve(covariance, error[..., None])[..., 0]
    squared: FloatArray = np.sum(error * solution, axis=-1)
    return squared


def mean_nees_band(samples: int, degrees: int, probability: float = 0.999) -> tuple[float, float]:
    """Return the two-sided band of the mean of ``samples`` independent chi² values with ``degrees`` degrees of freedom.

    Example:
        The mean NEES of 200 consistent attitudes, three angles each, is near 3:

        >>> low, high = mean_nees_band(samples=200, degrees=3)
        >>> print(f"{low:.2f} to {high:.2f}")
        2.46 to 3.60
    """
    tail, total = 0.5 * (1.0 - probability), samples * degrees
    return chi_square_gate(tail, total) / samples, value_above(tail, total) / samples
