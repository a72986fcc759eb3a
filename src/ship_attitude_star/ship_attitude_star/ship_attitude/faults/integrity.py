"""Protection levels of heading, pitch and roll of the ship.

Protection levels bound the error in the presence of an undetected fault. The levels are computed from the solution
separations of the subfilters (:mod:`ship_attitude_star.ship_attitude.faults.fault_detection`) by
:mod:`ship_estimation.integrity.protection_levels`.
"""

import numpy as np

from ship_attitude_star.ins_errors.process import own_error_matrix
from ship_attitude_star.ship_attitude.config import GEODETIC, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.faults.subfilter_set import ALL_STARS, INS
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.common_error import with_common_error
from ship_estimation.integrity.protection_levels import IntegrityReport, integrity_report, protection_levels
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import FloatArray
from ship_stars.samples.attitude_samples import AttitudeEstimate

QUANTITIES = ("heading", "pitch", "roll")
"""Quantities with a protection level."""


def integrity_of(filter_: ShipFilter, config: ShipAttitudeConfig, estimate: AttitudeEstimate) -> IntegrityReport:
    """Return protection levels, solution separations and exclusions of an attitude.

    Args:
        filter_: filter and model.
        config: configuration of the node.
        estimate: the attitude, with its filter state.
    """
    state, subfilters = estimate.state, filter_.fault_detector.subfilters
    relevant = subfilters.relevant_hypotheses(estimate.sources, state.excluded)
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd).tolist()
    to_angles, source_count = angle_errors_from_rotation_vector(heading, pitch), len(state.stack) - len(state.means) + 1
    means, stack = relative_to_horizon(filter_, config, state, estimate.time_ns)
    # The covariance is without the inflation for large separations, because the levels contain the separations.
    found = protection_levels(
        subfilters.k,
        relevant.indices,
        filter_.model.state_indices("ins.attitude"),
        (to_angles, to_angles, estimate.covariance_without_separation_n),
        means[0],
        means[1:],
        stack[:source_count],
        stack[source_count:],
    )
    names = relevant.names
    if INS not in state.excluded and relevant.is_cross_checked:
        angle_covariance = to_angles @ estimate.covariance_without_separation_n @ to_angles.T
        found = with_common_error(
            found,
            subfilters.k,
            subfilters.common_k_md,
            subfilters.common_threshold,
            state.correction_sums,
            to_angles,
            angle_covariance,
        )
        names = *names, ALL_STARS
    excluded = tuple(sorted((name, exclusion.since_ns) for name, exclusion in state.excluded.items()))
    has_unresolved_fault = (
        state.unresolved_fault is not None or state.unconfirmed_step is not None or estimate.status is Status.INVALID
    )
    is_checked = relevant.is_cross_checked and not has_unresolved_fault
    return integrity_report(estimate.time_ns, config.integrity, subfilters.k, names, found, excluded, is_checked)


def relative_to_horizon(
    filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState, time_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Return means and covariances of all filters, with the INS error relative to the published horizon."""
    if config.horizon == GEODETIC or filter_.vertical is None:
        return state.means, state.stack
    # The gravity horizon differs by the deflection, whose two states follow the three states of the INS attitude.
    indices, to_own = filter_.model.process_indices[:5], np.eye(filter_.model.size)
    to_own[indices[:3, None], indices] = own_error_matrix(filter_.vertical.at(time_ns))
    return state.means @ to_own.T, to_own @ state.stack @ to_own.T
