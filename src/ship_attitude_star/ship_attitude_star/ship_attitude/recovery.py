"""Recovery of the ship filter: restart from a stored state, and consistency of a state with sources and stored state.

The rules of the recovery are in :mod:`ship_estimation.recovery`.
"""

import math
from collections.abc import Mapping, Sequence, Set

import numpy as np

from ship_attitude_star.ship_attitude.attitude_output import AttitudeOutput, ShipEstimator
from ship_attitude_star.ship_attitude.corrected_ins import newest_star_ns
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.ins_input import InsInput
from ship_attitude_star.ship_attitude.measurements.prediction import NotEvaluable
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.exclusion import with_changes
from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_estimation.plausibility.checked_ins import InsJump
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.recoverable_core import Consistency
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_stars.attitude_samples import AttitudeDecision
from ship_stars.sky.sky_model import SkyModel

_OBSERVABLE_RAD = 0.02
"""A measurement observes the rotation of its device if its sigma about every axis is at most this, rad."""

_CONSTANT_STATES = (".installation", ".time_offset", ".optics", "ins.attitude")
"""Endings of the names of the states that are compared with a stored state; all other states vary within minutes."""


def start_from_memory(filter_: ShipFilter, memory: FilterState, live: FilterState) -> FilterState:
    """Return a start state with the stored errors and without later measurements and faults.

    Args:
        filter_: filter of the estimator.
        memory: the stored state.
        live: state of the estimator in use; its exclusion counts and INS fault time are kept.
    """
    return with_changes(
        filter_.fault_detector.initial_state(memory.mean, memory.covariance_by_source),
        time_ns=memory.time_ns,
        vertical=memory.vertical,
        common_n=memory.common_n,
        exclusion_counts=live.exclusion_counts,
        ins_fault_ns=live.ins_fault_ns,
    )


def memory_residual(
    filter_: ShipFilter, memory: FilterState, measurement: Measurement, track: AttitudeTrack, sky_model: SkyModel | None
) -> MemoryResidual | None:
    """Return the residual of a measurement against a stored state, as a rotation about North, Up and East.

    The result is None if the measurement is not evaluable or does not observe the full rotation of its device.
    """
    state = filter_.propagate(memory, measurement.time_ns)
    found = filter_.linearisation.linearise(measurement, state.mean, state.covariance, {}, track, sky_model)
    if found is None or isinstance(found, NotEvaluable):
        return None
    linear, rotation_jacobian = found.compared.linear, found.compared.rotation_jacobian
    weighted = np.linalg.solve(linear.noise, rotation_jacobian)
    information = rotation_jacobian.T @ weighted
    if not np.linalg.eigvalsh(information)[0] >= _OBSERVABLE_RAD**-2:
        return None
    noise_v = np.linalg.inv(information)
    to_rotation = found.compared.predicted_nv @ noise_v @ weighted.T
    by_state = to_rotation @ linear.jacobian
    noise_n = found.compared.predicted_nv @ noise_v @ found.compared.predicted_nv.T
    expected = by_state @ state.covariance @ by_state.T
    drift = by_state @ _growth_per_second(filter_, state) @ by_state.T
    return MemoryResidual(to_rotation @ linear.residual, noise_n, expected, drift)


def _growth_per_second(filter_: ShipFilter, state: FilterState) -> np.ndarray:
    """Return the covariance that one second of process noise adds, shape (n, n)."""
    assert state.time_ns is not None
    before_ns = state.time_ns - SECOND_NS
    here = None if filter_.vertical is None else filter_.vertical.at(before_ns)
    before = with_changes(state, time_ns=before_ns, vertical=here, stack=np.zeros_like(state.stack))
    return filter_.propagate(before, state.time_ns).covariance


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
        """True if the state is based on stars, no source is inconsistent or excluded, and no fault is unresolved."""
        state = self._estimator.state
        is_unresolved = self.has_unresolved_fault or state.separation_covariance_n is not None
        if is_unresolved or state.excluded or state.unconfirmed_step is not None:
            return False
        most_rejections = max(state.consecutive_rejections.values(), default=0)
        has_stars = newest_star_ns(self._output.filter, state) is not None
        return has_stars and most_rejections < self._output.config.gate.degraded_after

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
        """Return a stored state inflated for jumps, at the oldest time that measurements may still have."""
        for jump in jumps:
            memory = self._output.filter.apply_ins_change(memory, jump)
        return self._output.filter.propagate(memory, self._estimator.window.oldest_ns)

    def memory_residuals(self, decision: AttitudeDecision, memory: FilterState) -> Mapping[str, MemoryResidual]:
        """Return the residual of a star measurement against a stored state; empty for other measurements."""
        measurement, filter_ = decision.measurement, self._output.filter
        if not filter_.devices[measurement.source].is_star:
            return {}
        residual = memory_residual(filter_, memory, measurement, self._ins.track, self._output.sky_model)
        return {} if residual is None else {measurement.source: residual}

    def largest_difference_sigmas(self, state: FilterState, memory: FilterState, is_later: bool = False) -> float:
        """Return the largest difference between the constant elements of two filter states, in standard deviations.

        The result is infinite if ``state`` is from before the first measurement. The variance of the difference is the
        sum of both variances if the two states are independent. A later state of the same estimator contains the
        information of the stored state, whose variance is then used alone.
        """
        if state.time_ns is None:
            return math.inf
        memory, model = self._output.filter.propagate(memory, state.time_ns), self._output.filter.model
        rows = np.concatenate([model.state_indices(name) for name in model.slices if name.endswith(_CONSTANT_STATES)])
        variance = memory.covariance.diagonal()[rows] + (0.0 if is_later else state.covariance.diagonal()[rows])
        difference = np.abs(state.mean - memory.mean)[rows]
        # States that are known exactly are not compared; a state with a variance of NaN is compared.
        varies = variance != 0.0
        return float(np.max(difference[varies] / np.sqrt(variance[varies]), initial=0.0))
