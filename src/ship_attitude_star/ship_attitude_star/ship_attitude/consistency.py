"""Consistency of the ship filter's state with its sources and with a stored state, for the recovery."""

from collections.abc import Mapping, Sequence, Set

from ship_attitude_star.ship_attitude.attitude_output import AttitudeOutput, ShipEstimator
from ship_attitude_star.ship_attitude.ins_input import InsInput
from ship_attitude_star.ship_attitude.memory import (
    is_consistent,
    largest_difference_sigmas,
    memory_residual,
    propagate_memory,
)
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_estimation.parameters.ins import InsJump
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.recoverable_core import Consistency
from ship_stars.samples.attitude_samples import AttitudeDecision


class ShipConsistency(Consistency[FilterState, InsJump]):
    """See :class:`Consistency`.

    Args:
        estimator: time-ordered estimator of the filter.
        output: published attitudes, with filter, configuration and sky model.
        ins: the INS samples.
    """

    def __init__(self, estimator: ShipEstimator, output: AttitudeOutput, ins: InsInput) -> None:
        super().__init__(ins.jumps)
        self._estimator, self._output, self._ins = estimator, output, ins

    @property
    def is_consistent(self) -> bool:
        """True if the state is based on stars, no source is excluded and all sources are consistent."""
        return is_consistent(self._output.filter, self._estimator.state, self._output.config.gate.degraded_after)

    @property
    def has_unresolved_fault(self) -> bool:
        """True if a fault is detected and not isolated, or UTC is not verified."""
        return self._estimator.state.unresolved_fault is not None or self._estimator.state.utc_step is not None

    def unused_sources(self, sources: Set[str]) -> set[str]:
        """Return those of ``sources`` that are devices of the filter without a recently accepted measurement."""
        devices, used_ns = self._output.filter.devices, self._estimator.state.last_used_ns
        since_ns = self._estimator.window.newest_ns - MAX_MEASUREMENT_AGE_NS
        return {name for name in sources if name in devices and used_ns.get(name, since_ns - 1) < since_ns}

    def propagate_memory(self, memory: FilterState, jumps: Sequence[InsJump]) -> FilterState:
        """Return a stored state propagated to the oldest time that measurements may still have."""
        return propagate_memory(self._output.filter, memory, jumps, self._estimator.window.oldest_ns)

    def memory_residuals(self, decision: AttitudeDecision, memory: FilterState) -> Mapping[str, MemoryResidual]:
        """Return the residual of a star measurement against a stored state; empty for other measurements."""
        measurement, filter_ = decision.measurement, self._output.filter
        if not filter_.devices[measurement.source].is_star:
            return {}
        residual = memory_residual(filter_, memory, measurement, self._ins.track, self._output.sky_model)
        return {} if residual is None else {measurement.source: residual}

    def largest_difference_sigmas(self, state: FilterState, memory: FilterState, is_later: bool = False) -> float:
        """Return the largest difference of a constant state from the stored state, in standard deviations."""
        return largest_difference_sigmas(self._output.filter, state, memory, is_later)
