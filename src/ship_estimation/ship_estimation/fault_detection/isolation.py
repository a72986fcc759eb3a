"""Isolation of a faulty source by windowed innovation means.

The main filter and every subfilter compute innovations for the measurements of every source. If a filter is fault-free
and uses a source, the whitened innovations of that source have zero mean and unit covariance, and are independent of
one another. Exponential means of these innovations over few measurements show a mounting shift within three
measurements. The means over many measurements show a drift.

A fault is detected if the main filter is inconsistent with a source, or if a solution separation exceeds its threshold.
A source is isolated as faulty if the subfilter without this source is consistent with all sources that the subfilter
uses. It is then excluded by :mod:`ship_estimation.fault_detection.exclusion`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_geometry.earth.time_scales import NEVER_NS, SECOND_NS
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

MAX_MEASUREMENT_AGE_NS = 10 * SECOND_NS
"""Maximum age of a source's last measurement for it to count in fault isolation, ns."""

_CHI2_MARGIN = 0.6
"""Minimum margin of an isolation: the largest excess of every other subfilter must be larger by at least this margin.

The excess is the ratio of chi² of an innovation mean to its limit. With the usual limits the margin is a likelihood
ratio of 75 000. A drifting source is tested at hundreds of measurements before it is isolated. With a likelihood ratio
of 2 000 a healthy sensor was therefore excluded in six of 40 voyages."""

_SEPARATION_RATIO = 1.3
"""Minimum ratio of the largest solution separation to the second largest if no innovation isolates the fault."""


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


@dataclass(frozen=True)
class FaultIsolation:
    """Result of fault detection and isolation.

    Attributes:
        is_detected: True if a fault is detected.
        subfilter: index of the subfilter that isolates the fault; None if no subfilter explains the fault, or none of
            several is clearly the best.
        explaining_subfilters: all tested subfilters that explain the fault, the best first.
    """

    is_detected: bool
    subfilter: int | None = None
    explaining_subfilters: tuple[int, ...] = ()


_NO_FAULT = FaultIsolation(is_detected=False)


def isolate_fault(
    means: InnovationMeans,
    uses: NDArray[np.bool_],
    separations: FloatArray,
    threshold: float,
    candidates: Sequence[int],
    now_ns: int,
    degraded_after: int = 3,
    larger_subfilters: Sequence[int] = (),
) -> FaultIsolation:
    """Detect a fault and isolate the faulty source, or two faulty sources.

    Args:
        means: windowed innovation means of every filter and source.
        uses: True for each source that a filter uses, shape (h, s).
        separations: largest solution separation of each subfilter, sigmas, shape (h,); 0 for the main filter.
        threshold: largest separation without a fault, sigmas.
        candidates: subfilters that may explain a fault, in order of preference.
        now_ns: present time.
        degraded_after: number of successive rejections after which a filter is inconsistent with a source.
        larger_subfilters: subfilters that exclude a candidate's source and a second source. Such a subfilter explains
            every fault that the candidate explains. The larger subfilter is therefore tested only if all candidates are
            inconsistent, or if its separation is clearly the largest.

    Example:
        The three filters use both sources, only the second and only the first. Every filter that uses the first source
        is inconsistent with that source, so the first source is faulty:

        >>> excess, measured_ns = np.array([[2.0, 0.1], [9.0, 0.1], [2.0, 0.1]]), np.zeros(2, dtype=int)
        >>> means = replace(initial_means(3, 2), excess=excess, last_measured_ns=measured_ns)
        >>> uses = np.array([[True, True], [False, True], [True, False]])

        >>> isolate_fault(means, uses, np.array([0.0, 4.0, 1.0]), 5.0, [1, 2], now_ns=0)
        FaultIsolation(is_detected=True, subfilter=1, explaining_subfilters=(1,))
    """
    is_recent = means.last_measured_ns >= now_ns - MAX_MEASUREMENT_AGE_NS
    counts = uses & is_recent
    is_main_consistent = is_consistent_with_all(means, degraded_after, counts[0])
    sigmas = separations.tolist()
    if is_main_consistent and all(sigmas[row] <= threshold for row in (*candidates, *larger_subfilters)):  # NaN exceeds
        return _NO_FAULT
    contradicted = np.where(means.rejection_counts >= degraded_after, np.maximum(means.excess, 2.0), means.excess)
    worst = np.max(np.where(counts, contradicted, 0.0), axis=-1, initial=0.0)
    # A subfilter explains a fault if it is consistent with all its sources, each measured since the fault began.
    began_ns = np.max(means.inconsistent_since_ns, initial=NEVER_NS, where=is_recent)
    is_consistent = (
        (means.excess <= CONSISTENT_RATIO) & (means.rejection_counts == 0) & (means.last_measured_ns >= began_ns)
    )
    explains = np.all(is_consistent | ~counts, axis=-1)
    tested = larger_subfilters if larger_subfilters and not np.any(worst[candidates] <= 1.0) else candidates
    explaining = sorted((row for row in tested if explains[row]), key=lambda row: worst[row])
    if not explaining:
        return FaultIsolation(is_detected=True)
    best = explaining[0]
    if all(not worst[row] < worst[best] + _CHI2_MARGIN for row in tested if row != best):
        return FaultIsolation(is_detected=True, subfilter=best, explaining_subfilters=tuple(explaining))
    row = None
    # After a rejection the main filter lacks data that the subfilters used, so separations do not indicate a fault.
    if is_main_consistent and len(explaining) > 1 and not (means.rejection_counts[0] * counts[0]).any():
        with_larger = [*explaining, *(row for row in larger_subfilters if explains[row])]
        row = _largest_separation(with_larger, separations, threshold) or _largest_separation(
            explaining, separations, threshold
        )
    return FaultIsolation(is_detected=True, subfilter=row, explaining_subfilters=tuple(explaining))


def is_consistent_with_all(
    means: InnovationMeans, degraded_after: int, tested: NDArray[np.bool_] | list[int] | slice = slice(None)
) -> bool:
    """True if the main filter is consistent with every tested source, by the criterion of :func:`isolate_fault`.

    Example:
        >>> is_consistent_with_all(initial_means(subfilters=3, sources=2), degraded_after=3)
        True
    """
    by_source = zip(means.excess[0, tested].tolist(), means.rejection_counts[0, tested].tolist(), strict=True)
    return all(excess <= 1.0 and rejected < degraded_after for excess, rejected in by_source)  # NaN is inconsistent


def _largest_separation(rows: Sequence[int], statistic: FloatArray, threshold: float) -> int | None:
    """Return the subfilter whose separation exceeds the threshold and is clearly the largest; otherwise None."""
    farthest, second = sorted(rows, key=lambda row: -statistic[row])[:2]
    clear = statistic[farthest] > max(threshold, _SEPARATION_RATIO * statistic[second])
    return farthest if clear else None
