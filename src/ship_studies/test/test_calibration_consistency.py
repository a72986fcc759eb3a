"""Consistency of calibrated installation angles with their covariance, and the benefit for a voyage."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_attitude_star.adapters.alignment_file import ALIGNMENT_FILE
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import ARCSEC, log_rotation, wrap_pi
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.suite_file import suite_configuration
from ship_studies.installation.result import InstallationCalibration, calibrate
from ship_studies.installation.session import Session
from ship_testing.calibration_sessions import HEELING, STILL, TURN, session
from ship_testing.consistency import sigma_ratio_band
from ship_testing.trials.monte_carlo import core_for, feed_attitude

SEEDS = int(os.environ.get("SEEDS", "16"))
"""Number of sessions of a case; ``make campaign`` takes more."""
VOYAGES = 16
SENSORS = "fore", "starboard"


def calibrate_run(run: SimulatedRun, core: ShipAttitudeCore) -> InstallationCalibration:
    """Return the result of the command for a run, without a bag."""
    feed_attitude(core, run)
    return calibrate(Session("run", core.config, core, {}, np.array([]), {}, run.scenario.duration_s, []))


def angle_errors(calibration: InstallationCalibration, run: SimulatedRun) -> np.ndarray:
    """Return true minus estimated installation angles, rad."""
    true = np.concatenate([angles_from_rotation(run.truth.stars[id_].rotation_dv) for id_ in SENSORS])
    return wrap_pi(true - [angle.installed for angle in calibration.angles])


def nees(calibration: InstallationCalibration, run: SimulatedRun) -> float:
    return float(normalized_error_squared(angle_errors(calibration, run), calibration.covariance))


CALM = {"bow": "no", "up": "no", "starboard": "no"}


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("scenario", "observed"),
    [
        (session(STILL), CALM),
        (session(STILL, sigma_arcsec=1200.0), CALM),
        # The INS's heading error turns with the ship: a turn in calm water makes only roll and pitch observable.
        (session(TURN), CALM | {"bow": "yes", "starboard": "yes"}),
        (session(HEELING), dict.fromkeys(CALM, "yes")),
        (session(STILL, reference=True), dict.fromkeys(CALM, "yes")),
    ],
    ids=["still", "still, hardly known", "turn", "turn in a swell", "still, with a reference"],
)
def test_errors_fit_their_covariance(scenario: Scenario, observed: dict[str, str]) -> None:
    """NEES of all six angles and RMS/sigma of each angle, over one session per seed, are in their 99.9 % bands."""
    values, ratios = [], []
    for seed in range(SEEDS):
        run = simulate(scenario, seed)
        calibration = calibrate_run(run, core_for(scenario))
        assert {c.axis: c.observability for c in calibration.combinations.values() if c.axis} == observed
        values.append(nees(calibration, run))
        ratios.append(angle_errors(calibration, run) / [angle.sigma for angle in calibration.angles])
    low, high = mean_nees_band(SEEDS, degrees=6)
    assert low <= np.mean(values) <= high
    low, high = sigma_ratio_band(SEEDS)
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((low <= rms) & (rms <= high)), rms


def test_a_too_narrow_prior_is_detected() -> None:
    """The NEES exceeds its band if installations are five times as far off as their configured sigmas."""
    scenario = session(STILL, sigma_arcsec=4.0)
    values = [
        nees(calibrate_run(simulate(session(STILL), seed), core_for(scenario)), simulate(session(STILL), seed))
        for seed in range(4)
    ]
    assert np.mean(values) > mean_nees_band(4, degrees=6)[1]


def next_voyage(calibration_run: SimulatedRun) -> Scenario:
    """Return a voyage of the same ship with the same installation and clock, but other INS errors and noise."""
    truth = calibration_run.truth
    sensors = {}
    for id_, sensor in calibration_run.scenario.star_sensors.items():
        azimuth, elevation, roll = np.rad2deg(angles_from_rotation(truth.stars[id_].rotation_dv)).tolist()
        sensors[id_] = replace(
            sensor,
            azimuth_deg=azimuth,
            elevation_deg=elevation,
            roll_deg=roll,
            installation_sigma_forward_arcsec=0.0,
            installation_sigma_up_arcsec=0.0,
            installation_sigma_right_arcsec=0.0,
        )
    ins = replace(calibration_run.scenario.ins, time_offset_s=truth.ins.time_offset_s, time_offset_sigma_s=0.0)
    return replace(session(HEELING, duration_s=10.0), star_sensors=sensors, ins=ins)


@pytest.mark.statistics
def test_a_voyage_with_the_calibration_is_better_and_consistent(tmp_path: Path) -> None:
    """The calibration passes through the file and its real loader."""
    scenario = session(STILL, reference=True)
    # The voyage has no reference; the calibration in the harbour had one.
    config = build(ShipAttitudeConfig, suite_configuration(session(STILL)))
    errors: dict[str, list[float]] = {"configured": [], "calibrated": []}
    values = []
    for seed in range(VOYAGES):
        run = simulate(scenario, seed)
        path = tmp_path / "alignment.yaml"
        ALIGNMENT_FILE.save(path, calibrate_run(run, core_for(scenario)).prior)
        voyage = simulate(next_voyage(run), 1000 + seed)
        for name, squares in errors.items():
            core = ShipAttitudeCore(config)
            if name == "calibrated":
                assert core.start_from(ALIGNMENT_FILE.load(path), voyage.start_ns) == []
            estimate, _ = feed_attitude(core, voyage)
            error_n = log_rotation(voyage.truth.rotation_nd[-1] @ estimate.rotation_nd.T)
            squares.append(float(error_n @ error_n))
        values.append(normalized_error_squared(error_n, estimate.covariance_n))
    low, high = mean_nees_band(VOYAGES, degrees=3)
    assert low <= np.mean(values) <= high
    rms = {name: np.sqrt(np.mean(squares)) / ARCSEC for name, squares in errors.items()}
    # The configured installations are off by 20" about each axis, the calibrated ones by tenths of an arcsecond; ten
    # seconds of stars add their noise to both.
    assert rms["calibrated"] < 0.3 * rms["configured"], rms
