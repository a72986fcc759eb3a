"""True optics of simulated cameras: stated errors, and a boresight that stays on its pixel."""

from dataclasses import replace

import numpy as np

from ship_simulation.scenario.scenario import Detector
from ship_simulation.stars.true_camera import draw_optics
from ship_stars.camera.camera import StarCamera
from ship_testing.consistency import sigma_ratio_band

DETECTOR = Detector(
    focal_length_m=0.05,
    pixel_pitch_m=5.5e-6,
    principal_u_px=1023.5,
    principal_v_px=1000.5,
    distortion_k1=-0.1,
    width_px=2048,
    height_px=2048,
)
SEEDS = 400


def cameras(detector: Detector) -> list[StarCamera]:
    return [draw_optics(np.random.default_rng(seed), detector, "camera").camera for seed in range(SEEDS)]


def test_errors_are_as_large_as_stated():
    drawn = cameras(replace(DETECTOR, principal_sigma_px=2.0, distortion_sigma=0.03))
    # A focal length without a sigma is known to 0.02 %.
    in_sigmas = np.array(
        [
            [
                (one.focal_length_m / 0.05 - 1.0) / 2e-4,
                (one.principal_u_px - 1023.5) / 2.0,
                (one.principal_v_px - 1000.5) / 2.0,
                (one.distortion.k1 + 0.1) / 0.03,
            ]
            for one in drawn
        ]
    )
    low, high = sigma_ratio_band(SEEDS)
    rms = np.sqrt(np.mean(in_sigmas**2, axis=0))
    assert np.all((low < rms) & (rms < high))
    stated = np.array(
        [one.focal_length_m / 0.05 - 1.0 for one in cameras(replace(DETECTOR, focal_length_sigma_m=1e-4))]
    )
    assert low < np.sqrt(np.mean(stated**2)) / 2e-3 < high


def test_the_boresight_stays_on_its_pixel_and_the_sensor_is_not_rolled():
    for seed in range(20):
        optics = draw_optics(np.random.default_rng(seed), DETECTOR, "camera")
        np.testing.assert_allclose(optics.pixels(np.array([1.0, 0.0, 0.0])), [1023.5, 1000.5], atol=1e-6)
        np.testing.assert_allclose(optics.rotation_cs @ optics.rotation_cs.T, np.eye(3), atol=1e-14)
        # A star 900 px above the boresight stays above it to 0.1 px.
        above = optics.pixels(np.array([1.0, 0.1, 0.0]))
        assert abs(above[0] - 1023.5) < 0.1
