"""Stars of an exposure: directions at mid-exposure, their errors, and identification."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.device import LinearisationPoint
from ship_attitude_star.ship_attitude.measurements.prediction import predict_attitude
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.tracks.exposure_mean import exposure_motion
from ship_stars.attitude_from_stars.attitude_fit import fit_attitude, linearise_stars
from ship_stars.attitude_from_stars.exposure import ExposureLength, identify_stars, reduce_to_mid_exposure
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.attitude_samples import PositionFix
from ship_stars.camera.camera import Distortion, StarCamera, equivalent_sigma, tangent_basis
from ship_testing.star_scenes import draw_scene
from ship_testing.star_sky import (
    MAGNITUDE_LIMIT,
    POSITION,
    ROTATION_ND,
    TIME_NS,
    configuration,
    exposure_of,
    sky_at_anchor,
    without_identity,
)

CONFIG = configuration()
CAMERA = StarCamera(0.05, 5.5e-6, 1023.5, 1023.5, Distortion(k1=-0.08, p1=2e-4))
PSF_PX = 0.8
SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def sky_model():
    return sky_at_anchor(CONFIG)


def rolling(since_s: float) -> FloatArray:
    """Return the attitude of a deck that rolls 4° in 11 s, at its crest at time zero, and pitches and turns."""
    roll = np.deg2rad(4.0) * (np.cos(2.0 * np.pi * since_s / 11.0) - 1.0)
    pitch = np.deg2rad(1.8) * np.sin(2.0 * np.pi * since_s / 8.0)
    return ROTATION_ND @ rotation_from_angles(np.deg2rad(1.5) * since_s, pitch, roll)


def rolling_track(first_s: float = -1.0, last_s: float = 1.0) -> AttitudeTrack:
    track = AttitudeTrack(500_000_000)
    for sample in ins_samples(first_s, last_s):
        track.insert(sample)
    return track


def ins_samples(first_s: float = -1.0, last_s: float = 1.0) -> list[AttitudeSample]:
    samples = []
    for step in range(round(100 * first_s), round(100 * last_s) + 1):
        rate_d = log_rotation(rolling(0.01 * step - 1e-4).T @ rolling(0.01 * step + 1e-4)) / 2e-4
        samples.append(AttitudeSample(TIME_NS + step * 10_000_000, rolling(0.01 * step), rate_d))
    return samples


def with_streaks(exposure, rotation_ds: FloatArray, exposure_s: float):
    """Return the exposure with centroids that are the means of a thousand pixels each, and those pixels."""
    since_s = exposure_s * ((np.arange(1000) + 0.5) / 1000 - 0.5)
    turns = np.array([(rolling(t) @ rotation_ds).T @ rolling(0.0) @ rotation_ds for t in since_s])
    pixels = CAMERA.pixels(exposure.directions_s @ np.swapaxes(turns, -1, -2))
    length = ExposureLength(exposure_s, CAMERA, PSF_PX)
    return replace(exposure, directions_s=CAMERA.directions(pixels.mean(axis=0)), length=length), pixels


def reduced_to_middle(exposure, rotation_ds: FloatArray):
    return reduce_to_mid_exposure(
        exposure, exposure_motion(rolling_track(), TIME_NS, exposure.length.nodes).in_device_frame(rotation_ds).turns
    )


@pytest.mark.parametrize("sensor", ["fore", "starboard"])
@pytest.mark.parametrize(("exposure_s", "least_arcsec"), [(0.05, 0.2), (0.1, 1.0), (0.2, 4.0), (1.0, 100.0)])
def test_the_correction_moves_a_centroid_to_mid_exposure(sky_model, sensor, exposure_s, least_arcsec):
    rotation_ds = CONFIG.star_sensors[sensor].rotation_ds
    true = exposure_of(sky_model, sensor, 8)
    seen, _ = with_streaks(true, rotation_ds, exposure_s)
    off = np.linalg.norm(seen.directions_s - true.directions_s, axis=-1)
    left = np.linalg.norm(reduced_to_middle(seen, rotation_ds).directions_s - true.directions_s, axis=-1)
    assert off.max() > least_arcsec * ARCSEC
    assert left.max() < max(0.005 * ARCSEC, 2e-3 * off.max())


@pytest.mark.parametrize("exposure_s", [0.05, 0.2])
def test_the_noise_grows_only_along_the_streak(sky_model, exposure_s):
    rotation_ds = CONFIG.star_sensors["fore"].rotation_ds
    seen, pixels = with_streaks(exposure_of(sky_model, "fore", 8), rotation_ds, exposure_s)
    found = reduced_to_middle(seen, rotation_ds)
    streak_px = pixels[-1] - pixels[0]
    length_px = np.linalg.norm(streak_px, axis=-1)
    assert np.all(length_px > 10.0 * exposure_s / 0.05)
    scale = equivalent_sigma(CAMERA.direction_covariance(pixels[500], 1.0))
    sigma_px = seen.sigma / scale
    along = CAMERA.directions(pixels[500] + 0.5 * streak_px / length_px[:, None])
    along -= CAMERA.directions(pixels[500] - 0.5 * streak_px / length_px[:, None])
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.cross(found.directions_s, along)
    expected = sigma_px**2 * length_px**2 / (12.0 * PSF_PX**2)
    added = np.einsum("ki,kij,kj->k", along, found.smear_s, along) / scale**2
    # The camera's scale depends on position and direction in the field, which one sigma for both axes neglects.
    np.testing.assert_allclose(added, expected, rtol=0.03)
    assert np.all(np.einsum("ki,kij,kj->k", across, found.smear_s, across) < 1e-3 * expected * scale**2)
    outward = np.einsum("kij,kj->ki", found.smear_s, found.directions_s)
    assert np.max(np.abs(outward)) < 1e-4 * np.max(found.smear_s)


def test_a_star_that_leaves_the_field_during_the_exposure_has_no_weight(sky_model):
    seen = replace(exposure_of(sky_model, "fore", 3), length=ExposureLength(10.0, CAMERA, PSF_PX))
    turning = exposure_motion(rolling_track(-6.0, 6.0), TIME_NS, seen.length.nodes)
    away = np.array([rotation_from_angles(np.deg2rad(20e-9 * ns), 0.0, 0.0) for ns in turning.nodes.offset_ns])
    found = reduce_to_mid_exposure(seen, away)
    np.testing.assert_array_equal(found.directions_s, seen.directions_s)
    assert np.all(np.trace(found.smear_s, axis1=-2, axis2=-1) > 1.0)


def smeared_scene(rng: np.random.Generator):
    """Return a scene of two sensors in which all stars are streaks, with the noise of streaks."""
    scene = draw_scene(rng, (5, 4))
    streak = rng.standard_normal((len(scene.stars), 3)) * 30.0 * ARCSEC
    streak -= np.sum(streak * scene.stars.measured_b, axis=-1)[:, None] * scene.stars.measured_b
    measured = scene.stars.measured_b + streak * rng.standard_normal((len(streak), 1))
    measured /= np.linalg.norm(measured, axis=-1, keepdims=True)
    smear = streak[:, :, None] * streak[:, None, :]
    return scene, replace(scene.stars, measured_b=measured, smear_b=smear)


def test_the_attitude_by_streaks_is_the_most_likely_one():
    """The fit equals scipy's least squares with residuals weighted by the two by two covariance of each star."""
    _, stars = smeared_scene(np.random.default_rng(3))
    found = fit_attitude(stars)
    basis = tangent_basis(stars.reference_n)

    def residuals(vector: FloatArray) -> FloatArray:
        rotation_nb = exp_rotation(vector) @ found.rotation_nb
        left = np.einsum("kij,kj->ki", basis, stars.reference_n - stars.measured_b @ rotation_nb.T)
        across = basis @ rotation_nb @ stars.smear_b @ np.swapaxes(basis @ rotation_nb, -1, -2)
        across = across + (stars.white_sigma**2)[:, None, None] * np.eye(2)
        return np.linalg.solve(np.linalg.cholesky(across), left[..., None]).ravel()

    best = least_squares(residuals, np.full(3, 5.0 * ARCSEC), x_scale=ARCSEC, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.max(np.abs(best.x)) < 0.01 * ARCSEC
    np.testing.assert_allclose(found.white_covariance_n, np.linalg.inv(best.jac.T @ best.jac), rtol=1e-3)


def test_the_linearised_streaks_are_the_derivative():
    _, stars = smeared_scene(np.random.default_rng(4))
    rotation_nb = fit_attitude(stars).rotation_nb
    fit, step = linearise_stars(stars, rotation_nb), 1e-7
    for axis in range(3):
        turned = linearise_stars(stars, exp_rotation(-step * np.eye(3)[axis]) @ rotation_nb)
        numeric = (turned.displacement - fit.displacement) / step
        assert np.max(np.abs(numeric - fit.jacobian[:, :, axis])) < 1e-3 * np.max(np.abs(fit.jacobian[:, :, :3]))


def streaked_exposure(sky_model, exposure_s: float = 0.2):
    return with_streaks(exposure_of(sky_model, "fore", 6), CONFIG.star_sensors["fore"].rotation_ds, exposure_s)[0]


def test_the_filter_s_jacobian_with_streaks_is_the_derivative(sky_model):
    ship_filter = ShipFilter(CONFIG)
    state = ship_filter.initial_state()
    sigma = np.sqrt(np.diagonal(state.covariance))
    rng = np.random.default_rng(1)
    mean = 0.3 * sigma * rng.standard_normal(ship_filter.model.size)
    seen = reduced_to_middle(streaked_exposure(sky_model), CONFIG.star_sensors["fore"].rotation_ds)
    ins = rolling_track().at(TIME_NS)

    def residuals_at(mean: FloatArray):
        predicted = predict_attitude(ship_filter.devices["star.fore"], ship_filter.model, mean, ins)
        at = LinearisationPoint(ship_filter.model, mean, state.covariance, predicted, sky_model)
        return ship_filter.devices["star.fore"].linearise(seen, at).linear

    here = residuals_at(mean)
    noise = here.noise_by_source[ship_filter.model.sources.index("star_noise")]
    assert np.max(np.abs(noise - np.diag(np.diagonal(noise)))) > 0.1 * np.max(noise)
    clock = ship_filter.model.slices["ins.time_offset"].start
    for row in np.flatnonzero(sigma > 0.0):
        if row == clock:
            continue  # the clock offset changes the INS attitude, which is constant here
        step = np.zeros(ship_filter.model.size)
        step[row] = 1e-2 * sigma[row]
        numeric = (residuals_at(mean - step).residual - residuals_at(mean + step).residual) / (2.0 * step[row])
        scale = max(np.max(np.abs(here.jacobian[:, row])), 1e-9)
        np.testing.assert_allclose(here.jacobian[:, row], numeric, atol=1e-4 * scale)


def test_the_filter_models_streaks(sky_model):
    ship_filter = ShipFilter(CONFIG)
    start, track = ship_filter.initial_state(), rolling_track()
    seen = streaked_exposure(sky_model)
    true = exposure_of(sky_model, "fore", 6)
    _, right = ship_filter.step(start, seen, track, sky_model)
    _, still = ship_filter.step(start, true, track, sky_model)
    _, wrong = ship_filter.step(start, replace(seen, length=None), track, sky_model)
    assert right.accepted
    assert still.accepted
    assert right.measurement is seen
    assert np.max(np.abs(right.residual - still.residual)) < 0.01 * ARCSEC
    assert np.max(np.abs(wrong.residual - still.residual)) > 4.0 * ARCSEC
    assert np.max(right.sigma) > 1.05 * np.max(still.sigma)


def core_with_fix(sky_model) -> ShipAttitudeCore:
    core = ShipAttitudeCore(CONFIG, sky_model)
    core.add_surroundings(PositionFix(TIME_NS - SECOND_NS, POSITION, 25.0 * np.eye(3)))
    return core


def test_an_exposure_waits_for_the_ins_to_its_end_and_any_order_gives_the_same_state():
    states = []
    for after in (5, 60, 110, 200):
        core = core_with_fix(sky_at_anchor(CONFIG))
        exposure = streaked_exposure(sky_at_anchor(CONFIG))
        samples = ins_samples()
        decisions = []
        for sample in samples[:after]:
            decisions += core.ins.add(sample).decisions
        decisions += core.add_measurement(exposure).decisions
        for number, sample in enumerate(samples[after:], after):
            made = core.ins.add(sample).decisions
            # 100 samples lie before the middle of the exposure, ten more before its end.
            assert not made or number >= 110
            decisions += made
        assert [decision.reason for decision in decisions] == [Reason.NONE]
        states.append(core.state)
    for state in states[1:]:
        assert state.mean.tobytes() == states[0].mean.tobytes()
        assert state.covariance_by_source.tobytes() == states[0].covariance_by_source.tobytes()


def test_a_late_ins_sample_within_the_exposure_is_used_for_it():
    samples, held_back = ins_samples(), 107
    states = []
    for late in (False, True):
        core = core_with_fix(sky_at_anchor(CONFIG))
        for number, sample in enumerate(samples):
            if not (late and number == held_back):
                core.ins.add(sample)
            if number == 50:
                core.add_measurement(streaked_exposure(sky_at_anchor(CONFIG)))
        if late:
            core.ins.add(samples[held_back])
        states.append(core.state)
    assert states[1].mean.tobytes() == states[0].mean.tobytes()


def test_an_exposure_without_ins_samples_over_its_length_is_rejected():
    core = core_with_fix(sky_at_anchor(CONFIG))
    core.add_measurement(streaked_exposure(sky_at_anchor(CONFIG)))
    decisions = []
    for sample in ins_samples(first_s=-0.05):
        decisions += core.ins.add(sample).decisions
    assert [decision.reason for decision in decisions] == [Reason.GAP]
    assert "whole exposure of 0.2 s" in decisions[0].text


def test_identification_rejects_ambiguous_and_unmatched_detections(sky_model):
    exposure = exposure_of(sky_model, "fore", 4)
    twice = replace(exposure, directions_s=exposure.directions_s[[0, 0, 2, 3]])
    nowhere = twice.directions_s.copy()
    nowhere[3] = exp_rotation(np.deg2rad([0.0, 0.2, 0.0])) @ nowhere[3]
    unknown = without_identity(replace(twice, directions_s=nowhere))
    device = ShipFilter(CONFIG).devices["star.fore"]
    prior = StarPrior(ROTATION_ND @ device.rotation_dv0, np.diag((np.array([10.0, 72.0, 10.0]) * ARCSEC) ** 2))
    result, reasons = identify_stars(unknown, prior, sky_model.sky_at(TIME_NS))
    assert result.hip.tolist() == [0, 0, exposure.hip[2], 0]
    assert set(reasons) == {0, 1, 3}
    assert "matched by two detections" in reasons[0].text
    assert "no catalogue star within the gate" in reasons[3].text
    assert CONFIG.sky.magnitude_limit > MAGNITUDE_LIMIT
