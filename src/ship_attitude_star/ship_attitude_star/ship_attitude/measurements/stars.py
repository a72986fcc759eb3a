"""Measured directions of single stars, compared one by one (:mod:`ship_stars.solution.residuals`)."""

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
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import InterpolatedAttitude
from ship_geometry.tracks.exposure_mean import exposure_motion
from ship_stars.camera.camera_states import camera_state_indices
from ship_stars.sky.shared_states import sky_slice
from ship_stars.solution.exposure import StarExposure, reduce_to_mid_exposure, visible_stars
from ship_stars.solution.residuals import PredictedSensor, star_residuals
from ship_stars.solution.solution import initial_attitude


class StarCameraDevice(Device):
    """A star sensor that sends single stars."""

    is_star = True

    def convert(
        self, measurement: StarExposure, match: InsMatch
    ) -> tuple[StarExposure, InterpolatedAttitude] | Rejection:
        """See :class:`Device`; an exposure is reduced to its middle, and compared with the mean attitude over it.

        The rate between two INS samples would contain their noise divided by their interval. The filter would take
        this noise for a motion across the streaks, where stars are accurate. The clock offset would then seem well
        observed, and its sigma would become too small. Therefore rate and errors of the mean attitude are used.
        """
        if measurement.length is None:
            return measurement, match.ins
        motion = exposure_motion(match.track, match.ins_time_ns, measurement.length.nodes)
        if motion is None:
            return measurement.length.coverage_rejection
        rate_d, gain, covariance_d = motion.rate, motion.noise_gain, motion.error_covariance
        ins = replace(match.ins, rate_d=rate_d, noise_gain=gain, error_covariance_d=covariance_d)
        return reduce_to_mid_exposure(measurement, motion.in_device_frame(self.rotation_dv0).turns), ins

    def initial_attitude(self, measurement: StarExposure, at: LinearisationPoint) -> FloatArray | None:
        """See :class:`Device`; None without visible stars."""
        assert at.sky_model is not None
        prior = at.predicted.prior(at.covariance)
        visible = visible_stars(measurement, at.sky_model, prior)
        if isinstance(visible, Rejection) or not len(visible[1]):
            return None
        return initial_attitude(visible[1], prior)

    def linearise(self, measurement: StarExposure, at: LinearisationPoint) -> ComparedMeasurement | Rejection:
        """See :class:`Device`; the residual of each star used is measured minus predicted direction, up and right."""
        assert at.sky_model is not None
        rotation_nv, model = at.predicted.rotation_nv, at.model
        stars = star_residuals(
            measurement,
            PredictedSensor(rotation_nv, at.predicted.jacobian_v, at.mean),
            (at.expected or at.predicted).prior(at.covariance),
            at.sky_model,
            sky_slice(model.slices),
            None if at.expected is None else rotation_nv,
            camera_state_indices(model.slices, self.name),
        )
        if isinstance(stars, Rejection):
            return stars
        interpolation = stars.rotation_jacobian @ at.predicted.interpolation_v @ stars.rotation_jacobian.T
        noise_by_source = {model.source_indices[source]: part for source, part in stars.noise.items()}
        noise_by_source[model.source_indices[SOURCE_INTERPOLATION]] = interpolation
        return ComparedMeasurement(
            linear=LinearMeasurement(stars.residual, stars.jacobian, noise_by_source),
            rotation_jacobian=stars.rotation_jacobian,
            components=stars.components,
            rotation_nv=rotation_nv if stars.rotation_ns is None else stars.rotation_ns,
            predicted_nv=rotation_nv,
            rejected_stars=stars.rejected,
        )

    def information(self, measurement: StarExposure) -> FloatArray:
        """See :class:`Device`."""
        directions, weight = measurement.directions_s, measurement.sigma**-2.0
        of_all = np.einsum("k,kij->ij", weight, np.eye(3) - directions[:, :, None] * directions[:, None, :])
        information: FloatArray = 0.5 * (of_all + of_all.T)
        return information
