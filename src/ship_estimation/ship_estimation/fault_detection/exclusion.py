"""Exclusion and reinstatement of sources, common to both estimators, and the state of fault detection.

:mod:`ship_estimation.fault_detection.isolation` finds the faulty source. The ship excludes it in
``ship_attitude/faults/source_exclusion`` (``ship_attitude_star``), the theodolite in ``filter/fault_detection``
(``theodolite_calib``); both call :meth:`SourceExclusion.exclude`. Only all stars together (``exclude_stars``) and an
INS whose clock steps (``faults/ins_fault_handling``) are excluded by the ship alone. :meth:`SourceExclusion.uses`
leaves an excluded source out of the filters.

The main filter does not use an excluded source, but monitors this source. The source is reinstated after a time of
consistency. By then the mounting is known, because it is unchanged or was estimated again after a mounting shift.

A step of a source is unconfirmed until other sources are consistent with this source at two different times. The
covariance is inflated for a step, so that the first measurement after the step determines the new value in any case.
Only a measurement at another time can confirm the step. A source that is frozen while the ship or the telescope
rotates, or whose axis does not follow, is consistent with the first measurement only. The very first measurement is
used with a prior that may be wide. This measurement is confirmed by the next consistent measurement at another time or
of another source.

States are immutable, so the time-ordered log can store states and go back to any of them.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.isolation import (
    CONSISTENT_RATIO,
    MAX_MEASUREMENT_AGE_NS,
    FaultIsolation,
    InnovationMeans,
    cleared_means,
    is_consistent_with_all,
    isolate_fault,
)
from ship_estimation.fault_detection.subfilters import SubfilterTable
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

__all__ = [
    "MAX_REMAINING_RATIO",
    "ExcludedSource",
    "FaultState",
    "SourceExclusion",
    "UnconfirmedStep",
    "UnresolvedFault",
    "evaluate_reinstatement",
    "reinstatement_time_s",
    "with_changes",
    "with_consistency",
    "with_entry",
    "without_entry",
]

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
        >>> from ship_estimation.fault_detection.isolation import initial_means
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


class UnconfirmedStep(NamedTuple):
    """A step that other sources have not confirmed yet.

    Attributes:
        since_ns: stamp after which measurements may confirm the step.
        why: text that names what is unconfirmed.
        confirming: text that names the confirming sources, for example stars or lights.
        confirmed_ns: stamp of the first consistent measurement; None before that measurement.
        confirmed_by: source of that measurement, if another source may confirm the step at the same time; empty if only
            another time counts.
    """

    since_ns: int
    why: str
    confirming: str
    confirmed_ns: int | None = None
    confirmed_by: str = ""

    def with_confirmation(self, time_ns: int, source: str = "") -> "UnconfirmedStep | None":
        """Return the step after a consistent measurement of a source; None if the step is confirmed now.

        >>> step = UnconfirmedStep(10, "the encoders have jumped", "lights")
        >>> step.with_confirmation(10) is step, step.with_confirmation(20).confirmed_ns
        (True, 20)
        >>> step.with_confirmation(20).with_confirmation(30) is None
        True

        Another source may confirm the step at the same time:

        >>> first = UnconfirmedStep(9, "one exposure alone", "stars", confirmed_ns=10, confirmed_by="star.fore")
        >>> first.with_confirmation(10, "star.fore") is first, first.with_confirmation(10, "star.aft")
        (True, None)
        """
        is_other_source = self.confirmed_by not in ("", source)
        if time_ns <= self.since_ns or (time_ns == self.confirmed_ns and not is_other_source):
            return self
        return self._replace(confirmed_ns=time_ns) if self.confirmed_ns is None else None

    @property
    def text(self) -> str:
        """Text of an unconfirmed step."""
        of = "another time or sensor" if self.confirmed_by else "two different times"
        return f"{self.why}; confirmation by {self.confirming} of {of} is pending"


Value = TypeVar("Value")

if TYPE_CHECKING:
    from dataclasses import replace as with_changes
else:

    def with_changes(of, **fields):
        """Return a copy of a frozen dataclass with some fields replaced.

        The function takes a fifth of the time of ``dataclasses.replace``, because ``__init__`` and ``__post_init__``
        are not called. A filter step replaces fields several times.

        Example:
            >>> with_changes(UnresolvedFault("a contradiction", None), consistent_since_ns=5).consistent_since_ns
            5
        """
        after = object.__new__(type(of))
        after.__dict__.update(of.__dict__, **fields)
        return after


@dataclass(frozen=True)
class UnresolvedFault:
    """A fault that is detected and not isolated.

    Attributes:
        text: description for the user.
        covariance_n: covariance that an output adds for the contradiction; rotation vector in the horizon frame, rad²,
            shape (3, 3).
        is_persistent: False for a contradiction that ends with the next accepted measurement.
        consistent_since_ns: stamp since which measurements have been accepted without a detected fault; None before
            that, and after a gap in the measurements.
    """

    text: str
    covariance_n: FloatArray
    is_persistent: bool = True
    consistent_since_ns: int | None = None


@dataclass(frozen=True, kw_only=True)
class FaultState:
    """State of fault detection, for h filters and s measured sources.

    Attributes:
        innovation_means: windowed innovation means of each source in each filter.
        excluded: excluded sources by name.
        unresolved_fault: fault that is detected and not isolated; None without such a fault.
    """

    innovation_means: InnovationMeans
    excluded: Mapping[str, ExcludedSource] = field(default_factory=lambda: MappingProxyType({}))
    unresolved_fault: UnresolvedFault | None = None

    def in_use(self, sources: Sequence[str], time_ns: int) -> list[str]:
        """Return the sources, in the given order, that are not excluded and have measured recently."""
        received = zip(sources, self.innovation_means.last_measured_ns.tolist(), strict=True)
        since_ns = time_ns - MAX_MEASUREMENT_AGE_NS
        return [name for name, measured_ns in received if measured_ns >= since_ns and name not in self.excluded]


def with_entry(mapping: Mapping[str, Value], key: str, value: Value) -> MappingProxyType[str, Value]:
    """Return a copy of a mapping with one entry set.

    Example:
        >>> dict(with_entry({"ins": 1}, "star.fore", 2))
        {'ins': 1, 'star.fore': 2}
    """
    return MappingProxyType({**mapping, key: value})


def without_entry(mapping: Mapping[str, Value], key: str) -> MappingProxyType[str, Value]:
    """Return a copy of a mapping without one key.

    Example:
        >>> dict(without_entry({"ins": 1, "star.fore": 2}, "ins"))
        {'star.fore': 2}
    """
    return MappingProxyType({name: value for name, value in mapping.items() if name != key})


AnyState = TypeVar("AnyState", bound=FaultState)


class SourceExclusion:
    """Fault detection and exclusion for the sources of a table; the state is an argument of every method.

    Args:
        subfilters: table of the filters.
        threshold_sigmas: threshold of a solution separation, in standard deviations.
        gate: number of successive rejections after which a filter is inconsistent with a source.
        integrity: reinstatement time.

    Attributes:
        subfilters: table of the filters.
    """

    def __init__(
        self, subfilters: SubfilterTable, threshold_sigmas: float, gate: GateConfig, integrity: IntegrityConfig
    ) -> None:
        self.subfilters, self._threshold_sigmas = subfilters, threshold_sigmas
        self._degraded_after, self._return_after_s = gate.degraded_after, integrity.return_after_s

    def uses(self, state: FaultState) -> NDArray[np.bool_]:
        """Return a mask of the sources that each filter uses, shape (h, s)."""
        if not state.excluded:
            return self.subfilters.uses
        excluded = np.array([name in state.excluded for name in self.subfilters.sources], dtype=bool)
        used: NDArray[np.bool_] = self.subfilters.uses & ~excluded
        return used

    def candidates(self, state: FaultState) -> list[int]:
        """Return the subfilters that each exclude one source, which is not excluded yet."""
        names = self.subfilters.names
        return [row for row in self.subfilters.single_subfilters if names[row - 1] not in state.excluded]

    def is_consistent(self, state: FaultState, source: str) -> bool:
        """True if the main filter's innovations of a source are consistent."""
        return is_consistent_with_all(state.innovation_means, self._degraded_after, [self.subfilters.indices[source]])

    def isolate(
        self,
        state: FaultState,
        separation_sigmas: FloatArray,
        candidates: Sequence[int],
        time_ns: int,
        pairs: Sequence[int] = (),
    ) -> FaultIsolation:
        """Detect a fault and isolate it with :func:`~ship_estimation.fault_detection.isolation.isolate_fault`."""
        means, threshold, after = state.innovation_means, self._threshold_sigmas, self._degraded_after
        return isolate_fault(means, self.uses(state), separation_sigmas, threshold, candidates, time_ns, after, pairs)

    def exclude(self, state: AnyState, exclusions: Mapping[str, ExcludedSource], means: InnovationMeans) -> AnyState:
        """Return the state with further exclusions and other innovation means, which ends an unresolved fault."""
        excluded = MappingProxyType({**state.excluded, **exclusions})
        return with_changes(state, innovation_means=means, excluded=excluded, unresolved_fault=None)

    def restart_timers(self, state: AnyState, sources: Iterable[str], time_ns: int) -> AnyState:
        """Restart the reinstatement timers of measured sources, before their first measurement after a timeout.

        If all sources have timed out, the timers of other excluded sources and of an unresolved fault restart too.
        """
        measured_ns, since_ns = state.innovation_means.last_measured_ns, time_ns - MAX_MEASUREMENT_AGE_NS
        timed_out = {name for name in sources if measured_ns[self.subfilters.indices[name]] < since_ns}
        if not timed_out or not (state.excluded or state.unresolved_fault):
            return state
        restarted_ns = dict.fromkeys(timed_out & state.excluded.keys())
        unresolved_fault = state.unresolved_fault
        if measured_ns.max() < since_ns:
            others = [name for name in state.excluded if name not in self.subfilters.indices]
            running = [name for name in others if state.excluded[name].consistent_since_ns is not None]
            restarted_ns |= dict.fromkeys(running, time_ns)
            unresolved_fault = unresolved_fault and replace(unresolved_fault, consistent_since_ns=None)
        restarted = {
            name: replace(state.excluded[name], consistent_since_ns=since_ns) for name, since_ns in restarted_ns.items()
        }
        excluded = MappingProxyType({**state.excluded, **restarted})
        return with_changes(state, excluded=excluded, unresolved_fault=unresolved_fault)

    def reinstate(self, state: AnyState, sources: Collection[str]) -> AnyState:
        """Return the state with reinstated sources; the filters that use these sources again clear their means."""
        means = state.innovation_means
        for index in [self.subfilters.indices[name] for name in sources if name in self.subfilters.indices]:
            means = cleared_means(means, np.flatnonzero(self.subfilters.uses[:, index]).tolist(), [index])
        excluded = MappingProxyType({name: one for name, one in state.excluded.items() if name not in sources})
        return with_changes(state, innovation_means=means, excluded=excluded)
