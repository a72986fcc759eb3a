"""Stars through a lens that is not the configured one: no pointing is VALID and wrong beyond its covariance or level.

A session of 30 s on the noise of ``simulated_session``: exposures of the brightest stars in the field of a camera of
[W18] while the mount turns slowly, alone or with two lights in turn. The camera is the calibration telescope, whose
focal length (sigma 0.1 %) is also that of the lights' images, or has a lens of its own (0.02 %). Principal point and k1
are drawn.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_simulation.scenario.scenario import Detector
from ship_simulation.stars.true_camera import TrueOptics, draw_optics
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.camera.camera import StarCamera
from ship_stars.sky.sky_model import SkyModel
from ship_testing.mount_stars import CAMERA, CAMERA_ID, MOUNTED_DEG, mount_sky, observe_stars
from ship_testing.simulated_session import START_NS, config, session
from ship_testing.star_sky import without_identity
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.star_step import StarStep
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.calibration import calibration_from_state
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput
from theodolite_calib.samples.samples import EncoderSample, Exposure
from theodolite_calib.samples.sighting import StarSighting

TELESCOPE = "main"
SEEDS, STARS = 20, 6
TIMES_S = np.arange(0.0, 30.0, 0.5)
ENCODER = np.deg2rad(np.stack([40.0 + 0.4 * TIMES_S, 50.0 + 0.2 * TIMES_S], axis=-1))
LENGTH_M = CAMERA["focal_length_m"]
OWN_SIGMA = 2e-4
"""Default relative sigma of a camera's focal length."""


@cache
def config_through(camera_id: str) -> OpticalAxisConfig:
    """Return the configuration with the stars in the calibration telescope, or in a separate camera."""
    own = {f"telescopes__{camera_id}__camera__{name}": value for name, value in CAMERA.items()}
    angles_deg = dict.fromkeys(MOUNTED_DEG, 0.0) if camera_id == TELESCOPE else MOUNTED_DEG
    own |= {f"telescopes__{camera_id}__{name}": value for name, value in angles_deg.items()}
    for angle, by_lights, sigma in zip(MOUNTED_DEG, ("azimuth", "elevation", "rotation"), (1.0, 1.0, 5.0), strict=True):
        by_stars = angle.removesuffix("_deg")
        own[f"telescope__{by_lights}_sigma_arcsec"] = own[f"telescopes__{camera_id}__{by_stars}_sigma_arcsec"] = sigma
    return config(**own, sky__magnitude_limit=7.5)


@cache
def sky_model() -> SkyModel:
    return mount_sky(config_through(CAMERA_ID), START_NS, 60)


def random_optics(seed: int, ratio: float) -> TrueOptics:
    """Return optics with 1 + ``ratio`` times the configured focal length, and random principal point and k1."""
    drawn = draw_optics(np.random.default_rng(2000 + seed), Detector(**CAMERA, width_px=2201, height_px=2201), "camera")
    return replace(drawn, camera=replace(drawn.camera, focal_length_m=LENGTH_M * (1.0 + ratio)))


@dataclass(frozen=True)
class SessionResult:
    """Errors of the k pointings of one session, and the final state.

    Attributes:
        valid: True for VALID pointings, shape (k,).
        in_sigmas: largest error of an angle in its sigmas, shape (k,).
        of_level: largest error of an angle as a share of its protection level, shape (k,); NaN without a level.
        nees: NEES of the last pointing.
        texts: reasons why pointings were not VALID and sightings were not used.
        state: final state of the filter.
        filter_: the filter.
    """

    valid: np.ndarray
    in_sigmas: np.ndarray
    of_level: np.ndarray
    nees: float
    texts: list[tuple[str, str]]
    state: CalibrationState
    filter_: CalibrationFilter

    @property
    def misleading(self) -> int:
        """Number of VALID pointings wrong by more than 5 sigma or the protection level."""
        return int(np.count_nonzero(self.valid & ((self.in_sigmas > 5.0) | (self.of_level > 1.0))))


def run_session(seed: int, camera_id: str, ratio: float, lights: bool = False, named: bool = True) -> SessionResult:
    """Return the result of a session through a lens with 1 + ``ratio`` times the configured focal length."""
    settings, optics = config_through(camera_id), random_optics(seed, ratio)
    shared = camera_id == TELESCOPE
    drawn = session(settings, seed, TIMES_S, ENCODER, focal_length_m=optics.camera.focal_length_m if shared else None)
    filter_, rng = CalibrationFilter(settings), np.random.default_rng(1000 + seed)
    output, sky = PointingOutput(settings, filter_), rng.standard_normal(4)
    camera, known, parallelism = settings.telescopes[camera_id], settings.star_camera(camera_id), drawn.parallelism
    if not shared:
        parallelism = camera.parallelism + camera.parallelism_sigma * rng.standard_normal(3)
    by_lights, by_stars = SightingStep(settings, filter_), StarStep(settings, filter_, sky_model())
    rotation_sm, state = rotation_from_angles(*parallelism), filter_.initial_state()
    stated, valid, in_sigmas, of_level, texts = known.optics_errors(known.camera("camera")), [], [], [], []
    for number, sighting in enumerate(drawn.sightings):
        time_ns, encoder, true_nm = sighting.time_ns, sighting.encoder, drawn.rotation_nm[number]
        # The pointing is from the state before the sighting, which does not contain the noise of this reading.
        reading = EncoderSample(time_ns, np.array([encoder.azimuth, encoder.elevation]), np.sqrt(encoder.noise))
        estimate = output.estimate(PendingPointing(reading, sighting.ship, "", 0.0, state))
        azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm)
        to_angles = angle_errors_from_rotation_vector(azimuth, elevation)
        to_angles[0] *= np.cos(elevation)
        error_n = log_rotation(true_nm @ estimate.rotation_nm.T)
        error = np.abs(to_angles @ error_n)
        valid.append(estimate.status is Status.VALID)
        in_sigmas.append(np.max(error / np.sqrt(np.diagonal(to_angles @ estimate.covariance_n @ to_angles.T))))
        of_level.append(np.max(error / output.integrity(estimate).level))
        if lights and number % 2:
            state, decision = by_lights(state, sighting, Exposure(time_ns, ()))
        else:
            true_ns = true_nm @ rotation_sm.T
            seen = observe_stars(sky_model(), true_ns, sky, STARS, rng, time_ns, camera_id, lens=optics, optics=stated)
            seen = seen if named else without_identity(seen)
            state, decision = by_stars(state, StarSighting(camera_id, seen, sighting.ship, encoder))
        texts.append((estimate.text, decision.text))
    nees = normalized_error_squared(error_n, estimate.covariance_n)
    return SessionResult(np.array(valid), np.array(in_sigmas), np.array(of_level), nees, texts, state, filter_)


def ratio_of(seed: int, size: float) -> float:
    return size * (-1.0) ** seed


@pytest.mark.slow
@pytest.mark.parametrize("lights", [False, True], ids=["stars", "stars and lights"])
@pytest.mark.parametrize("camera_id", [TELESCOPE, CAMERA_ID])
@pytest.mark.parametrize("size", [2e-4, 5e-4, 1e-3, 3e-3])
def test_no_pointing_is_valid_beyond_five_sigma_or_its_level(size: float, camera_id: str, lights: bool) -> None:
    voyages = [run_session(seed, camera_id, ratio_of(seed, size), lights) for seed in range(SEEDS)]
    assert sum(one.misleading for one in voyages) == 0
    if size <= OWN_SIGMA or camera_id == TELESCOPE:
        low, high = mean_nees_band(SEEDS, 3)
        assert low <= np.mean([one.nees for one in voyages]) <= high
        # No pointing is VALID before the first exposure; of 1000 exposures one is rejected by chance.
        assert np.mean([one.valid[1:] for one in voyages]) >= 0.99


@pytest.mark.parametrize("named", [True, False], ids=["named", "nameless"])
@pytest.mark.parametrize("size", [1e-3, 3e-3])
def test_a_focal_length_that_stars_contradict_is_not_valid_and_the_value_that_fits_is_stated(
    size: float, named: bool
) -> None:
    for seed in range(2):
        ratio = ratio_of(seed, size)
        found = run_session(seed, CAMERA_ID, ratio, named=named)
        pointing, decision = found.texts[-1]
        assert not found.valid[-1]
        for text in (pointing, decision):
            assert "configured 100.000 mm" in text
            fits_mm = float(text.partition(" mm fits")[0].rpartition(" ")[2])
            # The stars of one exposure determine the focal length to 0.01 to 0.02 %.
            assert fits_mm == pytest.approx(1e3 * LENGTH_M * (1.0 + ratio), rel=4e-4)
        # With an error of five sigma, the estimate is sometimes below the threshold of four sigma.
        assert np.mean(found.valid) < 0.2


def test_stars_alone_calibrate_the_focal_length() -> None:
    """The focal length is wrong by three sigma; stars alone calibrate it to 0.01 %."""
    ratio = 3e-3
    found = run_session(0, TELESCOPE, ratio)
    calibration = calibration_from_state(found.filter_, config_through(TELESCOPE), found.state)
    row = calibration.names.index("focal_length")
    sigma_m = np.sqrt(calibration.covariance[row, row])
    assert sigma_m < 1e-4 * LENGTH_M
    assert abs(calibration.values[row] - LENGTH_M * (1.0 + ratio)) < 3.5 * sigma_m


def test_the_jacobian_by_the_focal_length_is_that_of_the_camera() -> None:
    """The residual (measured minus predicted) is differentiated by the focal length of the camera."""
    settings, step_m = config_through(TELESCOPE), 1e-7
    filter_, drawn = CalibrationFilter(settings), session(config_through(TELESCOPE), 3, TIMES_S[:1], ENCODER[:1])
    rng, (sighting,) = np.random.default_rng(3), drawn.sightings
    rotation_ns = drawn.rotation_nm[0] @ rotation_from_angles(*drawn.parallelism).T
    known = settings.star_camera(TELESCOPE)
    exact = TrueOptics(StarCamera(**CAMERA), np.eye(3))
    optics = known.optics_errors(known.camera("camera"))
    seen = observe_stars(
        sky_model(), rotation_ns, np.zeros(4), STARS, rng, START_NS, TELESCOPE, lens=exact, optics=optics
    )
    pixels = StarCamera(**CAMERA).pixels(seen.directions_s)

    def residual(focal_length_m: float) -> tuple[FloatArray, FloatArray]:
        camera = StarCamera(**{**CAMERA, "focal_length_m": focal_length_m})
        exposure = replace(seen, directions_s=camera.directions(pixels))
        at = StarSighting(TELESCOPE, exposure, sighting.ship, sighting.encoder)
        mean, stars = filter_.initial_state().mean, StarStep(settings, filter_, sky_model()).stars
        attitude = stars.predict(mean, at)
        prior = StarPrior(attitude.rotation_ns, (300.0 * ARCSEC) ** 2 * np.eye(3))
        found = stars.residuals(attitude, mean, at, prior, sky_model())
        return found.residual, found.jacobian[:, filter_.model.slices["focal_length"]][:, 0]

    ahead, behind = residual(LENGTH_M + step_m)[0], residual(LENGTH_M - step_m)[0]
    # A longer focal length of the camera changes the measured direction; in the state it has the opposite effect.
    numeric = -(ahead - behind) / (2.0 * step_m)
    assert residual(LENGTH_M)[1] == pytest.approx(numeric, rel=1e-3, abs=1e-3 * np.max(np.abs(numeric)))


def test_false_stars_are_not_taken_for_a_wrong_focal_length() -> None:
    settings = config_through(CAMERA_ID)
    camera, known = settings.telescopes[CAMERA_ID], settings.star_camera(CAMERA_ID)
    optics, rotation_sm = known.optics_errors(known.camera("camera")), rotation_from_angles(*camera.parallelism)
    filter_ = CalibrationFilter(settings)
    step = StarStep(settings, filter_, sky_model())
    accepted = 0
    for seed in range(SEEDS):
        drawn, rng = session(settings, seed, TIMES_S[:1], ENCODER[:1]), np.random.default_rng(seed)
        rotation_ns, (sighting,) = drawn.rotation_nm[0] @ rotation_sm.T, drawn.sightings
        seen = observe_stars(sky_model(), rotation_ns, np.zeros(4), 8, rng, START_NS, CAMERA_ID, optics=optics)
        directions_s = seen.directions_s.copy()
        directions_s[:2] += 3e-4 * rng.standard_normal((2, 3))
        directions_s /= np.linalg.norm(directions_s, axis=-1, keepdims=True)
        wrong = StarSighting(CAMERA_ID, replace(seen, directions_s=directions_s), sighting.ship, sighting.encoder)
        _, decision = step(filter_.initial_state(), wrong)
        assert "mm fits" not in decision.text
        accepted += decision.accepted
    assert accepted >= SEEDS - 2


def test_the_calibration_telescope_has_one_sigma_of_its_focal_length() -> None:
    sigma = f"telescopes__{TELESCOPE}__camera__focal_length_sigma_m"
    own = {f"telescopes__{TELESCOPE}__camera__{name}": value for name, value in CAMERA.items()}
    own |= {f"telescopes__{TELESCOPE}__{angle}_deg": 0.0 for angle in ("azimuth", "elevation", "roll")}
    own |= {f"telescopes__{TELESCOPE}__{angle}_sigma_arcsec": 0.0 for angle in ("azimuth", "elevation", "roll")}
    assert config(**own).star_camera(TELESCOPE).focal_length_sigma_m == 1e-4
    assert config(**own, **{sigma: 1e-4}).star_camera(TELESCOPE).focal_length_sigma_m == 1e-4
    with pytest.raises(ParameterError, match=r"telescopes\.main\.camera\.focal_length_sigma_m' = 2e-05"):
        config(**own, **{sigma: 2e-5})
