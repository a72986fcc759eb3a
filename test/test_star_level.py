"""Simulated stars and their processing by the suite: one joint solution per epoch, consistent with large shared errors.

The simulated sky and the estimator's are separate: with a wrong sign or scale in one of them these tests would fail.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_simulation.run import SKY_SOURCES, SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_configuration
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_from_stars.solution import SolutionStatus, solve_stars
from ship_stars.attitude_samples import InertialAttitude
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from ship_stars.sky.tracker_attitude import to_horizon_attitude
from ship_testing.trials.monte_carlo import sky_input, star_exposure

SCENARIOS = Path(__file__).parents[1] / "bags" / "scenarios"
SEEDS = 120


def one_epoch(**changes) -> Scenario:
    """Return one second of the reference case with single stars: one exposure of each sensor, stamped at the start."""
    whole = load_scenario(SCENARIOS / "paper_stars.yaml")
    sensors = {id_: replace(sensor, rate_hz=1.0) for id_, sensor in whole.star_sensors.items()}
    short = replace(whole, duration_s=1.0, ins=replace(whole.ins, rate_hz=1.0), star_sensors=sensors)
    return replace(short, **changes)


def configured_sky(run: SimulatedRun, configuration: ShipAttitudeConfig) -> SkyModel:
    """Return the sky model with all position fixes and weather readings of a run."""
    sky_model = load_sky_model(configuration.sky)
    for _, source, index in run.arrivals():
        if source in SKY_SOURCES:
            sky_model.surroundings.insert(sky_input(run, source, index))
    return sky_model


def sighted_stars(
    exposures: dict[str, StarExposure], sky_model: SkyModel, configuration: ShipAttitudeConfig
) -> MatchedStars:
    """Return all stars of several sensors in the deck frame."""
    parts, mounting_b, field_b, field_sources = [], [], [], ()
    for index, (id_, exposure) in enumerate(exposures.items()):
        sensor = configuration.star_sensors[id_]
        rotation_ds = rotation_from_angles(*np.deg2rad([sensor.azimuth_deg, sensor.elevation_deg, sensor.roll_deg]))
        sigma_s = [
            sensor.installation_sigma_forward_arcsec,
            sensor.installation_sigma_up_arcsec,
            sensor.installation_sigma_right_arcsec,
        ]
        mounting_b.append(rotation_ds * np.array(sigma_s) * ARCSEC)
        apparent = sky_model.sky_at(exposure.time_ns).apparent_stars(exposure.positions)
        measured_b = exposure.directions_s @ rotation_ds.T
        of_sensor = np.full(len(exposure), index)
        field_b.append(rotation_ds @ exposure.field_modes)
        field_sources += exposure.field_sources
        parts.append(
            (measured_b, apparent.direction_n, exposure.sigma, exposure.position_sigma, apparent.shared_n, of_sensor)
        )
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    # Each camera has errors of its own.
    rows, modes = np.cumsum([0, *map(len, field_b)]), np.cumsum([0, *(one.shape[-1] for one in field_b)])
    of_all = np.zeros((rows[-1], 3, modes[-1]))
    for index, one in enumerate(field_b):
        of_all[rows[index] : rows[index + 1], :, modes[index] : modes[index + 1]] = one
    return MatchedStars(*columns, np.array(mounting_b), field_b=of_all, field_sources=field_sources)


def normalised_errors(scenario: Scenario, configured: Scenario | None = None, **sky: float) -> list[float]:
    """Return NEES of the joint solution, one per seed."""
    return each_nees(*joint_errors(scenario, configured, **sky))


def each_nees(errors_n: FloatArray, covariances_n: FloatArray) -> list[float]:
    return [float(normalized_error_squared(*pair)) for pair in zip(errors_n, covariances_n, strict=True)]


def joint_errors(scenario: Scenario, configured: Scenario | None = None, **sky: float) -> tuple[FloatArray, FloatArray]:
    """Return errors of the joint solution and their covariances, one per seed, shapes (n, 3) and (n, 3, 3).

    Args:
        scenario: scenario of the simulation.
        configured: scenario of the estimator's configuration; None for ``scenario``.
        sky: changed parameters of the sky.
    """
    suite = suite_configuration(configured or scenario)
    configuration = build(ShipAttitudeConfig, {**suite, "sky": {**suite["sky"], **sky}})
    errors_n, covariances_n = [], []
    for seed in range(SEEDS):
        run = simulate(scenario, seed)
        exposures = {id_: star_exposure(run, id_, 0) for id_ in run.stars}
        solution = solve_stars(sighted_stars(exposures, configured_sky(run, configuration), configuration))
        assert solution.status is SolutionStatus.VALID
        # The sensors have no time offset, so the truth at the first stamp is the truth for their exposures.
        error_n = log_rotation(run.truth.rotation_nd[0] @ solution.rotation_nb.T)
        errors_n.append(error_n)
        covariances_n.append(solution.covariance_n)
    return np.array(errors_n), np.array(covariances_n)


BASE = one_epoch()
LARGE_ERRORS = {
    "as it is": {},
    "weather": {"weather": replace(BASE.weather, pressure_sigma_hpa=20.0, temperature_sigma_k=8.0)},
    "position": {"position": replace(BASE.position, slow_sigma_m=100.0)},
}


@pytest.mark.statistics
@pytest.mark.parametrize("case", LARGE_ERRORS)
def test_the_error_of_the_joint_solution_fits_its_covariance(case: str) -> None:
    low, high = mean_nees_band(SEEDS, degrees=3)
    assert low <= np.mean(normalised_errors(one_epoch(**LARGE_ERRORS[case]))) <= high


@pytest.mark.slow
def test_unmodelled_errors_are_detected() -> None:
    """The test can fail: here weather errors are large, but the configuration states the usual sigmas."""
    values = normalised_errors(one_epoch(**LARGE_ERRORS["weather"]), configured=BASE)
    assert np.mean(values) > mean_nees_band(SEEDS, degrees=3)[1]


def low_elevation_scenario(model: str) -> Scenario:
    """Return two sensors at low elevation: most stars are at 5° to 11°, with refraction by a model."""
    sensors = {id_: replace(sensor, elevation_deg=7.0) for id_, sensor in BASE.star_sensors.items()}
    return replace(BASE, star_sensors=sensors, weather=replace(BASE.weather, refraction_model=model))


@pytest.mark.slow
def test_errors_of_low_stars_fit_their_covariance_by_erfa_and_are_smaller_by_traced_rays() -> None:
    """The true refraction is that of traced rays. The error of erfa's formula there is slightly more than its sigma.

    This error is the same for each seed, so the mean NEES need not be 3: only the upper bound applies.
    """
    truth = low_elevation_scenario("ray_trace")
    low_bound, high_bound = mean_nees_band(SEEDS, degrees=3)
    by_formula, by_rays = (joint_errors(truth, scenario) for scenario in (low_elevation_scenario("erfa"), truth))
    nees = [float(np.mean(each_nees(*found))) for found in (by_formula, by_rays)]
    rms = [np.sqrt(np.mean(errors_n[:, [0, 2]] ** 2)) / ARCSEC for errors_n, _ in (by_formula, by_rays)]
    print(f"erfa: NEES {nees[0]:.2f}, tilt {rms[0]:.2f}″; ray_trace: NEES {nees[1]:.2f}, tilt {rms[1]:.2f}″")
    assert nees[0] < high_bound
    assert low_bound < nees[1] < high_bound
    assert rms[1] < rms[0]


@pytest.mark.slow
def test_an_error_of_the_clock_is_modelled_with_that_of_ut1() -> None:
    """The Earth's rotation differs from the stamps by 0.2 s (sigma), which is 3″, as if all clocks had this error."""
    late = one_epoch(earth_rotation_sigma_s=0.2)
    low_bound, high_bound = mean_nees_band(SEEDS, degrees=3)
    stated = normalised_errors(late, utc_sigma_s=0.2)
    unstated = normalised_errors(late)
    print(f"NEES {np.mean(stated):.2f} stated, {np.mean(unstated):.2f} not stated")
    assert low_bound < np.mean(stated) < high_bound
    assert np.mean(unstated) > high_bound


def test_a_tracker_in_the_icrs_is_rotated_to_the_true_horizon() -> None:
    sensors = {
        id_: replace(
            sensor,
            output="inertial_attitude",
            sigma_forward_arcsec=0.0,
            sigma_up_arcsec=0.0,
            sigma_right_arcsec=0.0,
        )
        for id_, sensor in BASE.star_sensors.items()
    }
    exact = replace(
        BASE,
        star_sensors=sensors,
        position=replace(BASE.position, sigma_m=0.0, slow_sigma_m=0.0),
        weather=replace(BASE.weather, pressure_sigma_hpa=0.0, temperature_sigma_k=0.0),
        # Practically no error of UT1; 0 would mean the sigma of the table.
        earth_rotation_sigma_s=1e-9,
    )
    run = simulate(exact, seed=1)
    sky_model = configured_sky(run, build(ShipAttitudeConfig, suite_configuration(exact)))
    for id_, samples in run.stars.items():
        inertial = InertialAttitude(id_, int(samples.time_ns[0]), samples.rotation_cv[0], samples.noise_v)
        found = to_horizon_attitude(inertial, sky_model)
        true_ns = run.truth.rotation_nd[0] @ run.truth.stars[id_].rotation_dv
        # The estimator computes precession, nutation and Earth orientation only once in ten seconds.
        assert np.max(np.abs(log_rotation(true_ns.T @ found.rotation_nv))) < 0.5e-3 * ARCSEC
