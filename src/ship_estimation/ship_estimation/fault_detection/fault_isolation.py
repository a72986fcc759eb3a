"""Isolation of a faulty source, its exclusion and its reinstatement.

Every subfilter (:mod:`ship_estimation.fault_detection.subfilters`) computes innovations for the measurements of every
source. Windowed innovation means (:mod:`ship_estimation.fault_detection.innovation_means`) show how consistent a filter
is with each source. A fault is detected if the main filter is inconsistent with a source, or if a solution separation
exceeds its threshold. A source is isolated as faulty if the subfilter without this source is consistent with all
sources that the subfilter uses.

The main filter does not use an excluded source, but monitors this source. The source is reinstated after a time of
consistency. By then the mounting is known, because it is unchanged or was estimated again after a mounting shift.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.innovation_means import CONSISTENT_RATIO, NEVER_NS, InnovationMeans
from ship_geometry.earth.time_scales import SECOND_NS
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

_MOST_DOUBLINGS = 6

_MAX_REMAINING_RATIO = 0.5
"""Maximum remaining offset ratio at which a source whose mounting did not shift is reinstated."""

_DRIFT_SIGMAS = 3.0
"""Minimum size of half of the offset for a reinstatement, in standard deviations of the error of the other sources. A
smaller offset is not observable, because an INS without stars may itself have drifted by half of the offset."""

_RATIO_WINDOW = 20
"""Number of measurements over which the remaining offset ratio is averaged, because a single ratio is noisy."""

_MAX_OFFSET_RATIO = 2.0
"""Bound of the measured offset ratio: one gross error delays a reinstatement by some measurements only."""


@dataclass(frozen=True)
class ExcludedSource:
    """State of an excluded source.

    Attributes:
        since_ns: stamp of the measurement that led to the exclusion.
        exclusion_count: number of exclusions of this source, this one included. Each exclusion after the first doubles
            the reinstatement time, up to a factor of 64.
        consistent_since_ns: stamp since which the source has been consistent with the other sources; None if it is
            inconsistent.
        offset: rotation vector from the attitude by the other sources to the measured attitude at the exclusion, rad,
            shape (3,), in the device frame. At most half of the offset may remain at the reinstatement. None if the
            mounting is estimated again, and for an INS.
        remaining_offset_ratio: share of ``offset`` that remains, mean over some measurements.
        growing_since_ns: stamp since which the offset is much larger than at the exclusion, in the same direction; None
            if the offset has not grown.
        is_shared: True if all star sensors were excluded together, for an error that they may share.
        is_self_reported: True if only the source itself has reported the fault and no other source has contradicted the
            source.
    """

    since_ns: int
    exclusion_count: int = 1
    consistent_since_ns: int | None = None
    offset: FloatArray | None = None
    remaining_offset_ratio: float = 1.0
    growing_since_ns: int | None = None
    is_shared: bool = False
    is_self_reported: bool = False


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

        >>> from ship_estimation.fault_detection.innovation_means import initial_means
        >>> excess, measured_ns = np.array([[2.0, 0.1], [9.0, 0.1], [2.0, 0.1]]), np.zeros(2, dtype=int)
        >>> means = replace(initial_means(3, 2), excess=excess, last_measured_ns=measured_ns)
        >>> uses = np.array([[True, True], [False, True], [True, False]])

        >>> isolate_fault(means, uses, np.array([0.0, 4.0, 1.0]), 5.0, [1, 2], now_ns=0)
        FaultIsolation(is_detected=True, subfilter=1, explaining_subfilters=(1,))
    """
    is_main_consistent = _is_main_filter_consistent(means, uses[0], now_ns - MAX_MEASUREMENT_AGE_NS, degraded_after)
    sigmas = separations.tolist()
    if is_main_consistent and all(sigmas[row] <= threshold for row in (*candidates, *larger_subfilters)):  # NaN exceeds
        return _NO_FAULT
    is_recent = means.last_measured_ns >= now_ns - MAX_MEASUREMENT_AGE_NS
    counts = uses & is_recent
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


def is_consistent_with_all(means: InnovationMeans, degraded_after: int) -> bool:
    """True if the main filter is consistent with every source, by the criterion of :func:`isolate_fault`.

    Example:
        >>> from ship_estimation.fault_detection.innovation_means import initial_means
        >>> is_consistent_with_all(initial_means(subfilters=3, sources=2), degraded_after=3)
        True
    """
    by_source = zip(means.excess[0].tolist(), means.rejection_counts[0].tolist(), strict=True)
    return all(excess <= 1.0 and rejected < degraded_after for excess, rejected in by_source)  # NaN is inconsistent


def _is_main_filter_consistent(
    means: InnovationMeans, uses: NDArray[np.bool_], since_ns: int, degraded_after: int
) -> bool:
    """True if the main filter is consistent with all sources that it uses and that were measured since a stamp."""
    by_source = zip(
        means.excess[0].tolist(),
        means.rejection_counts[0].tolist(),
        means.last_measured_ns.tolist(),
        uses.tolist(),
        strict=True,
    )
    # NaN is inconsistent.
    return all(
        excess <= 1.0 and rejected < degraded_after
        for excess, rejected, measured_ns, used in by_source
        if used and measured_ns >= since_ns
    )


def _largest_separation(rows: Sequence[int], statistic: FloatArray, threshold: float) -> int | None:
    """Return the subfilter whose separation exceeds the threshold and is clearly the largest; otherwise None."""
    farthest, second = sorted(rows, key=lambda row: -statistic[row])[:2]
    clear = statistic[farthest] > max(threshold, _SEPARATION_RATIO * statistic[second])
    return farthest if clear else None


def evaluate_reinstatement(
    excluded: ExcludedSource,
    means: InnovationMeans,
    source: int,
    time_ns: int,
    return_after_s: float,
    measured_ratio: float = 0.0,
    ratio_sigma: float = 0.0,
) -> tuple[ExcludedSource, bool]:
    """Return the state of an excluded source after one of its measurements, and True if it is reinstated.

    The source must be consistent for :func:`reinstatement_time_s`. If the source has an :attr:`ExcludedSource.offset`,
    at most half of the offset may remain, and the offset must still be observable. The offset becomes unobservable as
    the covariance of the other sources grows during the exclusion.

    Args:
        excluded: state of the source before the measurement.
        means: innovation means with that measurement; the main filter no longer uses the source.
        source: index of the source.
        time_ns: stamp of the measurement.
        return_after_s: reinstatement time after the first exclusion, s.
        measured_ratio: share of :attr:`ExcludedSource.offset` that remains in that measurement.
        ratio_sigma: standard deviation of that ratio from the error of the other sources, without measurement noise.

    Example:
        >>> from ship_estimation.fault_detection.innovation_means import initial_means
        >>> excluded = ExcludedSource(since_ns=0, consistent_since_ns=5 * SECOND_NS)
        >>> evaluate_reinstatement(excluded, initial_means(1, 1), 0, 70 * SECOND_NS, return_after_s=60.0)[1]
        True
    """
    is_consistent = (
        means.excess[0, source] <= CONSISTENT_RATIO and means.rejection_counts[0, source] == 0
    )  # NaN is inconsistent
    if excluded.offset is not None:
        measured_ratio = (
            measured_ratio if abs(measured_ratio) < _MAX_OFFSET_RATIO else _MAX_OFFSET_RATIO
        )  # NaN counts as a gross error
        remaining_ratio = excluded.remaining_offset_ratio + (measured_ratio - excluded.remaining_offset_ratio) * 2.0 / (
            _RATIO_WINDOW + 1.0
        )
        excluded = replace(excluded, remaining_offset_ratio=remaining_ratio)
        is_observable = _DRIFT_SIGMAS * ratio_sigma <= _MAX_REMAINING_RATIO
        is_consistent = is_consistent and remaining_ratio <= _MAX_REMAINING_RATIO and is_observable
    if not is_consistent:
        return replace(excluded, consistent_since_ns=None), False
    since_ns = time_ns if excluded.consistent_since_ns is None else excluded.consistent_since_ns
    return replace(excluded, consistent_since_ns=since_ns), (time_ns - since_ns) / SECOND_NS >= reinstatement_time_s(
        excluded, return_after_s
    )


def reinstatement_time_s(excluded: ExcludedSource, return_after_s: float) -> float:
    """Return the time for which an excluded source must be consistent before it is reinstated, s.

    Example:
        >>> reinstatement_time_s(ExcludedSource(since_ns=0, exclusion_count=3), return_after_s=60.0)
        240.0
    """
    return return_after_s * 2.0 ** min(excluded.exclusion_count - 1, _MOST_DOUBLINGS)
