"""Fault detector: isolation, exclusion and reinstatement of the sources of a table."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.exclusions import ExcludedSource
from ship_estimation.fault_detection.fault_state import FaultState, with_changes
from ship_estimation.fault_detection.innovation_means import InnovationMeans, cleared_means
from ship_estimation.fault_detection.isolation import (
    MAX_MEASUREMENT_AGE_NS,
    FaultIsolation,
    is_consistent_with_all,
    isolate_fault,
)
from ship_estimation.fault_detection.subfilter_table import SubfilterTable
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_geometry.rotations import FloatArray

AnyState = TypeVar("AnyState", bound=FaultState)


class FaultDetector:
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
