"""Measured attitudes relative to the horizon: star sensors that solve their attitude, and other attitude systems."""

import math
from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.measurements.kind import (
    SOURCE_INTERPOLATION,
    ComparedMeasurement,
    Device,
    InsMatch,
    LinearisationPoint,
)
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian
from ship_geometry.tracks.attitude_track import InterpolatedAttitude
from ship_kernels import compiled_rotations
from ship_stars.samples.attitude_samples import (
    ATTITUDE_COMPONENTS,
    SHARED_BY_GRAVITY,
    SHARED_BY_MESSAGES,
    SHARED_BY_SKY,
    AttitudeMeasurement,
    SolvedAttitude,
)
from ship_stars.samples.readings import InertialAttitude
from ship_stars.sky.shared_states import sky_slice
from ship_stars.sky.tracker_attitude import to_horizon_attitude

_HALF_TURN_RAD = math.radians(177.0)
"""Rotation angle above which noise of up to 1° per attitude may decide the sense of the rotation vector, rad."""
_TIE_BREAK_RAD = 0.01
"""Value added to each component of both candidate errors, rad.

Of two opposite errors, the one with the negative component sum then counts as smaller.
"""

_IDENTITY = np.eye(3)
_IDENTITY.flags.writeable = False

_SHARED_STATES = {SHARED_BY_MESSAGES: "sky.common", SHARED_BY_GRAVITY: "gravity.deflection"}
"""States of the errors that several attitude measurements share, by :attr:`AttitudeMeasurement.shared_by`."""


class AttitudeDevice(Device):
    """A device that measures its attitude relative to the horizon."""

    def linearise(self, measurement: AttitudeMeasurement, at: LinearisationPoint) -> ComparedMeasurement:
        """See :class:`Device`; the residual is the rotation vector from predicted to measured attitude, device frame.

        The residual is log(R_predicted^T R_measured), rad, shape (3,).
        """
        residual, jacobian = _residual(measurement, at)
        index, noise = at.model.source_indices, measurement.noise_v
        between, interpolation = index[SOURCE_INTERPOLATION], at.predicted.interpolation_v
        return ComparedMeasurement(
            LinearMeasurement(residual, jacobian, {index[self.noise_sources[0]]: noise, between: interpolation}),
            rotation_jacobian=_IDENTITY,
            components=ATTITUDE_COMPONENTS,
            rotation_nv=measurement.rotation_nv,
            predicted_nv=at.predicted.rotation_nv,
            attitude_noise_v=noise,
        )

    def information(self, measurement: AttitudeMeasurement | InertialAttitude) -> FloatArray:
        """See :class:`Device`; a variance of zero counts as no information."""
        noise_v = measurement.noise_v if isinstance(measurement, AttitudeMeasurement) else measurement.noise_s
        inverse = np.asarray(np.linalg.pinv(noise_v, hermitian=True), dtype=np.float64)
        information: FloatArray = 0.5 * (inverse + inverse.T)
        return information


class TrackerDevice(AttitudeDevice):
    """A star sensor that solves its attitude."""

    is_star = True

    def convert(
        self, measurement: Measurement, match: InsMatch
    ) -> tuple[Measurement, InterpolatedAttitude] | Rejection:
        """See :class:`Device`; an attitude that depends on the sky model is converted to the horizon."""
        if not isinstance(measurement, InertialAttitude | SolvedAttitude):
            return measurement, match.ins
        assert match.sky_model is not None
        attitude = to_horizon_attitude(measurement, match.sky_model)
        return attitude if isinstance(attitude, Rejection) else (attitude, match.ins)


class ReferenceDevice(AttitudeDevice):
    """Another attitude system, which is levelled by gravity as the INS is."""

    angles = (("roll", 2), ("pitch", 1), ("heading", 0))
    are_angles_signed = True

    def convert(self, measurement: AttitudeMeasurement, match: InsMatch) -> tuple[Measurement, InterpolatedAttitude]:
        """See :class:`Device`; the deflection of the vertical is an error shared with the INS."""
        if match.vertical is not None:
            by_deflection = match.vertical.at(measurement.time_ns).deflection_jacobian
            measurement = replace(measurement, shared_n=by_deflection, shared_by=SHARED_BY_GRAVITY)
        return measurement, match.ins


def _residual(measurement: AttitudeMeasurement, at: LinearisationPoint) -> tuple[FloatArray, FloatArray]:
    """Return measured minus predicted attitude, rad, shape (3,), and the Jacobian of the prediction, shape (3, n)."""
    slices, (rotation_nv, jacobian_v, _) = at.model.slices, at.predicted
    if measurement.shared_n is not None:
        by_sky = measurement.shared_by == SHARED_BY_SKY
        rows = sky_slice(slices) if by_sky else slices[_SHARED_STATES[measurement.shared_by]]
        rotation = -measurement.shared_n @ at.mean[rows]
        rotation_nv = exp_rotation(rotation) @ rotation_nv
        jacobian_v = jacobian_v.copy()
        jacobian_v[:, rows] = -rotation_nv.T @ left_jacobian(rotation) @ measurement.shared_n
    residual = compiled_rotations.turn_between(rotation_nv, measurement.rotation_nv)
    if math.hypot(*residual.tolist()) > _HALF_TURN_RAD:
        slow = slices["ins.attitude"]
        residual = _smaller_ins_error_residual(residual, at.mean[slow], jacobian_v[:, slow])
    return residual, jacobian_v


def _smaller_ins_error_residual(residual: FloatArray, error_n: FloatArray, by_error_v: FloatArray) -> FloatArray:
    """Return a residual of about 180° in the sense that leads to the smaller INS error.

    At 180° noise decides the sense of the logarithm. With the wrong sense, the estimated INS error would be 360° after
    a heading jump by 180° and back. At 360° the left Jacobian is singular. If the predicted error is about zero, both
    errors are equally large; then the residual that leads to the error with the negative component sum is returned.

    Args:
        residual: rotation vector in the device frame, rad, shape (3,).
        error_n: predicted attitude error of the INS, rotation vector in the horizon frame, rad, shape (3,).
        by_error_v: Jacobian of the predicted device attitude with respect to ``error_n``, shape (3, 3).
    """
    size = math.hypot(*residual.tolist())
    other = (1.0 - 2.0 * math.pi / size) * residual
    leads_to = [error_n + np.linalg.solve(by_error_v, one) + _TIE_BREAK_RAD for one in (residual, other)]
    return residual if leads_to[0] @ leads_to[0] <= leads_to[1] @ leads_to[1] else other
