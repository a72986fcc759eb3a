"""Isolation of a faulty source.

Every subfilter computes innovations for the measurements of every source. Windowed innovation means
(:mod:`ship_estimation.fault_detection.innovation_means`) show how consistent a filter is with each source. A fault is
detected if the main filter is inconsistent with a source, or if a solution separation exceeds its threshold. A source
is isolated as faulty if the subfilter without this source is consistent with all sources that the subfilter uses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.innovation_means import CONSISTENT_RATIO, InnovationMeans
from ship_geometry.earth.time_scales import NEVER_NS, SECOND_NS
from ship_geometry.rotations import FloatArray

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

        >>> from dataclasses import replace
        >>> from ship_estimation.fault_detection.innovation_means import initial_means
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
        >>> from ship_estimation.fault_detection.innovation_means import initial_means
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
