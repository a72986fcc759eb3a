"""Stars in a camera on the theodolite: Jacobian, accuracy, identification, contradictions, axis errors.

The numbers of the accuracy are those of models.md §7 and of the error budget: 1.34″ a star over ±4°, with refraction,
position and a parallelism surveyed to 0.2″.
"""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation, skew
from ship_stars.attitude_from_stars.attitude_fit import square_roots
from ship_stars.attitude_from_stars.exposure import ExposureLength, reduce_to_mid_exposure
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.sky.sky_model import SkyModel
from ship_testing.consistency import sigma_ratio_band
from ship_testing.mount_stars import (
    CAMERA_ID,
    STAR_SIGMA,
    MountSession,
    draw_errors,
    mount_config,
    mount_sky,
    random_field,
)
from ship_testing.simulated_session import gauss_markov
from ship_testing.star_sky import TIME_NS, without_identity
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.fault_detection import AxisExclusion
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.star_step import StarStep
from theodolite_calib.filter.subfilters import ENCODER
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput
from theodolite_calib.samples.samples import Mode, PointingEstimate
from theodolite_calib.samples.sighting import StarSighting

SETTINGS = mount_config()
SEEDS = 50
SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module", name="sky_model")
def _sky() -> SkyModel:
    return mount_sky(SETTINGS)


def unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class Mount:
    """A filter with its step and its output."""

    def __init__(self, settings: OpticalAxisConfig, sky_model: SkyModel) -> None:
        self.settings, self.sky_model, self.filter = settings, sky_model, CalibrationFilter(settings)
        self.step, self._output = StarStep(settings, self.filter, sky_model), PointingOutput(settings, self.filter)

    def run(self, seed: int) -> tuple[MountSession, np.random.Generator]:
        rng = np.random.default_rng(seed)
        return MountSession(self.settings, draw_errors(self.settings, rng), self.sky_model, rng), rng

    def pointing(self, session: MountSession, state: CalibrationState, encoder: FloatArray, time_ns: int = TIME_NS):
        reading = session.reading(encoder, time_ns)
        return self._output.estimate(PendingPointing(reading, session.ship(), "", 0.0, state))


def squared_axis_errors(rotation_nm: FloatArray, estimate: PointingEstimate) -> tuple[float, float, float]:
    """Return the squared error of the axis on the sky, the variance of this error, and the NEES of all three angles."""
    error_n = log_rotation(rotation_nm @ estimate.rotation_nm.T)
    across = estimate.rotation_nm[:, 1:].T
    variance = float(np.trace(across @ estimate.covariance_n @ across.T))
    nees = float(error_n @ np.linalg.solve(estimate.covariance_n, error_n))
    return float(np.sum((across @ error_n) ** 2)), variance, nees


def one_exposure(mount: Mount, count: int) -> tuple[float, float, float]:
    """Return RMS error and stated sigma of the pointing after one exposure (arcsec), and the mean NEES."""
    errors = []
    for seed in range(SEEDS):
        session, rng = mount.run(seed)
        encoder = random_field(rng)
        state, decision = mount.step(mount.filter.initial_state(), session.sighting(encoder, count))
        assert decision.accepted, (seed, decision.text)
        estimate = mount.pointing(session, state, encoder)
        assert (estimate.mode, estimate.status) == (Mode.STARS, Status.VALID)
        assert np.isnan(estimate.rotation_nt).all()  # the calibration telescope has seen nothing
        errors.append(squared_axis_errors(session.main_axis(encoder), estimate))
    squares, variances, nees = np.mean(errors, axis=0)
    return float(np.sqrt(squares)) / ARCSEC, float(np.sqrt(variances)) / ARCSEC, float(nees)


@pytest.mark.parametrize(("count", "most_arcsec"), [(4, 1.2), (8, 0.9)])
def test_one_exposure_matches_its_covariance(sky_model, count: int, most_arcsec: float) -> None:
    rms, sigma, nees = one_exposure(Mount(SETTINGS, sky_model), count)
    low, high = mean_nees_band(SEEDS, 3)
    assert low <= nees <= high
    least, most = sigma_ratio_band(2 * SEEDS)
    assert least <= rms / sigma <= most
    assert rms <= most_arcsec


def streak_exposure(sighting: StarSighting, rng: np.random.Generator) -> tuple[StarSighting, FloatArray]:
    """Return the exposure of a camera that rotates by 3°/s, with streak noise; and the bound of the axis covariance,
    rad²."""
    length = ExposureLength(0.02, SETTINGS.telescopes[CAMERA_ID].camera.camera("camera"), 0.8)
    rate_s = np.deg2rad(3.0) * unit(rng.standard_normal(3) * [0.3, 1.0, 1.0])
    turns = exp_rotation(-np.array(length.nodes.offset_ns)[:, None] * 1e-9 * rate_s)
    residuals_at = reduce_to_mid_exposure(replace(sighting.exposure, length=length), turns)
    assert residuals_at.smear_s is not None
    noise_s = (square_roots(residuals_at.smear_s) @ rng.standard_normal((len(residuals_at), 3, 1)))[..., 0]
    residuals_at = replace(residuals_at, directions_s=unit(residuals_at.directions_s + noise_s))
    # Information of each star on a small rotation of the camera, by hand, from the drawn covariance across the line of
    # sight.
    information = np.zeros((3, 3))
    for direction_s, smear_s in zip(residuals_at.directions_s, residuals_at.smear_s, strict=True):
        across = np.linalg.svd(direction_s[None])[2][1:]
        covariance = STAR_SIGMA**2 * np.eye(2) + across @ smear_s @ across.T
        by_turn = across @ -skew(direction_s)
        information += by_turn.T @ np.linalg.solve(covariance, by_turn)
    return replace(sighting, exposure=residuals_at), np.linalg.inv(information)[1:, 1:]


def test_through_a_camera_that_turns_the_pointing_comes_to_the_bound_of_the_streaks_drawn(sky_model) -> None:
    mount, errors, bounds = Mount(SETTINGS, sky_model), [], []
    for seed in range(SEEDS):
        session, rng = mount.run(500 + seed)
        encoder = random_field(rng)
        sighting, bound = streak_exposure(session.sighting(encoder, 5), rng)
        state, decision = mount.step(mount.filter.initial_state(), sighting)
        assert decision.accepted, decision.text
        errors.append(squared_axis_errors(session.main_axis(encoder), mount.pointing(session, state, encoder)))
        bounds.append(np.trace(bound))
    squares, variances, nees = np.mean(errors, axis=0)
    low, high = mean_nees_band(SEEDS, 3)
    assert low <= nees <= high
    least, most = sigma_ratio_band(2 * SEEDS)
    assert least <= np.sqrt(squares / variances) <= most
    # Along streaks of up to 16 pixels, the noise is six times that of a star at rest.
    assert np.sqrt(np.mean(bounds)) > 2.0 * np.sqrt(2.0 / 5.0) * STAR_SIGMA
    assert np.sqrt(squares) <= 1.15 * np.sqrt(np.mean(bounds))


def test_parallelism_dominates_the_budget(sky_model) -> None:
    mount = Mount(mount_config(parallelism_sigma_arcsec=1.0), sky_model)
    rms, sigma, nees = one_exposure(mount, 4)
    low, high = mean_nees_band(SEEDS, 3)
    assert low <= nees <= high
    assert 1.6 < sigma < 1.9
    assert rms == pytest.approx(sigma, rel=0.2)
    session, rng = mount.run(0)
    encoder = random_field(rng)
    state, _ = mount.step(mount.filter.initial_state(), session.sighting(encoder, 4))
    estimate = mount.pointing(session, state, encoder)
    across = estimate.rotation_nm[:, 1:].T
    parts = {
        source: float(np.sqrt(np.trace(across @ part @ across.T))) / ARCSEC
        for source, part in zip(mount.filter.model.sources, estimate.covariance_by_source_n, strict=True)
    }
    assert max(parts, key=parts.__getitem__) == "parallelism"
    # One sigma in azimuth and in elevation: √2″.
    assert parts["parallelism"] == pytest.approx(np.sqrt(2.0), rel=0.02)
    assert min(parts[name] for name in ("star_noise", "refraction", "ship_position", "earth_rotation")) > 0.0
    np.testing.assert_allclose(estimate.covariance_by_source_n.sum(axis=0), estimate.covariance_n, rtol=1e-9)


@pytest.mark.parametrize("source", ["ship/attitude", "ins/imu"])
def test_the_jacobian_is_that_of_finite_differences(source: str) -> None:
    settings = mount_config(ship__source=source, axes__flexure_sigma_arcsec=10.0, sky__utc_sigma_s=0.01)
    sky_model = mount_sky(settings)
    mount = Mount(settings, sky_model)
    session, rng = mount.run(5)
    encoder, model = random_field(rng), mount.step.stars
    sighting = session.sighting(encoder, 5)
    sighting = replace(sighting, ship=replace(sighting.ship, rate_d=np.array([0.05, 0.01, -0.02])))
    sigma = np.sqrt(np.diagonal(mount.filter.initial_state().covariance))
    mean = 0.3 * sigma * rng.standard_normal(sigma.size)
    # Wide enough that all stars are accepted at any of these states.
    prior = StarPrior(model.predict(mean, sighting).rotation_ns, (300.0 * ARCSEC) ** 2 * np.eye(3))

    def residuals_at(at: FloatArray):
        found = model.residuals(model.predict(at, sighting), at, sighting, prior, sky_model)
        assert len(found.residual) == 10
        return found

    here, camera = residuals_at(mean), model.predict(mean, sighting)
    for column, one in enumerate(sigma):
        if one == 0.0:
            continue
        step = np.zeros(sigma.size)
        step[column] = 0.05 * one
        # The residual is measured minus predicted.
        numeric = (residuals_at(mean - step).residual - residuals_at(mean + step).residual) / (2.0 * step[column])
        assert here.jacobian[:, column] == pytest.approx(numeric, abs=2e-3 * np.max(np.abs(numeric)) + 1e-9)
        ahead, behind = (model.predict(mean + sign * step, sighting).rotation_ns for sign in (1.0, -1.0))
        turned = log_rotation(ahead @ behind.T) / (2.0 * step[column])
        assert camera.by_state_n[:, column] == pytest.approx(turned, abs=1e-6 * np.max(np.abs(turned)) + 1e-12)


def test_stars_without_a_name_are_named_by_the_predicted_pointing(sky_model) -> None:
    mount = Mount(SETTINGS, sky_model)
    named, unnamed = 0, 0
    for seed in range(20):
        session, rng = mount.run(seed)
        sighting = session.sighting(random_field(rng), 6)
        nameless = replace(sighting, exposure=without_identity(sighting.exposure))
        _, decision = mount.step(mount.filter.initial_state(), nameless)
        assert decision.accepted
        names = {component.removesuffix(" up") for component in decision.components if component.endswith(" up")}
        assert names <= {f"HIP {number}" for number in sighting.exposure.hip}
        named, unnamed = named + len(names), unnamed + len(decision.rejected_parts)
    # With a prediction sigma of a minute of arc one star in a hundred has two candidates.
    assert named >= 110
    assert named + unnamed == 120


def test_pointing_without_beacons_stars_and_calibration_is_degraded(sky_model) -> None:
    mount = Mount(SETTINGS, sky_model)
    session, rng = mount.run(0)
    estimate = mount.pointing(session, mount.filter.initial_state(), random_field(rng))
    assert (estimate.mode, estimate.status) == (Mode.ENCODER, Status.DEGRADED)
    assert estimate.text == "no light or star used yet and no calibration loaded: axis errors as configured"


def session_after_shift(session: MountSession) -> MountSession:
    """Return the session after a shift of 100″, which stars cannot attribute to the camera or the encoders."""
    errors = replace(session.errors, parallelism=session.errors.parallelism + np.array([0.0, 100.0, 0.0]) * ARCSEC)
    return MountSession(session.settings, errors, session.sky_model, session.rng)


def test_inconsistent_stars_are_rejected_and_degrade_the_pointing(sky_model) -> None:
    mount = Mount(SETTINGS, sky_model)
    session, _ = mount.run(1)
    encoder = np.array([1.0, 0.9])
    state, _ = mount.step(mount.filter.initial_state(), session.sighting(encoder, 6))
    for number in range(1, 4):
        time_ns = TIME_NS + number * SECOND_NS // 10
        state, decision = mount.step(state, session_after_shift(session).sighting(encoder, 6, time_ns))
        assert not decision.accepted
        assert decision.reason in (Reason.GATE, Reason.ATTITUDE_CONFLICT, Reason.MISIDENTIFIED)
        assert state.consecutive_rejections == number
        estimate = mount.pointing(session, state, encoder, time_ns)
        assert estimate.status is Status.DEGRADED
        assert "stars were inconsistent" in estimate.text
    state, decision = mount.step(state, session.sighting(encoder, 6, TIME_NS + SECOND_NS))
    assert decision.accepted
    assert mount.pointing(session, state, encoder, TIME_NS + SECOND_NS).status is Status.VALID


def test_identified_stars_give_the_attitude_without_encoders(sky_model) -> None:
    """The encoders slipped by a degree: stars without names are not identified, which is no contradiction."""
    mount = Mount(SETTINGS, sky_model)
    session, _ = mount.run(3)
    encoder = np.array([2.0, 0.8])
    sighting = session.sighting(encoder, 6)
    state, _ = mount.step(mount.filter.initial_state(), sighting)
    left_out = AxisExclusion(TIME_NS, reason="slipped")
    state = replace(state, fault_state=replace(state.fault_state, excluded={ENCODER: left_out}))
    slipped = replace(sighting.encoder, azimuth=sighting.encoder.azimuth + np.deg2rad(1.0))
    sighting = replace(sighting, encoder=slipped)
    nameless = replace(sighting, exposure=without_identity(sighting.exposure))
    after, decision = mount.step(state, nameless)
    assert (decision.reason, after.consecutive_rejections) == (Reason.UNIDENTIFIED, 0)
    after, decision = mount.step(state, sighting)
    assert decision.accepted
    camera_ns = mount.step.stars.predict(after.mean, sighting).rotation_ns
    truth_ns = session.main_axis(encoder) @ rotation_from_angles(
        *(SETTINGS.telescopes[CAMERA_ID].parallelism + session.errors.parallelism)
    ).T
    assert np.linalg.norm(log_rotation(camera_ns.T @ truth_ns)[1:]) / ARCSEC < 4.0
    assert mount.pointing(session, after, encoder).status is Status.DEGRADED


def test_one_false_star_is_left_out_and_the_others_are_used(sky_model) -> None:
    mount = Mount(SETTINGS, sky_model)
    session, rng = mount.run(2)
    encoder = random_field(rng)
    sighting = session.sighting(encoder, 6)
    directions_s = sighting.exposure.directions_s.copy()
    directions_s[2] = exp_rotation(np.array([0.0, 60.0, 40.0]) * ARCSEC) @ directions_s[2]
    name = f"HIP {sighting.exposure.hip[2]}"
    wrong = replace(sighting, exposure=replace(sighting.exposure, directions_s=directions_s))
    state, decision = mount.step(mount.filter.initial_state(), wrong)
    assert decision.accepted
    assert [left_out for left_out, _ in decision.rejected_parts] == [name]
    squares, variance, _ = squared_axis_errors(session.main_axis(encoder), mount.pointing(session, state, encoder))
    assert squares < 13.8 * variance  # one in a thousand


def test_exposures_of_a_camera_that_stands_still_are_all_used(sky_model) -> None:
    """Unobservable combinations keep their prior although the stars have a sigma of an arcsecond: no step fails."""
    mount = Mount(SETTINGS, sky_model)
    session, rng = mount.run(4)
    encoder, state = random_field(rng), mount.filter.initial_state()
    for number in range(20):
        state, decision = mount.step(state, session.sighting(encoder, 12, TIME_NS + number * SECOND_NS // 5))
        assert decision.accepted, decision.text
    root = state.observability
    assert np.all(np.isfinite(root))
    # Six combinations of axes and deformation are unknown; stars at one place determine three sums of them.
    assert mount.filter.observability.unobservable_combinations(state.observability)


def test_a_session_of_stars_calibrates_the_axes_for_the_day(sky_model) -> None:
    """Stars all over the sky are used for half a minute, then encoders alone for half a minute.

    The deformation changes during this time.
    """
    settings = mount_config(encoder__sigma_arcsec=0.5, ship__white_sigma_arcsec=0.5)
    mount, seeds, exposures = Mount(settings, sky_model), 6, 120
    deformation = np.full(3, settings.deformation.sigma_arcsec * ARCSEC)
    afterwards_s = np.arange(5.0, 31.0, 5.0)
    squares, nees, left = [], [], []
    for seed in range(seeds):
        session, rng = mount.run(100 + seed)
        times_s = np.concatenate([np.arange(exposures) * 0.25, 0.25 * exposures + afterwards_s])
        bent_d = gauss_markov(rng, times_s, deformation, settings.deformation.time_s)
        state = mount.filter.initial_state()
        for time_s, turn_d in zip(times_s, bent_d, strict=True):
            now = MountSession(settings, replace(session.errors, deformation_d=turn_d), sky_model, rng)
            encoder, time_ns = random_field(rng), TIME_NS + round(time_s * SECOND_NS)
            if time_s < 0.25 * exposures:
                state, decision = mount.step(state, now.sighting(encoder, 6, time_ns))
                assert decision.accepted, decision.text
                continue
            estimate = mount.pointing(now, state, encoder, time_ns)
            one = squared_axis_errors(now.main_axis(encoder), estimate)
            squares.append(one[0])
            if time_s == times_s[-4]:
                nees.append(one[2])
        assert (estimate.mode, estimate.status) == (Mode.ENCODER, Status.COASTING)
        left.append(np.sqrt(np.diagonal(state.covariance)[mount.filter.model.slices["axes"]]) / ARCSEC)
    assert np.sqrt(np.mean(squares)) / ARCSEC < 8.0
    low, high = mean_nees_band(seeds, 3)
    assert low <= np.mean(nees) <= high
    # Collimation and tilt of the horizontal axis are estimated. The other axis errors cannot be separated from the
    # deformation; the filter reports them as unobservable (theodolite/calibration).
    assert np.max(np.array(left)[:, 2:4]) < 4.0
