"""Pointing from the stars of one exposure alone, if the ship's attitude or the encoders are missing.

At least three stars must be identified and consistent with one another, because the camera's attitude is not predicted.
The main axis follows from the estimated parallelism: R_main = R_camera · R(azimuth, elevation, roll).
"""

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles, rotation_vector_from_angle_errors
from ship_stars.sky.sky_model import SkyModel
from ship_stars.solution.exposure import StarExposure, visible_stars
from ship_stars.solution.residuals import SOURCE_STAR_NOISE
from ship_stars.solution.solution import SOLUTION_TERMS, SolutionStatus, solve_stars
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import SOURCE_PARALLELISM, axis_state_indices, parallelism_block
from theodolite_calib.samples.samples import Mode, PointingEstimate

_STAR_NOISE_TERMS = ("installation", "catalogue")
"""Error terms of a solution that count as star noise, because the filter has no source for them. A single camera has
no installation besides its parallelism, and the filter has catalogue errors in the star noise."""


def pointing_by_stars(
    exposure: StarExposure,
    sky: SkyModel,
    config: OpticalAxisConfig,
    filter_: CalibrationFilter,
    state: CalibrationState,
    text: str,
) -> PointingEstimate | None:
    """Return the pointing at the middle of an exposure; None if the stars do not give a verified attitude.

    Args:
        exposure: exposure as the camera recorded it.
        sky: sky model.
        config: parameters of the node.
        filter_: filter of that configuration.
        state: state with the camera's parallelism.
        text: reason for a pointing from stars alone.
    """
    visible = visible_stars(exposure, sky, None)
    if isinstance(visible, Rejection):
        return None
    solution = solve_stars(visible[1])
    if solution.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return None
    if exposure.length is not None:
        # Noise is added, because the rotation of the camera during the exposure is not measured.
        unmeasured_acceleration = np.deg2rad(config.ins.untold_acceleration_deg_per_s2)
        solution = solution.with_added_noise(exposure.length.unmeasured_turn_variance(float(unmeasured_acceleration)))
    model, camera_id = filter_.model, exposure.source.partition(".")[2]
    block = model.slices[parallelism_block(camera_id, config)]
    azimuth, elevation, roll = config.telescopes[camera_id].parallelism + state.mean[block]
    by_angles_n = solution.rotation_nb @ rotation_vector_from_angle_errors(azimuth, elevation)
    covariance_by_source_n = np.zeros((len(model.sources), 3, 3))
    for term, part_n in zip(SOLUTION_TERMS, solution.covariance_by_source_n, strict=False):
        # The model has no source for a term that is zero.
        if not part_n.any():
            continue
        covariance_by_source_n[model.source_indices[SOURCE_STAR_NOISE if term in _STAR_NOISE_TERMS else term]] += part_n
    covariance_by_source_n[model.source_indices[SOURCE_PARALLELISM]] += (
        by_angles_n @ state.covariance[block, block] @ by_angles_n.T
    )
    unknown, covariance_n = np.full((3, 3), np.nan), covariance_by_source_n.sum(axis=0)
    return PointingEstimate(
        time_ns=exposure.time_ns,
        rotation_nm=solution.rotation_nb @ rotation_from_angles(azimuth, elevation, roll),
        covariance_by_source_n=covariance_by_source_n,
        covariance_n=covariance_n,
        covariance_without_separation_n=covariance_n,
        rotation_nt=unknown,
        mode=Mode.STARS,
        status=Status.DEGRADED,
        light_count=0,
        state=state,
        text=text,
        by_error_n=np.zeros((3, len(axis_state_indices(model)))),
        rotation_dm=unknown,
    )
