"""Excluded sources, their monitoring and their reinstatement.

The main filter does not use an excluded source, but monitors this source. The source is reinstated after a time of
consistency. By then the mounting is known, because it is unchanged or was estimated again after a mounting shift.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

from ship_estimation.fault_detection.innovation_means import CONSISTENT_RATIO, InnovationMeans
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

_MOST_DOUBLINGS = 6

MAX_REMAINING_RATIO = 0.5
"""Maximum remaining offset ratio at which a source whose mounting did not shift is reinstated."""

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
            mounting is estimated again, and for a source without a measured attitude.
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


AnyExclusion = TypeVar("AnyExclusion", bound=ExcludedSource)


def evaluate_reinstatement(
    excluded: AnyExclusion,
    means: InnovationMeans,
    source: int,
    time_ns: int,
    return_after_s: float,
    measured_ratio: float = 0.0,
    is_observable: bool = True,
) -> tuple[AnyExclusion, bool]:
    """Return the state of an excluded source after one of its measurements, and True if it is reinstated.

    The source must be consistent for :func:`reinstatement_time_s`. If the source has an
    :attr:`ExcludedSource.offset`, at most half of the offset may remain. The fault must still be observable; it becomes
    unobservable as the covariance of the other sources grows.

    Args:
        excluded: state of the source before the measurement.
        means: innovation means with that measurement; the main filter no longer uses the source.
        source: index of the source.
        time_ns: stamp of the measurement.
        return_after_s: reinstatement time after the first exclusion, s.
        measured_ratio: share of the offset that remains in that measurement.
        is_observable: True if the fault would make that measurement inconsistent.

    Example:
        >>> from ship_estimation.fault_detection.innovation_means import initial_means
        >>> excluded = ExcludedSource(since_ns=0, consistent_since_ns=5 * SECOND_NS)
        >>> evaluate_reinstatement(excluded, initial_means(1, 1), 0, 70 * SECOND_NS, return_after_s=60.0)[1]
        True
    """
    # NaN is inconsistent.
    is_consistent = means.excess[0, source] <= CONSISTENT_RATIO and means.rejection_counts[0, source] == 0
    if excluded.offset is not None:
        # NaN counts as a gross error.
        measured_ratio = measured_ratio if abs(measured_ratio) < _MAX_OFFSET_RATIO else _MAX_OFFSET_RATIO
        change = (measured_ratio - excluded.remaining_offset_ratio) * 2.0 / (_RATIO_WINDOW + 1.0)
        remaining_ratio = excluded.remaining_offset_ratio + change
        excluded = replace(excluded, remaining_offset_ratio=remaining_ratio)
        is_consistent = is_consistent and remaining_ratio <= MAX_REMAINING_RATIO
    return with_consistency(excluded, bool(is_consistent and is_observable), time_ns, return_after_s)


def with_consistency(
    excluded: AnyExclusion, is_consistent: bool, time_ns: int, return_after_s: float
) -> tuple[AnyExclusion, bool]:
    """Return the excluded source after a test of its consistency, and True if it is reinstated.

    Example:
        >>> with_consistency(ExcludedSource(since_ns=0, consistent_since_ns=0), True, 30 * SECOND_NS, 30.0)[1]
        True
    """
    if not is_consistent:
        return replace(excluded, consistent_since_ns=None), False
    since_ns = time_ns if excluded.consistent_since_ns is None else excluded.consistent_since_ns
    is_reinstated = (time_ns - since_ns) / SECOND_NS >= reinstatement_time_s(excluded, return_after_s)
    return replace(excluded, consistent_since_ns=since_ns), is_reinstated


def reinstatement_time_s(excluded: ExcludedSource, return_after_s: float) -> float:
    """Return the time for which an excluded source must be consistent before it is reinstated, s.

    Example:
        >>> reinstatement_time_s(ExcludedSource(since_ns=0, exclusion_count=3), return_after_s=60.0)
        240.0
    """
    return return_after_s * 2.0 ** min(excluded.exclusion_count - 1, _MOST_DOUBLINGS)
