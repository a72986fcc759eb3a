"""Steps in values on a straight line, with their size by least squares and their position by likelihood."""

import functools
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray

_CHI2_MARGIN = 9.0
"""Chi² difference from the most likely position of a step; a larger difference rules a position out (three sigma)."""
_INTERVALS = 9
"""Number of successive intervals whose median is the period of the samples."""


class StepPlan(NamedTuple):
    """Estimator of a step in successive values, for several positions of the step.

    Attributes:
        length: number of values.
        counts: numbers of values after the step, one for each of k positions.
        weights: weight of each value in the step, oldest first, shape (k, length).
        white: sigma of the step per sigma of a value, shape (k,).
        walk: sigma of the step per sigma of a random walk from value to value, shape (k,).
    """

    length: int
    counts: tuple[int, ...]
    weights: FloatArray
    white: FloatArray
    walk: FloatArray


@functools.lru_cache(maxsize=64)
def step_plan(length: int, counts: tuple[int, ...]) -> StepPlan:
    """Return the least-squares estimator of a step in values on a straight line of unknown height and slope.

    Args:
        length: number of values, at least three.
        counts: numbers of values after the step, each less than ``length - 1``.

    Example:
        >>> plan = step_plan(12, (1, 4))
        >>> values = 0.5 * np.arange(12.0) + np.repeat([0.0, 7.0], [8, 4])
        >>> print((plan.weights @ values).round(6)[1], plan.white.round(3))
        7.0 [1.191 1.068]
    """
    place = np.arange(length) - 0.5 * (length - 1)
    after = (np.arange(length) >= length - np.array(counts)[:, None]).astype(float)
    left = after - after.mean(axis=1, keepdims=True)
    left -= np.outer(left @ place / (place @ place), place)
    weights = left / np.sum(left * left, axis=1, keepdims=True)
    to_end = np.cumsum(weights[:, ::-1], axis=1)
    white, walk = (np.sqrt(np.sum(one * one, axis=1)) for one in (weights, to_end))
    return StepPlan(length, counts, weights, white, walk)


def doubling_counts(last: int) -> tuple[int, ...]:
    """Return the powers of two below ``last``, and ``last``.

    Example:
        >>> doubling_counts(20)
        (1, 2, 4, 8, 16, 20)
    """
    return (*(2**n for n in range((last - 1).bit_length())), last)


def locate_step(plan: StepPlan, values: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, float, list[int]]:
    """Return the most likely step among the positions of a plan.

    Args:
        plan: plan with all possible positions of the step.
        values: successive values, oldest first, shape (length, n).
        sigmas: standard deviation of each component of the step, for each position, shape (k,).

    Returns:
        The step, shape (n,), the standard deviation of each component, and all possible numbers of values after the
        step.

    Example:
        >>> values = np.repeat([[0.0], [2.0]], [8, 4], axis=0)
        >>> step, sigma, counts = locate_step(step_plan(12, (3, 4, 5)), values, np.full(3, 1.0))
        >>> print(step.round(6), sigma, counts)
        [2.] 1.0 [3, 4, 5]
    """
    steps = plan.weights @ values
    likely = np.sum(steps * steps, axis=1) / sigmas**2
    best = int(np.argmax(likely))
    counts = [count for count, value in zip(plan.counts, likely, strict=True) if value >= likely[best] - _CHI2_MARGIN]
    return steps[best], float(sigmas[best]), counts


class Period:
    """Time between samples, the median of nine successive intervals.

    Attributes:
        ns: the period, ns; zero before the period is known.

    >>> period = Period()
    >>> [period.update(time_ns) for time_ns in (10, 20, 30, 40, 50, 80, 90, 100, 110, 120)][-2:]
    [0, 10]
    """

    def __init__(self) -> None:
        self.ns, self._last_ns = 0, 0
        self._intervals_ns: list[int] = []

    def update(self, time_ns: int) -> int:
        """Add the stamp of a sample; return the period, ns."""
        if self._last_ns:
            self._intervals_ns.append(time_ns - self._last_ns)
        self._last_ns = time_ns
        if len(self._intervals_ns) == _INTERVALS:
            self.ns = sorted(self._intervals_ns)[_INTERVALS // 2]
            self._intervals_ns.clear()
        return self.ns
