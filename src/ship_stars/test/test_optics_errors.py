"""Errors of a camera's optics compared with a camera with other parameters, by finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.camera.camera import Distortion, StarCamera
from ship_stars.camera.config import CameraConfig
from ship_stars.camera.errors import SURVEYED_FOCAL_SIGMA, OpticsErrors

PLAIN = StarCamera(0.05, 5.5e-6, 1023.5, 1023.5)
BENT = replace(PLAIN, distortion=Distortion(k1=-0.2, k2=0.05, p1=1e-3, p2=-2e-3))


def field_pixels() -> FloatArray:
    u, v = np.meshgrid(np.linspace(20.0, 2030.0, 9), np.linspace(20.0, 2030.0, 9))
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def other_camera(camera: StarCamera, mode: int, size: float) -> StarCamera:
    """Return the camera whose true parameters differ from the configured ones by one error."""
    if mode == 0:
        return replace(camera, focal_length_m=camera.focal_length_m * (1.0 + size))
    if mode == 1:
        return replace(camera, principal_u_px=camera.principal_u_px + size)
    if mode == 2:
        return replace(camera, principal_v_px=camera.principal_v_px + size)
    distortion = camera.distortion or Distortion()
    return replace(camera, distortion=replace(distortion, k1=distortion.k1 + size))


@pytest.mark.parametrize("mode", range(4))
@pytest.mark.parametrize("camera", [PLAIN, BENT])
def test_a_mode_is_the_difference_of_two_cameras(camera, mode):
    errors = OpticsErrors(camera, 1e-5, 0.05, 1e-4)
    size = errors.sigmas[mode]
    pixels = field_pixels()
    measured_s = camera.directions(pixels)
    displaced_s = measured_s - other_camera(camera, mode, size).directions(pixels)
    # The mounting contains the rotation by which an error of the principal point moves the boresight.
    turn = size * camera.pixel_pitch_m / camera.focal_length_m
    turns_s = {1: [0.0, -turn, 0.0], 2: [0.0, 0.0, -turn]}
    displaced_s -= np.cross(turns_s.get(mode, [0.0, 0.0, 0.0]), measured_s)
    found_s = errors.modes(measured_s)[..., mode]
    assert np.abs(displaced_s).max() > 1e-3 * ARCSEC
    np.testing.assert_allclose(found_s, displaced_s, atol=2e-3 * np.abs(displaced_s).max())


def test_an_error_of_the_principal_point_leaves_the_boresight():
    boresight_s = PLAIN.directions(np.array([[1023.5, 1023.5]]))
    modes = OpticsErrors(PLAIN, 2e-4, 1.0, 0.01).modes(boresight_s)
    np.testing.assert_allclose(modes, 0.0, atol=1e-18)


def test_a_focal_length_without_a_sigma_is_surveyed():
    config = CameraConfig(focal_length_m=0.05, pixel_pitch_m=5.5e-6, focal_length_sigma_m=0.0)
    assert config.optics_errors(config.camera("camera")).focal_sigma == SURVEYED_FOCAL_SIGMA
    config = replace(config, focal_length_sigma_m=5e-5)
    assert config.optics_errors(config.camera("camera")).focal_sigma == pytest.approx(1e-3)
