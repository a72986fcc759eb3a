"""Restart of the ship filter from a stored state, and comparison of measurements with a stored state.

The recovery rules in :mod:`ship_estimation.recovery` use these functions.
"""

import numpy as np

from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.prediction import NotEvaluable
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.fault_state import with_changes
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_stars.sky.sky_model import SkyModel

_OBSERVABLE_RAD = 0.02
"""A measurement observes the rotation of its device if its sigma about every axis is at most this, rad."""


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
    expected, drift = (
        by_state @ state.covariance @ by_state.T,
        by_state @ _growth_per_second(filter_, state) @ by_state.T,
    )
    return MemoryResidual(to_rotation @ linear.residual, noise_n, expected, drift)


def _growth_per_second(filter_: ShipFilter, state: FilterState) -> np.ndarray:
    """Return the covariance that one second of process noise adds, shape (n, n)."""
    assert state.time_ns is not None
    before_ns = state.time_ns - SECOND_NS
    here = None if filter_.vertical is None else filter_.vertical.at(before_ns)
    before = with_changes(state, time_ns=before_ns, vertical=here, stack=np.zeros_like(state.stack))
    return filter_.propagate(before, state.time_ns).covariance
