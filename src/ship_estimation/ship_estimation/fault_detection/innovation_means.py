"""Windowed innovation means, which show the consistency of every filter with every source.

The main filter and every subfilter compute innovations for every source. If a filter is fault-free and uses a source,
the whitened innovations of that source have zero mean and unit covariance, and are independent of one another.
Exponential means of these innovations over few measurements show a mounting shift within three measurements. The means
over many measurements show a drift. :mod:`ship_estimation.fault_detection.isolation` isolates the faulty source.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_geometry.earth.time_scales import NEVER_NS
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_innovations

WINDOW_LENGTHS = (3, 30, 300)
"""Window lengths of the means of whitened innovations, measurements."""

MEASUREMENTS_PER_H = 18_000
"""Assumed number of measurements of one source in an hour (5 Hz), for the probability of a false exclusion."""

CONSISTENT_RATIO = 0.5
"""Share of the chi² limit below which a source counts as consistent."""

FIELDS_BY_SUBFILTER = ("running", "excess", "rejection_counts")
"""Fields of :class:`InnovationMeans` with one row for each filter."""

_MAX_INNOVATION_RATIO = math.sqrt(0.5)
"""Bound of a whitened innovation, as a share of the square root of the chi² limit.

The mean over three measurements stays below its limit after two successive gross errors, and exceeds it after three."""

_WINDOW_WEIGHTS = np.array([2.0 / (count + 1.0) for count in WINDOW_LENGTHS])
"""Weight of a measurement in each mean, shape (w,)."""

_ZERO_NOISE = np.zeros((3, 3))

INITIAL_MEANS = np.zeros((len(WINDOW_LENGTHS), 5))
"""Windowed means of one filter and source before any measurement, as in :attr:`InnovationMeans.running`."""


@dataclass(frozen=True)
class InnovationMeans:
    """Windowed means of whitened innovations, for h filters, s sources and w window lengths.

    Attributes:
        running: shape (h, s, w, 5). Columns 0 to 2 are the mean innovation. Column 3 is the filled share of the window,
            0 at the start, soon 1. Column 4 is the variance of the mean if the innovations are independent and have
            variance 1.
        excess: largest ratio of chi² to its limit among the w means, shape (h, s). The value of a subfilter is not used
            for the source that this subfilter excludes.
        rejection_counts: number of successive rejections, shape (h, s).
        last_measured_ns: stamp of the last measurement of each source, shape (s,).
        inconsistent_since_ns: stamp since which the excess of each source in the main filter exceeds
            :data:`CONSISTENT_RATIO`, or its measurements are rejected, shape (s,); ``NEVER_NS`` otherwise.
    """

    running: FloatArray
    excess: FloatArray
    rejection_counts: NDArray[np.int64]
    last_measured_ns: NDArray[np.int64]
    inconsistent_since_ns: NDArray[np.int64]


def initial_means(subfilters: int, sources: int) -> InnovationMeans:
    """Return the innovation means before any measurement.

    Example:
        >>> initial_means(subfilters=3, sources=2).running.shape
        (3, 2, 3, 5)
    """
    return InnovationMeans(
        running=np.zeros((subfilters, sources, len(WINDOW_LENGTHS), 5)),
        excess=np.zeros((subfilters, sources)),
        rejection_counts=np.zeros((subfilters, sources), dtype=np.int64),
        last_measured_ns=np.full(sources, NEVER_NS),
        inconsistent_since_ns=np.full(sources, NEVER_NS),
    )


def excess_limit(config: IntegrityConfig, sources: int) -> float:
    """Return the chi² limit of an innovation mean, for half of the configured rate of false exclusions.

    The limit counts one value in N of a mean over N measurements as independent.

    Example:
        >>> print(round(excess_limit(IntegrityConfig(), sources=2), 1))
        37.4
    """
    tests_per_h = sources * MEASUREMENTS_PER_H * sum(1.0 / count for count in WINDOW_LENGTHS)
    return chi_square_gate(1.0 - 0.5 * config.false_exclusions_per_h / tests_per_h, 3)


def updated_means(
    means: InnovationMeans,
    source: int | Sequence[int],
    innovation: FloatArray,
    accepted: NDArray[np.bool_],
    time_ns: int,
    limit: float,
    whitened_noise: FloatArray | None = None,
) -> InnovationMeans:
    """Return the means after a measurement, or after simultaneous measurements of several sources.

    Args:
        means: means before the measurement.
        source: index of the source, or indices of l sources.
        innovation: whitened innovation in every filter, shape (h, 3), or (h, l, 3) for l sources.
        accepted: True for each filter whose gate the NIS passed, shape (h,), or (h, l) for l sources.
        time_ns: stamp of the measurement.
        limit: chi² limit (:func:`excess_limit`).
        whitened_noise: covariance of the whitened innovation from the measurement noise alone, shape (3, 3), if the
            main filter does not use the source; None if it does.

    Example:
        Innovations of three sigmas in the same direction exceed the limit after a few measurements:

        >>> found, innovation = initial_means(1, 1), np.array([[3.0, 0.0, 0.0]])
        >>> for number in range(8):
        ...     found = updated_means(found, 0, innovation, np.array([True]), number, limit=37.4)
        ...     if found.excess[0, 0] > 1.0: break
        >>> number
        4
    """
    if isinstance(source, int):
        source, innovation, accepted = (source,), innovation[:, None], accepted[:, None]
    after = compiled_innovations.updated_means(
        means.running,
        means.excess,
        means.rejection_counts,
        means.last_measured_ns,
        means.inconsistent_since_ns,
        tuple(source),
        innovation,
        accepted.view(np.uint8),
        time_ns,
        _WINDOW_WEIGHTS,
        limit,
        _MAX_INNOVATION_RATIO * math.sqrt(limit),
        CONSISTENT_RATIO,
        NEVER_NS,
        whitened_noise is not None,
        _ZERO_NOISE if whitened_noise is None else whitened_noise,
    )
    if after is not None:
        return InnovationMeans(*after)
    # An innovation of NaN does not enter the means and counts as a rejection.
    rejection_counts = means.rejection_counts.copy()
    rejection_counts[:, list(source)] += 1
    return replace(means, rejection_counts=rejection_counts)


def updated_mean(running: FloatArray, innovation: FloatArray) -> tuple[FloatArray, float]:
    """Return the windowed means of one filter and source after one more innovation, and the largest, in sigmas.

    The largest is taken over all components and window lengths.

    Args:
        running: means of that filter and source before the innovation, as in :attr:`InnovationMeans.running`,
            shape (w, 5).
        innovation: whitened innovation, shape (3,).

    Example:
        >>> running, sigmas = updated_mean(INITIAL_MEANS, np.array([0.0, 4.0, 1.0]))
        >>> print(running[0], round(sigmas, 6))
        [0.   2.   0.5  0.5  0.25] 4.0
    """
    after: tuple[FloatArray, float] = compiled_innovations.updated_mean(running, innovation, _WINDOW_WEIGHTS)
    return after


def cleared_means(
    means: InnovationMeans, subfilters: Sequence[int] | slice, sources: Sequence[int] | slice
) -> InnovationMeans:
    """Return the means with all values of some filters and sources set to zero; the stamps stay.

    Example:
        >>> means = replace(initial_means(2, 2), rejection_counts=np.array([[1, 2], [3, 4]]))
        >>> cleared_means(means, slice(None), [1]).rejection_counts.tolist()
        [[1, 0], [3, 0]]
    """
    cleared = {}
    for name in FIELDS_BY_SUBFILTER:
        values = getattr(means, name).copy()
        values[subfilters, sources] = 0
        cleared[name] = values
    return replace(means, **cleared)
