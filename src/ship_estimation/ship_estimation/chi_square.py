"""The χ² distribution in plain floats: its tails, its quantiles, and the quantiles of the normal one.

A node judges each measurement by these few functions. scipy has them too, but reading it takes longer than all else
that a node reads. A χ² value v of k degrees of freedom stays below v with the regularised incomplete gamma function
P(a, x), a = k/2, x = v/2: its series where x < a + 1, elsewhere the continued fraction of Q = 1 − P (Press et al.
2007, §6.2). A small tail is computed as such and never as one minus the other.
"""

import math
from functools import cache

_EPSILON = 2.0**-53

_LEAST = 1e-300
"""A smaller probability is zero; a denominator of the continued fraction is made this instead of zero."""

_LAST_STEP = 1e-9
"""Newton's steps halve the exponent of the error: after one that is smaller, relative, nothing is left to do."""

_LARGE = 20.0
"""From here on Stirling's series, cut where its terms end below, gives Γ to the last digit."""


def probability_above(value: float, degrees: int) -> float:
    """Probability that a χ² value of ``degrees`` is larger than ``value``; NaN where that is NaN.

    Example:
        >>> print(round(probability_above(7.815, degrees=3), 4))
        0.05
    """
    return _tails(0.5 * value, 0.5 * degrees)[1]


def probability_below(value: float, degrees: int) -> float:
    """Probability that a χ² value of ``degrees`` is smaller than ``value``; NaN where that is NaN.

    Example:
        >>> print(round(probability_below(7.815, degrees=3), 4))
        0.95
    """
    return _tails(0.5 * value, 0.5 * degrees)[0]


@cache
def value_above(probability: float, degrees: int) -> float:
    """The value that χ² of ``degrees`` exceeds with ``probability``; infinite for 0, which is all below 1e-300.

    Example:
        >>> print(round(value_above(0.05, degrees=3), 3))
        7.815
    """
    if probability > 0.5:
        return value_below(1.0 - probability, degrees)
    if not probability >= _LEAST:
        return math.nan if math.isnan(probability) else math.inf
    a, wanted = 0.5 * degrees, math.log(probability)
    value = _first_guess(math.sqrt(-2.0 * math.log(2.0 * probability)), degrees)
    # The logarithm of the tail is concave: Newton's second step is beyond the root, and those after it come nearer.
    while True:
        tail = _tails(0.5 * value, a)[1]
        if tail == 0.0:
            value = 0.5 * (value + degrees)  # the first guess was so far out that nothing is left of the tail
            continue
        step = (math.log(tail) - wanted) * value * tail / (a * _power(0.5 * value, a))
        value += step
        if not abs(step) > _LAST_STEP * value:
            return value


@cache
def value_below(probability: float, degrees: int) -> float:
    """The value that χ² of ``degrees`` stays below with ``probability``; infinite for 1.

    Example:
        >>> print(round(value_below(0.05, degrees=3), 3))
        0.352
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
    # Concave over the logarithm of the value: the same as above.
    while True:
        tail = _tails(0.5 * value, a)[0]
        step = (wanted - math.log(tail)) * tail / (a * _power(0.5 * value, a))
        value = max(least, value * math.exp(step))
        if not abs(step) > _LAST_STEP:
            return value


def normal_value_above(probability: float) -> float:
    """What a normal error of sigma 1 exceeds, on that side, with a ``probability`` of at most a half.

    Example:
        >>> print(round(normal_value_above(0.025), 2))
        1.96
    """
    return math.sqrt(value_above(2.0 * probability, 1))


def _tails(x: float, a: float) -> tuple[float, float]:
    """P(a, x) and Q(a, x)."""
    if not 0.0 < x < math.inf:
        return (math.nan, math.nan) if math.isnan(x) else (0.0, 1.0) if x <= 0.0 else (1.0, 0.0)
    if x < a + 1.0:
        below = _power(x, a) * _series(x, a)
        return below, 1.0 - below
    above = a * _power(x, a) * _continued_fraction(x, a)
    return 1.0 - above, above


def _series(x: float, a: float) -> float:
    """1 + x / (a + 1) + x² / ((a + 1) (a + 2)) + …."""
    term = total = 1.0
    while term > total * _EPSILON:
        a += 1.0
        term *= x / a
        total += term
    return total


def _continued_fraction(x: float, a: float) -> float:
    """Q(a, x) Γ(a) / (xᵃ e⁻ˣ), by Lentz's method."""
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
    """xᵃ e⁻ˣ / Γ(a + 1); of large a without the difference of large logarithms."""
    if a < _LARGE:
        return math.exp(a * math.log(x) - x) / math.gamma(a + 1.0)
    beyond = (x - a) / a
    w = 1.0 / (a * a)
    stirling = (1.0 / 12.0 - w * (1.0 / 360.0 - w * (1.0 / 1260.0 - w * (1.0 / 1680.0 - w / 1188.0)))) / a
    return math.exp(a * (math.log1p(beyond) - beyond) - stirling) / math.sqrt(2.0 * math.pi * a)


def _first_guess(sigmas: float, degrees: int) -> float:
    """The χ² value that lies where a normal one lies at ``sigmas`` (Wilson, Hilferty 1931)."""
    variance = 2.0 / (9.0 * degrees)
    return float(degrees * max(1.0 - variance + sigmas * math.sqrt(variance), 0.0) ** 3)
