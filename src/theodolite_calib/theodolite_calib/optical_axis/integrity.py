"""Integrity of the pointing: protection levels of its angles.

The module :mod:`ship_estimation.integrity.protection_levels` computes the protection levels from the solution
separations of the subfilters (:mod:`theodolite_calib.filter.subfilters`).
"""

import math

import numpy as np

from ship_estimation.integrity.protection_levels import IntegrityReport, integrity_report, protection_levels
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.samples.samples import Mode, PointingEstimate

QUANTITIES = ("azimuth_cos_elevation", "elevation", "image_rotation")
"""Quantities bounded by the protection levels."""


class PointingLevels:
    """Protection levels of pointings from one state of the filter; created once per state.

    Args:
        filter_: filter with its model.
        config: parameters of the node.
        state: state of the filter.

    Attributes:
        state: state of the filter.
    """

    def __init__(self, filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState) -> None:
        self.state, self._config = state, config.integrity
        sources, self._multipliers = filter_.subfilters.names, filter_.subfilters.k
        self._axis_indices = axis_state_indices(filter_.model)
        excluded = {name: one.since_ns for name, one in state.fault_state.excluded.items()}
        self._subfilter_indices = np.array(
            [row for row, name in enumerate(sources) if name not in excluded], dtype=np.intp
        )
        self._names = tuple([sources[row] for row in self._subfilter_indices])
        self._excluded = tuple(sorted(excluded.items()))
        self._has_unresolved_fault = state.fault_state.unresolved_fault is not None or state.consecutive_rejections > 0

    def integrity_of(self, estimate: PointingEstimate) -> IntegrityReport:
        """Return the integrity of a pointing."""
        azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm).tolist()
        to_angles = angle_errors_from_rotation_vector(azimuth, elevation)
        to_angles[0] *= math.cos(elevation)
        # The levels already include the separations. The errors of a pointing besides the state, such as the
        # noise of the encoders, are equal in every subfilter.
        result = protection_levels(
            self._multipliers,
            self._subfilter_indices,
            self._axis_indices,
            (to_angles, to_angles @ estimate.by_error_n, estimate.covariance_without_separation_n),
            self.state.mean,
            self.state.subfilters.mean,
            self.state.covariance_by_source,
            self.state.subfilters.covariances[:, 0],
        )
        # Encoders and ship's attitude are unchecked without beacons and stars, and so are stars alone.
        is_stars_only = estimate.mode is Mode.STARS and estimate.status is Status.DEGRADED
        is_unchecked = (
            self._has_unresolved_fault
            or estimate.mode is Mode.ENCODER
            or is_stars_only
            or estimate.status is Status.INVALID
        )
        return integrity_report(
            estimate.time_ns,
            self._config,
            self._multipliers,
            self._names,
            result,
            self._excluded,
            is_checked=not is_unchecked,
        )


def integrity_of(filter_: CalibrationFilter, config: OpticalAxisConfig, estimate: PointingEstimate) -> IntegrityReport:
    """Return the integrity of one pointing, from the filter's state in ``estimate``."""
    return PointingLevels(filter_, config, estimate.state).integrity_of(estimate)
