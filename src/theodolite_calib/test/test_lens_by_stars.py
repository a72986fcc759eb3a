"""N' = 60 mm and the parallelism from beacons and stars together: estimates, and unobservable combinations.

The noise is that of the scenario ``theodolite_sweep``: five minutes through 360°, 10° to 70°, lights and stars in turn
in the calibration telescope.
"""

import numpy as np
import pytest

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_simulation.stars.true_camera import TrueOptics
from ship_stars.camera.camera import StarCamera
from ship_testing.mount_stars import CAMERA, CAMERA_ID, MOUNTED_DEG, mount_sky, observe_stars
from ship_testing.simulated_session import BEACONS_DEG, START_NS, Session, config, session
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.star_step import StarStep
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.calibration import calibration_from_state
from theodolite_calib.samples.samples import Exposure
from theodolite_calib.samples.sighting import StarSighting

TELESCOPE, LENS_M = "main", 0.06
SWEEP = {
    **{f"axes__{name}_sigma_arcsec": 23.094 for name in ("g", "h")},
    **{f"axes__{name}_sigma_arcsec": 17.321 for name in ("c", "I")},
    **{f"axes__{name}_sigma_arcsec": 11.547 for name in ("beta_x", "beta_y")},
    "telescope__azimuth_sigma_arcsec": 1.0,
    "telescope__elevation_sigma_arcsec": 1.0,
    "telescope__rotation_sigma_arcsec": 5.0,
    "telescope__lens__sigma_m": LENS_M,
    "lever__sigma_m": 0.005,
    "air__sigma": 0.06,
    "air__light_sigma": 0.01,
    "ship_antenna__sigma_m": 0.01,
    "ship__slow_time_s": 600.0,
    **{f"beacons__{name}__rtk__bias_sigma_m": 0.015 for name in BEACONS_DEG},
}
BY_STARS = {
    **{f"telescopes__{TELESCOPE}__camera__{name}": value for name, value in CAMERA.items()},
    **{f"telescopes__{TELESCOPE}__{name}_deg": 0.0 for name in ("azimuth", "elevation", "roll")},
    **{f"telescopes__{TELESCOPE}__{name}_sigma_arcsec": 1.0 for name in ("azimuth", "elevation")},
    f"telescopes__{TELESCOPE}__roll_sigma_arcsec": 5.0,
    "sky__magnitude_limit": 7.5,
}
SETTINGS = config(**SWEEP, **BY_STARS)
PER_AXIS_M = LENS_M / np.sqrt(3.0)
TIMES_S = np.arange(0.0, 300.0, 0.5)
ENCODER = np.deg2rad(np.stack([1.2 * TIMES_S, 40.0 - 30.0 * np.cos(2.0 * np.pi * TIMES_S / 110.0)], axis=-1))
NEAR_AND_FAR_M = 1250.0 - 750.0 * np.cos(2.0 * np.pi * TIMES_S / 100.0)
"""Distances from 0.5 to 2 km, m."""

FORWARD, UP, RIGHT = range(3)


@pytest.fixture(scope="module", name="sky_model")
def _sky():
    return mount_sky(SETTINGS, START_NS, 310)


def state_after_sweep(
    seed: int, sky_model, distance_m=None, settings=SETTINGS, lens_error_m=PER_AXIS_M
) -> tuple[CalibrationFilter, CalibrationState, Session]:
    """Return filter, state after the sweep, and session with the truth; beacons alone if ``sky_model`` is None."""
    drawn = session(settings, seed, TIMES_S, ENCODER, lens_error_m=np.full(3, lens_error_m), distance_m=distance_m)
    filter_, rng = CalibrationFilter(settings), np.random.default_rng(1000 + seed)
    by_lights, sky = SightingStep(settings, filter_), rng.standard_normal(4)
    by_stars = None if sky_model is None else StarStep(settings, filter_, sky_model)
    ((camera_id, camera),) = settings.telescopes.items()
    known, parallelism, lens = settings.star_camera(camera_id), drawn.parallelism, None
    optics = known.optics_errors(known.camera(camera_id))
    if camera_id == TELESCOPE:
        lens = TrueOptics(StarCamera(**{**CAMERA, "focal_length_m": drawn.focal_length_m}), np.eye(3))
    else:
        parallelism = camera.parallelism + camera.parallelism_sigma * rng.standard_normal(3)
    state, rotation_sm = filter_.initial_state(), rotation_from_angles(*parallelism)
    for number, sighting in enumerate(drawn.sightings):
        time_ns = sighting.time_ns
        if number % 2 == 0:
            state, decision = by_lights(state, sighting, Exposure(time_ns, ()))
        elif by_stars is not None:
            rotation_ns = drawn.rotation_nm[number] @ rotation_sm.T
            seen = observe_stars(sky_model, rotation_ns, sky, 5, rng, time_ns, camera_id, lens=lens, optics=optics)
            state, decision = by_stars(state, StarSighting(camera_id, seen, sighting.ship, sighting.encoder))
        assert decision.accepted, decision.text
    return filter_, state, drawn


def lens_error_m(filter_: CalibrationFilter, state: CalibrationState) -> tuple[np.ndarray, np.ndarray]:
    """Return the error of the estimated N', and its sigma, m, shape (3,) each."""
    rows = filter_.model.slices["lens"]
    return state.mean[rows] - PER_AXIS_M, np.sqrt(np.diagonal(state.covariance)[rows])


@pytest.mark.slow
@pytest.mark.parametrize("distance_m", [None, NEAR_AND_FAR_M], ids=["2 km", "0.5 to 2 km"])
def test_beacons_and_stars_observe_n_right_and_up(sky_model, distance_m) -> None:
    found = [state_after_sweep(seed, sky_model, distance_m)[:2] for seed in range(3)]
    errors_m, sigmas_m = np.array([lens_error_m(*one) for one in found]).swapaxes(0, 1)
    assert np.max(sigmas_m[:, RIGHT]) < 0.005
    assert np.max(sigmas_m[:, UP]) < 0.015
    assert np.max(np.abs(errors_m[:, [UP, RIGHT]] / sigmas_m[:, [UP, RIGHT]])) < 3.5
    # As stars determine the focal length, the scale of the lights' image determines N' forward: 60 mm become 41 mm.
    assert np.min(sigmas_m[:, FORWARD]) > 0.6 * LENS_M
    for filter_, state in found:
        calibration = calibration_from_state(filter_, SETTINGS, state)
        assert "lens_forward" in calibration.unobservable
        assert not any("lens_up" in words or "lens_right" in words for words in calibration.unobservable)
        place = calibration.names.index("lens_right")
        assert calibration.units[place] == "m"
        assert calibration.values[place] == pytest.approx(PER_AXIS_M, abs=0.02)
        assert {"parallelism_azimuth", "parallelism_elevation", "parallelism_rotation"} <= set(calibration.names)


def test_beacons_alone_confuse_n_with_axis_errors() -> None:
    filter_, state, _ = state_after_sweep(0, None)
    _, sigma_m = lens_error_m(filter_, state)
    assert np.min(sigma_m) > 0.9 * LENS_M
    unobservable = calibration_from_state(filter_, SETTINGS, state).unobservable
    # A radian of collimation has the effect of 2 km of N', the distance of the lights.
    assert "c + 2e+03 lens_right" in unobservable
    assert "h + 2e+03 lens_up" in unobservable


def test_star_sensor_on_the_main_tube_observes_parallelism(sky_model) -> None:
    """The sensor is surveyed to 0.2″, the telescope to a minute of arc, N' to 2 mm."""
    surveyed = {
        **{f"telescope__{name}_sigma_arcsec": 60.0 for name in ("azimuth", "elevation", "rotation")},
        "telescope__lens__sigma_m": 0.002,
        **{f"telescopes__{CAMERA_ID}__camera__{name}": value for name, value in CAMERA.items()},
        **{f"telescopes__{CAMERA_ID}__{name}": value for name, value in MOUNTED_DEG.items()},
        **{f"telescopes__{CAMERA_ID}__{name}_sigma_arcsec": 0.2 for name in ("azimuth", "elevation", "roll")},
        "sky__magnitude_limit": 7.5,
    }
    settings = config(**{**SWEEP, **surveyed})
    filter_, state, drawn = state_after_sweep(1, sky_model, None, settings, lens_error_m=0.001)
    calibration = calibration_from_state(filter_, settings, state)
    first = calibration.names.index("parallelism_azimuth")
    assert calibration.names[first + 3 : first + 6] == tuple(
        f"telescopes.{CAMERA_ID}.{angle}" for angle in ("azimuth", "elevation", "roll")
    )
    sigma = np.sqrt(np.diagonal(calibration.covariance)[first : first + 3]) / ARCSEC
    error = (calibration.values[first : first + 3] - drawn.parallelism) / ARCSEC
    assert np.max(sigma[:2]) < 1.0
    # 15 mm of correlated error of each baseline, 2 km away, on lights that are 7° apart: 18″ of rotation or less.
    assert sigma[2] < 10.0
    assert np.max(np.abs(error / sigma)) < 3.5
