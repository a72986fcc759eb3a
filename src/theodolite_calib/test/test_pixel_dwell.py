"""Pixel dwell of a fixed camera on the theodolite: stars stay on their pixels, with the errors of these pixels.

The errors are those of a simulated detector (waves over the field, and a number for each pixel), drawn for each
session.
"""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_simulation.scenario.scenario import Detector
from ship_simulation.stars.true_camera import DetectorErrors
from ship_stars.camera.errors import SOURCE_FIELD, SOURCE_PIXEL
from ship_testing.mount_stars import (
    CAMERA,
    CAMERA_ID,
    MountSession,
    draw_errors,
    mount_config,
    mount_sky,
    random_field,
)
from ship_testing.simulated_session import gauss_markov
from ship_testing.star_sky import TIME_NS
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.star_step import StarStep
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.samples import Mode, PointingEstimate

ERRORS_PX = {"field_spatial_sigma_px": 0.2, "pixel_spatial_sigma_px": 0.1}
"""Spatial errors of 2.7″ and 1.3″; the noise is 1.3″."""
SESSIONS, EXPOSURES, STARS, PERIOD_NS = 24, 25, 6, 200_000_000


def camera_config(**errors_px: float) -> OpticalAxisConfig:
    return mount_config(**{f"telescopes__{CAMERA_ID}__camera__{name}": value for name, value in errors_px.items()})


def after_five_seconds(
    seed: int, settings: OpticalAxisConfig
) -> tuple[np.ndarray, PointingEstimate, CalibrationFilter]:
    """Return the true main axis after 25 exposures of the brightest stars, the estimate, and its filter."""
    rng = np.random.default_rng([31, seed])
    detector = DetectorErrors(rng, Detector(**CAMERA, width_px=2201, height_px=2201, **ERRORS_PX))
    sky_model = mount_sky(settings)
    errors, encoder, filter_ = draw_errors(settings, rng), random_field(rng), CalibrationFilter(settings)
    step, state = StarStep(settings, filter_, sky_model), filter_.initial_state()
    deformation = np.full(3, settings.deformation.sigma_arcsec * ARCSEC)
    times_ns = np.arange(EXPOSURES) * PERIOD_NS
    bent_d = gauss_markov(rng, times_ns * 1e-9, deformation, settings.deformation.time_s)
    for time_ns, turn_d in zip((TIME_NS + times_ns).tolist(), bent_d, strict=True):
        session = MountSession(settings, replace(errors, deformation_d=turn_d), sky_model, rng, detector)
        state, _ = step(state, session.sighting(encoder, STARS, time_ns))
    pending = PendingPointing(session.reading(encoder, time_ns), session.ship(), "", 0.0, state)
    return session.main_axis(encoder), PointingOutput(settings, filter_).estimate(pending), filter_


def mean_nees(settings: OpticalAxisConfig) -> tuple[float, PointingEstimate, CalibrationFilter]:
    nees = []
    for seed in range(SESSIONS):
        true_nm, estimate, filter_ = after_five_seconds(seed, settings)
        nees.append(normalized_error_squared(log_rotation(true_nm @ estimate.rotation_nm.T), estimate.covariance_n))
    return float(np.mean(nees)), estimate, filter_


def test_pointing_matches_its_covariance_with_pixel_errors() -> None:
    nees, estimate, filter_ = mean_nees(camera_config(**ERRORS_PX))
    low, high = mean_nees_band(SESSIONS, 3)
    assert low <= nees <= high
    assert (estimate.mode, estimate.status) == (Mode.STARS, Status.VALID)
    sigma = {
        source: np.sqrt(np.trace(part)) / ARCSEC
        for source, part in zip(filter_.model.sources, estimate.covariance_by_source_n, strict=True)
    }
    assert sigma[SOURCE_FIELD] > 0.2
    assert sigma[SOURCE_PIXEL] > 0.05


@pytest.mark.statistics
def test_filter_without_pixel_errors_is_overconfident() -> None:
    nees, _, _ = mean_nees(camera_config())
    assert nees > mean_nees_band(SESSIONS, 3)[1]


@pytest.mark.parametrize("kind", ERRORS_PX)
def test_each_alone_makes_the_pointing_less_sure(kind: str) -> None:
    _, with_it, _ = after_five_seconds(0, camera_config(**{kind: ERRORS_PX[kind]}))
    _, without, _ = after_five_seconds(0, camera_config())
    assert np.trace(with_it.covariance_n) > 1.02 * np.trace(without.covariance_n)


def test_after_a_slip_of_the_encoders_the_stars_are_new() -> None:
    """The pixel dwell is reset with the encoders' zero points."""
    _, estimate, filter_ = after_five_seconds(0, camera_config(**ERRORS_PX))
    state = estimate.state
    assert state.pixel_dwells[f"star.{CAMERA_ID}"].exposure_count > 0
    jump = EncoderJump(state.time_ns, np.array([1e-3, 0.0]), 1e-5)
    assert not filter_.inflate_covariance(state, jump).pixel_dwells
    assert not filter_.exclude_source(state, "encoder").pixel_dwells
