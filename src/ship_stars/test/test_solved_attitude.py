"""Common errors of solved attitudes count once: Monte Carlo with a poor fix and poor weather.

The true position and air differ from the known ones by drawn errors. The sensors observe the stars with the true
values; all other computations use the known ones. The sensitivities are therefore tested by true shifts of the sky.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.adapters.star_attitude_adapter import star_horizon_attitude
from ship_attitude_star.messages.input_messages import star_measurement
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.star_attitude.exposure_solver import solve_exposure
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import Measurement, Status
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.frames import horizon_covariance
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_samples import AttitudeMeasurement, PositionFix, SolvedAttitude
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from ship_stars.sky.tracker_attitude import to_horizon_attitude
from ship_testing.adapter_runs import FACTORY, START_NS, Arrival, sort_by_arrival
from ship_testing.consistency import sigma_ratio_band
from ship_testing.ship_observations import SENSORS as OBSERVING
from ship_testing.ship_observations import run_new_adapter
from ship_testing.small_voyage import INS, Run
from ship_testing.star_sky import POSITION, SENSORS, TIME_NS, configuration, exposure_of, ins_track
from ship_testing.star_voyage import (
    EXACT_CAMERA,
    EXACT_OPTICS,
    FIX,
    HUMIDITY,
    PRESSURE,
    TEMPERATURE,
    fault_free_run,
    without_topics,
)
from ship_testing.star_voyage import run_new_adapter as solved_by
from ship_testing.star_voyage import voyage as star_voyage

SECOND_NS = 1_000_000_000
SEEDS = 100
EPOCHS = 3
METRES_PER_RADIAN = 6.37e6


@dataclass(frozen=True)
class Knowledge:
    """Standard deviations of the fix and of the air."""

    fix_m: float
    pressure_hpa: float
    temperature_k: float


POOR_FIX = Knowledge(100.0, 2.0, 2.0)
POOR_WEATHER = Knowledge(5.0, 15.0, 15.0)


def ship(known: Knowledge, **sensor: Any) -> ShipAttitudeConfig:
    """Return a configuration of two sensors without weather readings; no correct message exceeds its gate by chance."""
    air = {"pressure_sigma_hpa": known.pressure_hpa, "temperature_sigma_k": known.temperature_k}
    built = configuration(sky=air, gate={"probability": 1.0 - 1e-9})
    return replace(built, star_sensors={id_: replace(star, **sensor) for id_, star in built.star_sensors.items()})


def sky(config: ShipAttitudeConfig, position: GeodeticPosition, sigma_m: float) -> SkyModel:
    sky_model = load_sky_model(config.sky)
    for second in range(-2, EPOCHS + 2):
        fix = PositionFix(TIME_NS + second * SECOND_NS, position, np.eye(3) * sigma_m**2)
        sky_model.surroundings.insert(fix)
    return sky_model


@functools.cache
def sky_model_with_inputs(known: Knowledge) -> SkyModel:
    return sky(ship(known), POSITION, known.fix_m)


def true_sky(known: Knowledge, rng: np.random.Generator) -> SkyModel:
    """Return a sky whose position and air differ from the known ones by their sigmas."""
    north_m, east_m = known.fix_m * rng.standard_normal(2)
    place = GeodeticPosition(
        POSITION.latitude + north_m / METRES_PER_RADIAN,
        POSITION.longitude + east_m / (METRES_PER_RADIAN * np.cos(POSITION.latitude)),
        POSITION.height_m,
    )
    config = ship(known)
    air = replace(
        config.sky,
        pressure_hpa=config.sky.pressure_hpa + known.pressure_hpa * rng.standard_normal(),
        temperature_c=config.sky.temperature_c + known.temperature_k * rng.standard_normal(),
    )
    return sky(replace(config, sky=air), place, known.fix_m)


@dataclass(frozen=True)
class Voyage:
    """Draws of a seed: errors of the INS, true minus stated, and the exposures of the sensors."""

    error_n: FloatArray
    noise_n: tuple[FloatArray, ...]
    exposures: tuple[StarExposure, ...]


@functools.cache
def voyage(known: Knowledge, seed: int) -> Voyage:
    rng = np.random.default_rng([20261122, seed])
    config = ship(known)
    blocks, truth = ShipFilter(config).model.blocks, true_sky(known, rng)
    error_n = blocks["ins.attitude"].sigma * rng.standard_normal(3)
    mounted_s = {id_: s.installation_sigma_s * rng.standard_normal(3) for id_, s in config.star_sensors.items()}
    exposures, noise_n = [], []
    for epoch in range(EPOCHS):
        for id_ in SENSORS:
            exposures.append(exposure_of(truth, id_, 8, rng, TIME_NS + epoch * SECOND_NS, mounted_s[id_]))
            noise_n.append(blocks["ins.noise"].sigma * rng.standard_normal(3))
    return Voyage(error_n, tuple(noise_n), tuple(exposures))


def solution(exposure: StarExposure, known: Knowledge) -> Any:
    """Return ``star/<id>/solution`` of an exposure by the known sky."""
    _, solved = solve_exposure(exposure, (), None, sky_model_with_inputs(known))
    assert solved.is_valid
    return star_horizon_attitude(FACTORY, solved, "")


def measure_attitude(
    exposure: StarExposure, config: ShipAttitudeConfig, known: Knowledge, has_noise_covariance: bool
) -> Measurement:
    """Return the filter's measurement of an exposure, by the configured input."""
    id_ = exposure.source.partition(".")[2]
    star = config.star_sensors[id_]
    if star.input == "observations":
        return exposure
    message = solution(exposure, known)
    if not has_noise_covariance:
        message.noise_covariance[:] = 0.0
    return star_measurement(message, id_, star, exposure.time_ns).value


def final(
    config: ShipAttitudeConfig, known: Knowledge, seed: int, has_noise_covariance: bool
) -> tuple[FloatArray, FloatArray]:
    """Return true minus estimated error of the INS after exposures of both sensors, and its covariance (N, U, E)."""
    drawn, ship_filter = voyage(known, seed), ShipFilter(config)
    state = ship_filter.initial_state()
    for exposure, noise_n in zip(drawn.exposures, drawn.noise_n, strict=True):
        track = ins_track(exposure.time_ns, drawn.error_n + noise_n)
        measurement = measure_attitude(exposure, config, known, has_noise_covariance)
        stepped = ship_filter.step(state, measurement, track, sky_model_with_inputs(known))
        assert stepped is not None
        state, decision = stepped
        assert decision.accepted, decision.text
    rows = ship_filter.model.slices["ins.attitude"]
    return drawn.error_n - state.mean[rows], state.covariance[rows, rows]


@dataclass(frozen=True)
class Campaign:
    """Results of all seeds: mean NEES; and about North, Up, East RMS error / sigma, and sigma in arcseconds."""

    nees: float
    ratio: FloatArray
    sigma_arcsec: FloatArray


@functools.cache
def campaign(known: Knowledge, input_: str, shared: str = "by_input", has_noise_covariance: bool = True) -> Campaign:
    config = ship(known, input=input_, shared=shared)
    found = [final(config, known, seed, has_noise_covariance) for seed in range(SEEDS)]
    nees = [float(normalized_error_squared(error_n, covariance_n)) for error_n, covariance_n in found]
    sigma = np.sqrt(np.mean([np.diagonal(covariance_n) for _, covariance_n in found], axis=0))
    rms = np.sqrt(np.mean([error_n**2 for error_n, _ in found], axis=0))
    result = Campaign(float(np.mean(nees)), rms / sigma, sigma / ARCSEC)
    print(
        f"{known} {input_} {shared} {has_noise_covariance}: NEES {result.nees:.2f}, RMS/sigma {result.ratio.round(2)}, "
        f"sigma {result.sigma_arcsec.round(2)}"
    )
    return result


ONE_ERROR_FOR_ALL = {
    "observations": ("observations",),
    "solution": ("solution",),
    "attitude of another program": ("horizon_attitude", "sky"),
    "the same with one covariance": ("horizon_attitude", "sky", False),
}


@pytest.mark.statistics
@pytest.mark.parametrize("case", ONE_ERROR_FOR_ALL)
@pytest.mark.parametrize("known", [POOR_FIX, POOR_WEATHER], ids=["poor fix", "poor weather"])
def test_errors_match_the_covariance_for_every_input(known: Knowledge, case: str) -> None:
    found = campaign(known, *ONE_ERROR_FOR_ALL[case])
    low, high = mean_nees_band(SEEDS, 3)
    assert low < found.nees < high
    low, high = sigma_ratio_band(SEEDS)
    assert np.all((low < found.ratio) & (found.ratio < high)), found.ratio


@pytest.mark.slow
@pytest.mark.parametrize("known", [POOR_FIX, POOR_WEATHER], ids=["poor fix", "poor weather"])
def test_solutions_have_the_information_of_their_stars(known: Knowledge) -> None:
    by_stars, by_solutions = campaign(known, "observations"), campaign(known, "solution")
    assert by_solutions.sigma_arcsec == pytest.approx(by_stars.sigma_arcsec, rel=0.03)


@pytest.mark.slow
def test_with_a_dominant_position_error_a_common_error_is_equivalent() -> None:
    found, by_sky = campaign(POOR_FIX, "solution", "message"), campaign(POOR_FIX, "solution")
    low, high = mean_nees_band(SEEDS, 3)
    assert low < found.nees < high
    assert found.sigma_arcsec == pytest.approx(by_sky.sigma_arcsec, rel=0.03)


def test_as_each_sensor_s_own_the_error_of_the_fix_would_seem_to_average() -> None:
    """The bands detect that sigma is too small in tilt and too large in heading if errors are not separated."""
    ratio = campaign(POOR_FIX, "solution", "none").ratio
    low, high = sigma_ratio_band(SEEDS)
    assert ratio[0] > high - 0.05
    assert ratio[1] < low


# -- one message ----------------------------------------------------------------------------------------------


def one_solution(known: Knowledge = POOR_FIX) -> Any:
    return solution(exposure_of(sky_model_with_inputs(known), "fore", 8, np.random.default_rng(1)), known)


def read(message: Any, shared: str = "sky") -> AttitudeMeasurement:
    star = ship(POOR_FIX, input="horizon_attitude", shared=shared).star_sensors["fore"]
    return star_measurement(message, "fore", star, TIME_NS).value


def separate_errors(message: Any, known: Knowledge = POOR_FIX) -> AttitudeMeasurement:
    solved = read(message)
    assert isinstance(solved, SolvedAttitude)
    found = to_horizon_attitude(solved, sky_model_with_inputs(known))
    assert isinstance(found, AttitudeMeasurement)
    return found


@pytest.mark.parametrize("is_noise_stated", [True, False], ids=["noise stated", "one covariance"])
@pytest.mark.parametrize("known", [POOR_FIX, POOR_WEATHER], ids=["poor fix", "poor weather"])
def test_separated_errors_add_up_to_the_stated_covariance(known: Knowledge, is_noise_stated: bool) -> None:
    message = one_solution(known)
    if not is_noise_stated:
        message.noise_covariance[:] = 0.0
    found, total_n = separate_errors(message, known), horizon_covariance(message.rotation_covariance.reshape(3, 3))
    noise_n = found.rotation_nv @ found.noise_v @ found.rotation_nv.T
    np.testing.assert_allclose(noise_n + found.correlated_n, total_n, atol=1e-9 * np.trace(total_n))
    for part in (found.noise_v, found.common_n):
        assert np.linalg.eigvalsh(part)[0] > -1e-9 * np.trace(total_n)
    # The only common error left in the suite's own solutions is that of the catalogue, at most 0.02″ per star.
    if is_noise_stated:
        assert np.sqrt(np.trace(found.common_n)) < 0.1 * ARCSEC


def test_the_shared_rotations_equal_finite_differences_of_the_sky() -> None:
    """The rotations are compared with those of solutions for a position one sigma further north, and for denser air."""
    exposure = exposure_of(sky_model_with_inputs(POOR_WEATHER), "fore", 8)
    found = separate_errors(one_solution(POOR_WEATHER), POOR_WEATHER)
    config = ship(POOR_WEATHER)
    north = replace(POSITION, latitude=POSITION.latitude + POOR_WEATHER.fix_m / METRES_PER_RADIAN)
    denser = replace(config.sky, pressure_hpa=config.sky.pressure_hpa + 1.0)
    for column, sky_model in (
        (2, sky(config, north, POOR_WEATHER.fix_m)),
        (0, sky(replace(config, sky=denser), POSITION, POOR_WEATHER.fix_m)),
    ):
        moved, unmoved = (
            solve_exposure(exposure, (), None, one)[1] for one in (sky_model, sky_model_with_inputs(POOR_WEATHER))
        )
        turn_n = log_rotation(moved.solution.rotation_nb @ unmoved.solution.rotation_nb.T)
        expected_n = found.shared_n[:, column]
        if column == 0:
            # The column is for a sigma of pressure and temperature together: only directions are compared.
            turn_n *= np.linalg.norm(expected_n) / np.linalg.norm(turn_n)
        np.testing.assert_allclose(turn_n, expected_n, atol=0.03 * np.linalg.norm(expected_n))


def test_unstated_shared_errors_are_added_to_the_configured_noise() -> None:
    message = one_solution()
    for covariance in (message.covariance, message.rotation_covariance, message.noise_covariance):
        covariance[:] = 0.0
    found = separate_errors(message)
    assert not found.covariance_known
    assert np.sqrt(np.diagonal(found.noise_v)) / ARCSEC == pytest.approx([100.0, 3.0, 3.0])
    np.testing.assert_array_equal(found.common_n, 0.0)
    # 100 m at a radius of 6370 km are 3.24″.
    assert np.linalg.norm(found.shared_n[:, 2]) / ARCSEC == pytest.approx(3.24, abs=0.02)


def test_a_message_that_states_less_than_the_fix_has_errors_is_not_made_negative() -> None:
    message = one_solution(POOR_WEATHER)
    found = separate_errors(message, POOR_FIX)
    assert np.linalg.eigvalsh(found.common_n)[0] > -1e-9 * np.trace(found.common_n)
    assert np.linalg.norm(found.shared_n[:, 2]) / ARCSEC == pytest.approx(3.24, abs=0.02)


def test_a_correlated_error_not_due_to_refraction_is_the_sensor_s_own() -> None:
    message = one_solution()
    more = (20.0 * ARCSEC) ** 2 * np.eye(3).ravel()
    message.rotation_covariance += more
    found = separate_errors(message)
    assert np.linalg.norm(found.shared_n[:, 0]) < 1.0 * ARCSEC
    assert np.sqrt(np.linalg.eigvalsh(found.common_n)[0]) / ARCSEC == pytest.approx(20.0, rel=0.01)


@pytest.mark.parametrize("elevation_deg", [-20.0, 2.0, 90.0])
def test_below_the_refraction_model_the_stated_covariance_is_used(elevation_deg: float) -> None:
    message = one_solution()
    message.elevation = float(np.deg2rad(elevation_deg))
    found, total_n = separate_errors(message), horizon_covariance(message.rotation_covariance.reshape(3, 3))
    noise_n = found.rotation_nv @ found.noise_v @ found.rotation_nv.T
    np.testing.assert_allclose(noise_n + found.correlated_n, total_n, atol=1e-9 * np.trace(total_n))


def test_without_a_fix_shared_errors_cannot_be_separated() -> None:
    rejection = to_horizon_attitude(read(one_solution()), load_sky_model(ship(POOR_FIX).sky))
    assert isinstance(rejection, Rejection)
    assert rejection.reason is Reason.NO_FIX


def test_shared_errors_are_as_configured() -> None:
    message = one_solution()
    common_n = read(message, "none").common_n
    assert type(read(message, "none")) is type(read(message, "by_input")) is AttitudeMeasurement
    shared = read(message, "message")
    np.testing.assert_array_equal(shared.common_n, 0.0)
    np.testing.assert_allclose(shared.correlated_n, common_n, atol=1e-9 * np.trace(common_n))
    np.testing.assert_allclose(shared.shared_n, shared.shared_n.T, atol=1e-15)


@pytest.mark.parametrize("input_", ["observations", "inertial_attitude"])
def test_shared_errors_of_stars_cannot_be_disabled(input_: str) -> None:
    with pytest.raises(ParameterError, match=r"'star_sensors\.fore\.shared': .*input: solution or horizon_attitude"):
        ship(POOR_FIX, input=input_, shared="none")


# -- the node -------------------------------------------------------------------------------------------------


def solved_voyage(run: Run | None = None) -> tuple[Arrival, ...]:
    """Return INS, fixes and weather of the voyage, and the solutions of star_attitude from a run."""
    solved = [
        Arrival(topic, message, receive_ns)
        for receive_ns, topic, message in (run or fault_free_run()).published
        if topic in ("star/fore/solution", "star/starboard/solution")
    ]
    return sort_by_arrival([*(a for a in star_voyage() if "observations" not in a.topic), *solved])


def sail_solved(arrivals: Iterable[Arrival], shared: str = "by_input") -> Run:
    """Run all inputs that the node subscribes to: position and air only if ``shared`` is "by_input" or "sky"."""
    sensors = {id_: {**values, "input": "solution", "shared": shared} for id_, values in OBSERVING.items()}
    surroundings = () if shared in ("by_input", "sky") else (FIX, PRESSURE, TEMPERATURE, HUMIDITY)
    return run_new_adapter(without_topics(arrivals, *surroundings), star_sensors=sensors)


def test_the_node_estimates_the_same_from_solutions_and_stars() -> None:
    """The optics are exact, since the filter estimates their errors from stars and not from solutions."""
    exact = {id_: {**values, "camera": EXACT_CAMERA} for id_, values in OBSERVING.items()}
    by_stars = run_new_adapter(star_voyage(), star_sensors=exact)
    by_solutions = sail_solved(solved_voyage(solved_by(star_voyage(), **EXACT_OPTICS)))
    sigmas = [
        np.sqrt(np.diagonal(run.messages("ship/attitude")[-1].rotation_covariance.reshape(3, 3)))
        for run in (by_stars, by_solutions)
    ]
    assert by_solutions.messages("ship/attitude")[-1].status == Status.VALID
    assert sigmas[1] == pytest.approx(sigmas[0], rel=0.03)
    names = by_solutions.messages("ship/error_budget")[-1].sources
    assert {"refraction", "earth_rotation", "ship_position"} <= set(names)


def test_fixes_that_come_late_change_nothing() -> None:
    states = []
    for delay_s in (0.05, 1.2):
        late = [
            replace(a, receive_ns=a.stamp_ns + round(1e9 * delay_s)) if a.topic == FIX else a for a in solved_voyage()
        ]
        state = sail_solved(sort_by_arrival(late)).adapter.core.state
        states.append((state.mean.tobytes(), state.covariance_by_source.tobytes()))
    assert states[0] == states[1]


def test_without_a_fix_solutions_are_rejected_unless_configured_as_complete() -> None:
    without_fix = without_topics(solved_voyage(), FIX)
    run = sail_solved(without_fix)
    assert set(run.reasons("star/fore/solution")) == {"no_fix"}
    assert {m.status for m in run.messages("ship/attitude")} <= {Status.DEGRADED, Status.INVALID}
    run = sail_solved(without_fix, "message")
    assert run.reasons("star/fore/solution") == {}
    assert run.messages("ship/attitude")[-1].status == Status.VALID
    assert FIX not in {entry.topic for entry in run.adapter.inputs}


def test_without_the_ins_a_solution_has_its_full_error() -> None:
    """A single sensor has the error of the fix too, with or without other sensors that share it."""
    cut_ns = START_NS + SECOND_NS
    cut = [a for a in solved_voyage() if a.topic != INS or a.receive_ns < cut_ns]
    sigmas = []
    for shared in ("sky", "message", "none"):
        messages = sail_solved(cut, shared).messages("ship/attitude")
        alone = [m for m in messages if "ins" not in m.sources and m.sources]
        sigmas.append(np.sqrt(np.trace(alone[-1].rotation_covariance.reshape(3, 3))))
    assert sigmas == pytest.approx([sigmas[0]] * 3, rel=0.02)
