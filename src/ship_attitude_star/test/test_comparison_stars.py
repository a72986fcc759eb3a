"""Single stars in the filter: Jacobians, information of one star, rejections, identification by the prediction."""

from dataclasses import replace

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.prediction import predict_attitude
from ship_estimation.parameters.schema import build
from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_stars.attitude_from_stars.residuals import SOURCE_STAR_NOISE, PredictedSensor, star_residuals
from ship_stars.attitude_samples import AttitudeMeasurement, InertialAttitude, PositionFix
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.errors import FIELD_MODES, SOURCE_PIXEL, SpatialErrors
from ship_stars.sky.sky_model import sky_slice
from ship_testing.star_sky import (
    ROTATION_ND,
    SENSORS,
    TIME_NS,
    configuration,
    exposure_of,
    ins_track,
    sky_at_anchor,
    without_identity,
)

CONFIG = configuration()
FIELD = {"field_spatial_sigma_px": 0.3}


@pytest.fixture(scope="module")
def sky_model():
    return sky_at_anchor(CONFIG)


@pytest.fixture(scope="module")
def ship_filter():
    return ShipFilter(CONFIG)


def residuals(ship_filter, sky_model, exposure, mean):
    """Residuals of an exposure at a state."""
    state = ship_filter.initial_state()
    ins = ins_track().at(TIME_NS)
    predicted = predict_attitude(ship_filter.devices[exposure.source], ship_filter.model, mean, ins)
    prior, model = predicted.prior(state.covariance), ship_filter.model
    field = f"{exposure.source}.field"
    field_rows = model.state_indices(field) if field in model.slices else None
    return star_residuals(
        exposure,
        PredictedSensor(predicted.rotation_nv, predicted.jacobian_v, mean),
        prior,
        sky_model,
        sky_slice(model.slices),
        camera_indices=field_rows,
    )


def with_field(exposure):
    """Return the exposure of a camera with a field-spatial error, and a filter that models this error."""
    camera = {"focal_length_m": 0.05, "pixel_pitch_m": 5.5e-6, "principal_u_px": 1023.5, "principal_v_px": 1023.5}
    sensors = {"fore": {"input": "observations", **SENSORS["fore"], "camera": {**camera, **FIELD}}}
    config = build(ShipAttitudeConfig, {"star_sensors": sensors})
    spatial = config.star_sensors["fore"].camera.spatial_errors(StarCamera(**camera))
    return replace(exposure, spatial=spatial), ShipFilter(config)


def test_pixel_errors_of_a_second_exposure_decorrelate_with_star_motion(sky_model):
    """The pixel variance is multiplied by coth d; for stars that do not move at all the factor is the maximum, 1000."""
    exposure = exposure_of(sky_model, "fore", 4)
    exposure = replace(exposure, spatial=SpatialErrors(StarCamera(0.05, 5.5e-6, 1023.5, 1023.5), 0.0, 0.2))
    ship_filter = ShipFilter(CONFIG)
    mean, alone = np.zeros(ship_filter.model.size), exposure.with_pixel_dwell(None)
    again = exposure.with_pixel_dwell(alone.pixel_dwell)
    first, second = (residuals(ship_filter, sky_model, one, mean).noise[SOURCE_PIXEL] for one in (alone, again))
    np.testing.assert_allclose(np.diagonal(first), np.repeat(exposure.pixel_sigma**2, 2))
    np.testing.assert_allclose(second, 1000.0 * first)


def test_the_filter_stores_the_pixel_dwell_of_a_sensor(sky_model):
    camera = {"focal_length_m": 0.05, "pixel_pitch_m": 5.5e-6, "pixel_spatial_sigma_px": 0.2}
    config = build(
        ShipAttitudeConfig,
        {"star_sensors": {"fore": {"input": "observations", **SENSORS["fore"], "camera": camera}}},
    )
    ship_filter, sensor = ShipFilter(config), config.star_sensors["fore"].camera
    exposure = exposure_of(sky_model, "fore", 4)
    exposure = replace(exposure, spatial=sensor.spatial_errors(sensor.camera("camera")))
    state, first = ship_filter.step(ship_filter.initial_state(), exposure, ins_track(), sky_model)
    later = replace(exposure, time_ns=TIME_NS + 50_000_000)
    state, second = ship_filter.step(state, later, ins_track(), sky_model)
    assert first.accepted
    assert second.accepted
    assert state.pixel_dwells["star.fore"].exposure_count == 1
    assert np.trace(second.noise) > 3.0 * np.trace(first.noise)


def test_the_map_of_the_field_is_a_state_of_its_sensor(sky_model):
    exposure, ship_filter = with_field(exposure_of(sky_model, "fore", 4))
    rows = ship_filter.model.slices["star.fore.field"]
    assert rows.stop - rows.start == FIELD_MODES
    here = residuals(ship_filter, sky_model, exposure, np.zeros(ship_filter.model.size))
    assert np.any(here.jacobian[:, rows], axis=1).all()
    assert_jacobian_is_derivative(ship_filter, sky_model, exposure)


def test_the_jacobian_is_the_derivative(ship_filter, sky_model):
    assert_jacobian_is_derivative(ship_filter, sky_model, exposure_of(sky_model, "fore", 4))


def assert_jacobian_is_derivative(ship_filter, sky_model, exposure):
    rng = np.random.default_rng(1)
    sigma = np.sqrt(np.diagonal(ship_filter.initial_state().covariance))
    mean = 0.3 * sigma * rng.standard_normal(ship_filter.model.size)
    here = residuals(ship_filter, sky_model, exposure, mean)
    assert here.residual.shape == (8,)
    for row in np.flatnonzero(sigma > 0.0):
        step = np.zeros(ship_filter.model.size)
        step[row] = 1e-2 * sigma[row]
        up, down = (residuals(ship_filter, sky_model, exposure, mean + sign * step) for sign in (1.0, -1.0))
        # Residual = measured - predicted, so it falls where the prediction grows.
        numeric = (down.residual - up.residual) / (2.0 * step[row])
        scale = max(np.max(np.abs(here.jacobian[:, row])), 1e-9)
        np.testing.assert_allclose(here.jacobian[:, row], numeric, atol=1e-4 * scale)


def test_one_star_improves_two_components_to_the_bound_and_leaves_the_third(ship_filter, sky_model):
    exposure = exposure_of(sky_model, "fore", 1)
    before = ship_filter.propagate(ship_filter.initial_state(), TIME_NS)
    after, decision = ship_filter.step(before, exposure, ins_track(), sky_model)
    assert decision.accepted
    star_n = sky_model.sky_at(TIME_NS).apparent_stars(exposure.positions).direction_n[0]
    # Bound: information of the star and the prior, with mounting and shared errors as further noise across the star.
    rows = ship_filter.model.state_indices("ins.attitude")
    prior = before.covariance[np.ix_(rows, rows)]
    posterior = after.covariance[np.ix_(rows, rows)]
    compared = residuals(ship_filter, sky_model, exposure, before.mean)
    jacobian = compared.jacobian
    own = jacobian.copy()
    own[:, rows] = 0.0
    noise = own @ before.covariance @ own.T + compared.noise[SOURCE_STAR_NOISE]
    h = jacobian[:, rows]
    bound = np.linalg.inv(np.linalg.inv(prior) + h.T @ np.linalg.inv(noise) @ h)
    np.testing.assert_allclose(posterior, bound, rtol=1e-6, atol=1e-18)
    # The star gives no information about the rotation about its own direction.
    information_gain = np.linalg.inv(posterior) - np.linalg.inv(prior)
    assert star_n @ information_gain @ star_n < 1e-9 * np.trace(information_gain)


@pytest.mark.parametrize("count", [1, 2, 8])
def test_the_estimate_converges_to_the_truth(ship_filter, sky_model, count):
    error_n = np.array([12.0, -60.0, 8.0]) * ARCSEC
    state = ship_filter.initial_state()
    for id_ in ("fore", "starboard"):
        exposure = exposure_of(sky_model, id_, count)
        state, decision = ship_filter.step(state, exposure, ins_track(error_n=error_n), sky_model)
        assert decision.accepted
    rows = ship_filter.model.state_indices("ins.attitude")
    left = error_n - state.mean[rows]
    covariance = state.covariance[np.ix_(rows, rows)]
    # Noise-free stars: the remaining error is that of the prior.
    assert left @ np.linalg.solve(covariance, left) < 3.0
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(error_n)


def test_a_star_of_another_identity_is_rejected_by_name_and_the_rest_is_used(ship_filter, sky_model):
    exposure = exposure_of(sky_model, "fore", 6)
    swapped = [1, 0, 2, 3, 4, 5]
    wrong = replace(exposure, hip=exposure.hip[swapped], positions=exposure.positions[swapped])
    _, decision = ship_filter.step(ship_filter.initial_state(), wrong, ins_track(), sky_model)
    assert decision.accepted
    assert {name for name, _ in decision.rejected_parts} == {f"HIP {hip}" for hip in exposure.hip[:2]}
    assert all(rejection.reason is Reason.MISIDENTIFIED for _, rejection in decision.rejected_parts)
    assert decision.components[0] == f"HIP {exposure.hip[2]} up"


def test_stars_that_agree_against_the_ins_are_a_conflict_with_a_hint(sky_model):
    config = configuration(gate={"conflict_after": 1})
    ship_filter = ShipFilter(config)
    error_n = np.array([0.0, np.deg2rad(90.0), 0.0])
    _, decision = ship_filter.step(
        ship_filter.initial_state(), exposure_of(sky_model, "fore", 8), ins_track(error_n=error_n), sky_model
    )
    assert decision.reason is Reason.ATTITUDE_CONFLICT
    assert "90" in decision.text


@pytest.mark.parametrize("field", ["rotation_nv", "noise_v"])
def test_nan_passes_no_gate(field):
    ship_filter = ShipFilter(build(ShipAttitudeConfig, {"star_sensors": {"fore": SENSORS["fore"]}}))
    rotation_ns = ROTATION_ND @ ship_filter.devices["star.fore"].rotation_dv0
    good = AttitudeMeasurement("star.fore", TIME_NS, rotation_ns, np.diag((np.array([20.0, 3.0, 3.0]) * ARCSEC) ** 2))
    before = ship_filter.initial_state()
    values = getattr(good, field).copy()
    values[1, 1] = np.nan
    after, decision = ship_filter.step(before, replace(good, **{field: values}), ins_track(), None)
    assert decision.reason in (Reason.GATE, Reason.BAD_COVARIANCE)
    assert after.mean.tobytes() == before.mean.tobytes()
    assert after.covariance_by_source.tobytes() == before.covariance_by_source.tobytes()
    assert ship_filter.step(after, good, ins_track(), None)[1].accepted


def test_no_fix_and_no_earth_orientation_are_named(ship_filter, sky_model):
    exposure = exposure_of(sky_model, "fore", 4)
    late_ns = TIME_NS + 600 * 1_000_000_000
    _, decision = ship_filter.step(
        ship_filter.initial_state(), replace(exposure, time_ns=late_ns), ins_track(late_ns), sky_model
    )
    assert decision.reason is Reason.NO_FIX
    assert "fix_max_age_s" in decision.text
    far_ns = TIME_NS + 40 * 365 * 86_400 * 1_000_000_000
    _, decision = ship_filter.step(
        ship_filter.initial_state(), replace(exposure, time_ns=far_ns), ins_track(far_ns), sky_model
    )
    assert decision.reason is Reason.NO_EARTH_ORIENTATION


def test_fixes_in_any_order_end_in_the_same_state():
    """A fix that arrives after the exposures is used for them as if it had arrived before."""
    config = configuration()
    sky = sky_at_anchor(config)
    exposures = [exposure_of(sky, "fore", 5, time_ns=TIME_NS + step * 200_000_000) for step in range(5)]
    second = 1_000_000_000
    fixes = [
        PositionFix(
            TIME_NS + offset, GeodeticPosition(0.5575, 2.0995 + 1e-6 * offset / second, 20.0), np.eye(3) * 25.0
        )
        for offset in (-second, 0, second)
    ]
    ins = [AttitudeSample(TIME_NS + step * 100_000_000, ROTATION_ND, np.zeros(3)) for step in range(-3, 14)]

    def end(order):
        core = ShipAttitudeCore(config, sky_at_anchor(config))
        core.sky_model.reset()
        for item in order:
            if isinstance(item, PositionFix):
                core.add_surroundings(item)
            elif isinstance(item, AttitudeSample):
                core.ins.add(item, estimate=False)
            else:
                core.add_measurement(item)
        return core.state

    first = end([*fixes, *ins, *exposures])
    last = end([*ins, *exposures, *reversed(fixes)])
    np.testing.assert_array_equal(first.mean, last.mean)
    np.testing.assert_array_equal(first.covariance_by_source, last.covariance_by_source)
    assert first.last_used_ns["star.fore"] == exposures[-1].time_ns


def test_stars_without_identity_are_identified_by_the_prediction(ship_filter, sky_model):
    exposure = exposure_of(sky_model, "fore", 8, np.random.default_rng(3))
    unknown = without_identity(exposure)
    state, known = ship_filter.step(ship_filter.initial_state(), exposure, ins_track(), sky_model)
    found_state, found = ship_filter.step(ship_filter.initial_state(), unknown, ins_track(), sky_model)
    assert found.components == known.components
    np.testing.assert_allclose(found_state.mean, state.mean, rtol=0, atol=1e-12)


def test_an_attitude_against_the_icrs_gives_the_horizon_attitude(sky_model):
    """An attitude against the ICRS that is computed from the true horizon attitude gives a residual below 0.1″."""
    config = configuration()
    config = replace(
        config, star_sensors={id_: replace(s, input="inertial_attitude") for id_, s in config.star_sensors.items()}
    )
    ship_filter = ShipFilter(config)
    device = ship_filter.devices["star.fore"]
    rotation_ns = ROTATION_ND @ device.rotation_dv0
    sky = sky_model.sky_at(TIME_NS)
    elevation = np.arcsin(rotation_ns[1, 0])
    angle, _ = sky.refraction_at(elevation)
    level = np.array([-rotation_ns[2, 0], 0.0, rotation_ns[0, 0]]) / np.hypot(rotation_ns[0, 0], rotation_ns[2, 0])
    seen = sky.rotation_horizon_from_icrs().T @ exp_rotation(-angle * level) @ rotation_ns
    inertial = InertialAttitude("star.fore", TIME_NS, seen, np.diag((np.array([20.0, 3.0, 3.0]) * ARCSEC) ** 2))
    _, decision = ship_filter.step(ship_filter.initial_state(), inertial, ins_track(), sky_model)
    assert decision.accepted
    # The test takes refraction at the apparent instead of the true elevation, an error of a few 0.01″.
    assert np.linalg.norm(decision.residual) < 0.1 * ARCSEC
    assert np.linalg.norm(log_rotation(seen)) > 0.1


def test_the_alignment_states_the_errors_of_the_optics_in_their_own_units() -> None:
    camera = {"focal_length_m": 0.05, "pixel_pitch_m": 5.5e-6, "focal_length_sigma_m": 2e-5, "principal_sigma_px": 0.5}
    config = configuration()
    sensors = {id_: replace(one, camera=replace(one.camera, **camera)) for id_, one in config.star_sensors.items()}
    config = replace(config, star_sensors=sensors)
    ship_filter = ShipFilter(config)
    state = ship_filter.initial_state()
    means = state.means.copy()
    means[:, ship_filter.model.slices["star.fore.optics"]] = [2.0, -1.0, 3.0, 0.5]
    found = current_alignment(ship_filter, config, replace(state, means=means))
    sigmas = np.sqrt(np.diagonal(found.covariance))
    # The states are in sigmas: 4e-4 for the relative focal length, 0.5 px for the principal point, 0.01 for k1.
    expected = {
        "focal_length": ("1", 8e-4, 4e-4),
        "principal_u": ("px", -0.5, 0.5),
        "principal_v": ("px", 1.5, 0.5),
        "distortion_k1": ("1", 0.005, 0.01),
    }
    for name, (unit, value, sigma) in expected.items():
        row = found.names.index(f"star.fore.{name}")
        assert found.units[row] == unit
        assert (found.values[row], sigmas[row]) == pytest.approx((value, sigma))


def test_the_optics_may_drift_with_temperature() -> None:
    """After an hour the variance has grown by the square of a tenth of each sigma, whatever was estimated before."""
    ship_filter = ShipFilter(configuration())
    rows = ship_filter.model.slices["star.fore.optics"]
    state = ship_filter.propagate(ship_filter.initial_state(), TIME_NS)
    known = state.stack.copy()
    known[:, rows] = known[:, :, rows] = 0.0
    later = ship_filter.propagate(replace(state, stack=known), TIME_NS + 3600 * 1_000_000_000)
    np.testing.assert_allclose(later.covariance[rows, rows], 0.01 * np.eye(4), rtol=1e-6, atol=1e-12)
