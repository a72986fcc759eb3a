"""Single stars and star solutions lead to the same attitude, with priors from a minute of arc to half a turn.

Truth is drawn from the filter's prior: error of the INS, its white noise, mounting, and the errors common to all stars.
"""

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, left_jacobian, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.attitude_from_stars.solution import SolutionStatus, solve_stars, solve_with_fallback
from ship_stars.attitude_samples import AttitudeMeasurement
from ship_stars.sky.sky_model import SkyModel
from ship_testing.adapter_runs import START_NS, change_where, stamp_of
from ship_testing.ship_observations import run_new_adapter
from ship_testing.small_voyage import INS, quaternion_message
from ship_testing.star_sky import (
    ROTATION_ND,
    SENSORS,
    SIGMA,
    TIME_NS,
    configuration,
    exposure_of,
    ins_track,
    sky_at_anchor,
)
from ship_testing.star_voyage import true_deck, voyage

SEEDS = 40
MINUTE, DEGREE = 60.0, 3600.0
INSTALLATION = np.array([20.0, 1.0, 1.0]) * ARCSEC
"""Default sigmas of the installation of a star sensor, rad."""


@dataclass(frozen=True)
class Width:
    """Sigmas of the INS's error, arcseconds."""

    heading: float
    tilt: float

    def config(self, kind: str) -> ShipAttitudeConfig:
        """Return the configuration; ``replace`` sets the sigmas, as half a turn is out of the parameters' range."""
        config = configuration()
        ins = replace(config.ins, heading_sigma_arcsec=self.heading, tilt_sigma_arcsec=self.tilt)
        sensors = {id_: replace(sensor, input=kind) for id_, sensor in config.star_sensors.items()}
        return replace(config, ins=ins, star_sensors=sensors)


@dataclass(frozen=True)
class Sky:
    """Exposures without errors by sensor and stamp, with apparent directions and displacements by shared errors."""

    sky_model: SkyModel
    fields: dict[tuple[str, int], tuple[StarExposure, FloatArray, FloatArray]]

    def exposure_with_errors(
        self, id_: str, time_ns: int, count: int, mounted_s: FloatArray, shared: FloatArray, rng: Any
    ):
        """An exposure with all errors."""
        if (id_, time_ns) not in self.fields:
            exposure = exposure_of(self.sky_model, id_, 8, None, time_ns)
            apparent = self.sky_model.sky_at(time_ns).apparent_stars(exposure.positions)
            self.fields[id_, time_ns] = exposure, apparent.direction_n, apparent.shared_n
        exposure, direction_n, shared_n = self.fields[id_, time_ns]
        angles = np.deg2rad([SENSORS[id_]["azimuth_deg"], SENSORS[id_]["elevation_deg"], 0.0])
        rotation_ns = ROTATION_ND @ rotation_from_angles(*angles) @ exp_rotation(mounted_s)
        seen_s = (direction_n + shared_n @ shared) @ rotation_ns
        seen_s = seen_s + SIGMA * rng.standard_normal(seen_s.shape)
        seen_s /= np.linalg.norm(seen_s, axis=-1, keepdims=True)
        return replace(exposure, directions_s=seen_s)[np.arange(count)]


@pytest.fixture(scope="module")
def sky() -> Sky:
    return Sky(sky_at_anchor(configuration()), {})


def solve_attitude(exposure: StarExposure, sky_model: SkyModel) -> AttitudeMeasurement:
    """The attitude of the sensor by these stars alone."""
    _, stars, _ = visible_stars(exposure, sky_model, None)
    solution = solve_stars(stars)
    rotation_ns = solution.rotation_nb
    noise_s = rotation_ns.T @ solution.noise_n @ rotation_ns
    common_n = solution.covariance_n - solution.noise_n
    return AttitudeMeasurement(exposure.source, exposure.time_ns, rotation_ns, noise_s, common_n)


def end(sky: Sky, seed: int, width: Width, count: int = 8) -> dict[str, tuple[FloatArray, FloatArray, int]]:
    """Return by kind of input: error of the estimated INS error (horizon), its covariance, and number of rejections."""
    rng = np.random.default_rng([11, seed])
    error_n = np.array([width.tilt, width.heading, width.tilt]) * ARCSEC * rng.standard_normal(3)
    mounted_s = {id_: INSTALLATION * rng.standard_normal(3) for id_ in SENSORS}
    shared = rng.standard_normal(4)
    exposures = [
        sky.exposure_with_errors(id_, TIME_NS + 100_000_000 * step, count, mounted_s[id_], shared, rng)
        for step, id_ in enumerate([*SENSORS] * 4)
    ]
    tracks = {
        exposure.time_ns: ins_track(
            exposure.time_ns, log_rotation(exp_rotation(error_n) @ exp_rotation(ARCSEC * rng.standard_normal(3)))
        )
        for exposure in exposures
    }
    results = {}
    for kind in ("observations", "solution"):
        ship_filter = ShipFilter(width.config(kind))
        state, rejected = ship_filter.initial_state(), 0
        for exposure in exposures:
            measurement = exposure if kind == "observations" else solve_attitude(exposure, sky.sky_model)
            track = tracks[exposure.time_ns]
            state, decision = ship_filter.step(state, measurement, track, sky.sky_model)
            rejected += not decision.accepted
        rows = ship_filter.model.state_indices("ins.attitude")
        found_n, by_error = state.mean[rows], left_jacobian(state.mean[rows])
        left_n = log_rotation(exp_rotation(error_n) @ exp_rotation(found_n).T)
        results[kind] = left_n, by_error @ state.covariance[np.ix_(rows, rows)] @ by_error.T, rejected
    return results


WIDTHS = [
    Width(MINUTE, MINUTE),
    Width(10.0 * MINUTE, 10.0),
    Width(DEGREE, DEGREE),
    Width(3.0 * DEGREE, 10.0),
    Width(30.0 * DEGREE, 10.0 * DEGREE),
    Width(180.0 * DEGREE, 10.0),
    Width(180.0 * DEGREE, 180.0 * DEGREE),
]


@pytest.mark.statistics
@pytest.mark.parametrize("width", WIDTHS, ids=str)
def test_single_stars_and_solutions_match_their_covariance_and_agree(sky: Sky, width: Width) -> None:
    ends = [end(sky, seed, width) for seed in range(SEEDS)]
    low, high = mean_nees_band(SEEDS, 3)
    for kind in ("observations", "solution"):
        assert low <= np.mean([normalized_error_squared(*found[kind][:2]) for found in ends]) <= high
        # The gate rejects one correct attitude in ten thousand: at most one of 320.
        assert sum(found[kind][2] for found in ends) <= 1
    for found in ends:
        (one, one_covariance, _), (other, other_covariance, _) = found["observations"], found["solution"]
        # Both estimates use the same stars: their difference is within the sum of their covariances.
        assert normalized_error_squared(one - other, one_covariance + other_covariance) < 21.1


def test_two_stars_a_sensor_are_enough_where_they_leave_no_other_attitude(sky: Sky) -> None:
    """A prior with a tilt of 10″ and a heading of 3° verifies two stars; one with 10° and 30° does not."""
    ends = [end(sky, seed, Width(3.0 * DEGREE, 10.0), count=2)["observations"] for seed in range(SEEDS)]
    low, high = mean_nees_band(SEEDS, 3)
    assert low <= np.mean([normalized_error_squared(*found[:2]) for found in ends]) <= high
    assert sum(found[2] for found in ends) <= 1
    _, _, rejected = end(sky, 1, Width(30.0 * DEGREE, 10.0 * DEGREE), count=2)["observations"]
    assert rejected == 8


@pytest.mark.parametrize("heading", [72.0, 3.0 * DEGREE, 10.0 * DEGREE])
@pytest.mark.parametrize("kind", ["observations", "solution"])
def test_the_first_exposure_is_confirmed_by_the_next_one_or_by_another_sensor(
    sky: Sky, kind: str, heading: float
) -> None:
    """A single exposure does not make the attitude VALID, whatever the prior."""
    ship_filter, rng = ShipFilter(Width(heading, 10.0).config(kind)), np.random.default_rng(14)

    def state_after(state: FilterState, id_: str, time_ns: int) -> FilterState:
        exposure = sky.exposure_with_errors(id_, time_ns, 8, np.zeros(3), np.zeros(4), rng)
        measurement = exposure if kind == "observations" else solve_attitude(exposure, sky.sky_model)
        state, decision = ship_filter.step(state, measurement, ins_track(time_ns), sky.sky_model)
        assert decision.accepted
        return state

    first = state_after(ship_filter.initial_state(), "fore", TIME_NS)
    assert first.unconfirmed_step is not None
    assert first.unconfirmed_step.text == (
        "the attitude depends on a single star measurement; confirmation by stars of another time or sensor is pending"
    )
    assert state_after(first, "starboard", TIME_NS).unconfirmed_step is None
    second = state_after(first, "fore", TIME_NS + 100_000_000)
    assert second.unconfirmed_step is None
    # A reinstated sensor needs no confirmation, because its reinstatement required consistency with the others.
    excluded = replace(second, last_used_ns=MappingProxyType({}), exclusion_counts=MappingProxyType({"star.fore": 1}))
    assert state_after(excluded, "fore", TIME_NS + 200_000_000).unconfirmed_step is None


@pytest.mark.parametrize("seed", range(5))
def test_one_step_leads_to_the_most_likely_clock_and_attitude(seed: int) -> None:
    """The estimate equals scipy's least squares with the exact motion of a ship that turns at 4 degrees a second.

    If the turn by the estimated clock offset counted twice, three of the five measurements would be rejected, and the
    other two offsets would be wrong by 0.6 and 1.1 ms.
    """
    rng, config = np.random.default_rng([41, seed]), Width(DEGREE, 10.0).config("solution")
    ship_filter, clock_s = ShipFilter(config), config.ins.time_offset_sigma_s
    tilt, heading, white = (np.array([10.0, DEGREE, 1.0]) * ARCSEC).tolist()
    sigma = np.r_[tilt, heading, tilt, INSTALLATION, clock_s, 3 * [white], 5.0 * SIGMA, 2 * [SIGMA]]
    rate_d = np.deg2rad([4.0, 0.0, 1.0])
    rotation_ds = rotation_from_angles(*np.deg2rad([0.0, 45.0, 0.0]))

    def sensor(state: FloatArray) -> FloatArray:
        """Return horizon from sensor for errors of INS attitude, installation and INS clock, and INS white noise."""
        by_ins = ROTATION_ND @ exp_rotation(-state[6] * rate_d)
        return exp_rotation(state[:3]) @ exp_rotation(state[7:10]) @ by_ins @ rotation_ds @ exp_rotation(state[3:6])

    true = sigma * rng.standard_normal(13)
    true[1] = 1.5 * heading
    measured_ns = sensor(true) @ exp_rotation(true[10:])
    track = AttitudeTrack(500_000_000)
    for step in range(-4, 5):
        rotation_nd = ROTATION_ND @ exp_rotation(rate_d * 0.05 * step)
        track.insert(AttitudeSample(TIME_NS + step * 50_000_000, rotation_nd, rate_d))
    measurement = AttitudeMeasurement("star.fore", TIME_NS, measured_ns, np.diag(sigma[10:] ** 2))

    def whitened_residuals(scaled: FloatArray) -> FloatArray:
        left = log_rotation(sensor(scaled * sigma[:10]).T @ measured_ns)
        return np.r_[scaled, left / sigma[10:]]

    likeliest = sigma[:10] * least_squares(whitened_residuals, np.zeros(10), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    state, decision = ship_filter.step(ship_filter.initial_state(), measurement, track, None)
    assert decision.accepted
    rows = np.concatenate(
        [
            ship_filter.model.state_indices(name)
            for name in ("ins.attitude", "star.fore.installation", "ins.time_offset")
        ]
    )
    found = state.mean[rows]
    assert abs(found[6] - likeliest[6]) < 2e-6
    np.testing.assert_allclose(found[:6], likeliest[:6], atol=0.05 * ARCSEC)


@pytest.mark.parametrize("off_deg", [3.0, -3.0, 9.0])
def test_no_valid_attitude_is_wrong_where_the_ins_is_off_as_stated(off_deg: float) -> None:
    """An INS that was 3° off with a sigma of 3° once made 421 of 431 VALID attitudes wrong by more than five sigma."""

    def turn_ins(message: Any) -> None:
        q = message.orientation
        rotation_nd = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
        message.orientation = quaternion_message(exp_rotation(np.deg2rad([0.0, off_deg, 0.0])) @ rotation_nd)

    arrivals = change_where(voyage(3.0, noise=True), lambda arrival: arrival.topic == INS, turn_ins)
    run = run_new_adapter(arrivals, ins={"frame_id": "ins", "heading_sigma_arcsec": 3.0 * DEGREE})
    valid = [message for message in run.messages("ship/attitude") if message.status == Status.VALID]
    assert len(valid) > 50
    for message in valid:
        q = message.orientation
        rotation_nd = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
        error_n = log_rotation(true_deck(stamp_of(message) - START_NS) @ rotation_nd.T)
        covariance_n = np.reshape(message.rotation_covariance, (3, 3))[np.ix_([1, 2, 0], [1, 2, 0])]
        assert np.all(np.abs(error_n) < 5.0 * np.sqrt(np.diagonal(covariance_n)))
    assert set(run.reasons("star/fore/observations")) <= {"gap"}


@pytest.mark.parametrize("count", [2, 8])
def test_a_solution_is_not_against_an_ins_that_is_off_as_stated(sky: Sky, count: int) -> None:
    """Linearised at an INS attitude that is 3° off, the correct stars would contradict the INS by 283″."""
    rng = np.random.default_rng(4)
    exposure = sky.exposure_with_errors("fore", TIME_NS, count, np.zeros(3), np.zeros(4), rng)
    true_ns = ROTATION_ND @ rotation_from_angles(0.0, np.deg2rad(45.0), 0.0)
    sigma = np.array([10.0, 3.0 * DEGREE, 10.0]) * ARCSEC
    prior = StarPrior(exp_rotation(np.deg2rad([0.0, 3.0, 0.0])) @ true_ns, np.diag(sigma**2))
    _, stars, _ = visible_stars(exposure, sky.sky_model, prior)
    solution, against_prior = solve_with_fallback(stars, prior)
    assert solution.status is SolutionStatus.VALID
    assert solution.members.all()
    assert not against_prior
    left_n = log_rotation(true_ns @ solution.rotation_nb.T)
    assert normalized_error_squared(left_n, solution.covariance_n) < 21.1


@pytest.mark.parametrize("width", [WIDTHS[0], WIDTHS[3], WIDTHS[4]], ids=str)
def test_the_gate_statistic_is_chi_square(sky: Sky, width: Width) -> None:
    """The NIS of the first exposure of each seed has sixteen degrees of freedom, for sixteen residuals."""
    values = []
    for seed in range(SEEDS):
        rng = np.random.default_rng([13, seed])
        error_n = np.array([width.tilt, width.heading, width.tilt]) * ARCSEC * rng.standard_normal(3)
        white_n, mounted_s = ARCSEC * rng.standard_normal(3), INSTALLATION * rng.standard_normal(3)
        exposure = sky.exposure_with_errors("fore", TIME_NS, 8, mounted_s, rng.standard_normal(4), rng)
        track = ins_track(TIME_NS, log_rotation(exp_rotation(error_n) @ exp_rotation(white_n)))
        ship_filter = ShipFilter(width.config("observations"))
        values.append(ship_filter.step(ship_filter.initial_state(), exposure, track, sky.sky_model)[1].nis)
    low, high = mean_nees_band(SEEDS, 16)
    assert low <= np.mean(values) <= high


@pytest.mark.slow
@pytest.mark.parametrize("count", [8, 4, 3])
@pytest.mark.parametrize("width", [WIDTHS[3], Width(3.0 * DEGREE, 3.0 * DEGREE), WIDTHS[6]], ids=str)
def test_two_exchanged_names_never_make_a_wrong_attitude(sky: Sky, width: Width, count: int) -> None:
    """The correctly identified stars outvote the exchanged ones, or the exposure is rejected."""
    used = 0
    for seed in range(20):
        rng = np.random.default_rng([17, seed])
        error_n = np.array([width.tilt, width.heading, width.tilt]) * ARCSEC * rng.standard_normal(3)
        exposure = sky.exposure_with_errors("fore", TIME_NS, count, np.zeros(3), rng.standard_normal(4), rng)
        one, other = rng.choice(count, 2, replace=False)
        names = np.arange(count)
        names[[one, other]] = other, one
        exchanged = replace(exposure, hip=exposure.hip[names], positions=exposure.positions[names])
        ship_filter = ShipFilter(width.config("observations"))
        track = ins_track(TIME_NS, error_n)
        state, decision = ship_filter.step(ship_filter.initial_state(), exchanged, track, sky.sky_model)
        if decision.accepted:
            used += 1
            rows = ship_filter.model.state_indices("ins.attitude")
            by_error = left_jacobian(state.mean[rows])
            left_n = log_rotation(exp_rotation(error_n) @ exp_rotation(state.mean[rows]).T)
            covariance_n = by_error @ state.covariance[np.ix_(rows, rows)] @ by_error.T
            assert normalized_error_squared(left_n, covariance_n) < 30.7  # chi², three degrees, one in a million
    assert used == 20 or count < 8
