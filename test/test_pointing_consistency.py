"""Simulated sessions of the theodolite through the core of optical_axis: errors against the covariance claimed."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from ship_estimation.consistency import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import ARCSEC
from ship_replay.pointing_monte_carlo import PointingErrors, pointing_errors
from ship_replay.simulation.scenario_file import load_scenario
from theodolite_calib.samples import Mode

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src" / "ship_replay" / "test"))

from theodolite_scenes import replaced, with_beacons, with_theodolite  # noqa: E402

SEEDS = 16
LEAVE_S, END_S = 120.0, 240.0
MOMENTS_S = {"with lights": 119.0, "half a minute after": 150.0, "at the end": END_S}


@pytest.fixture(scope="module")
def sessions() -> list[PointingErrors]:
    """The sweep, shortened, at rates that cost little; all devices speak at the same moments."""
    scenario = load_scenario(ROOT / "bags" / "scenarios" / "theodolite_sweep.yaml")
    scenario = with_theodolite(
        scenario,
        encoder__rate_hz=5.0,
        telescope__phase_s=0.6,
        programme__azimuth_rate_deg_per_s=3.0,
        programme__elevation_period_s=44.0,
    )
    scenario = with_beacons(scenario, leaves_s=LEAVE_S, rtk__rate_hz=5.0, imu__rate_hz=5.0)
    scenario = dataclasses.replace(
        scenario,
        duration_s=END_S,
        ins=replaced(scenario.ins, rate_hz=1.0),
        fused_attitude=replaced(scenario.fused_attitude, rate_hz=5.0),
    )
    return [pointing_errors(scenario, seed) for seed in range(SEEDS)]


def test_sightings_are_used_and_pointings_given(sessions):
    assert {session.sightings + session.refused for session in sessions} == {120}
    # A gate of 99.99 % refuses one in five runs of 16 sessions, three once in a thousand.
    assert sum(session.refused for session in sessions) < 3
    assert {len(session.time_s) for session in sessions} == {1201}


def test_modes_follow_the_lights(sessions):
    session = sessions[0]
    recent = (session.time_s > 1.0) & (session.time_s < LEAVE_S)
    assert set(session.mode[recent]) == {Mode.TWO_LIGHTS}
    assert set(session.mode[session.time_s > LEAVE_S + 4.0]) == {Mode.ENCODER}


@pytest.mark.parametrize("moment", MOMENTS_S)
def test_errors_are_what_the_covariance_says(sessions, moment):
    rows = [int(np.argmin(np.abs(session.time_s - MOMENTS_S[moment]))) for session in sessions]
    errors_n = np.array([session.error_n[row] for session, row in zip(sessions, rows, strict=True)])
    covariances_n = np.array([session.covariance_n[row] for session, row in zip(sessions, rows, strict=True)])
    low, high = mean_nees_band(SEEDS, degrees=3)
    assert low < np.mean(normalized_error_squared(errors_n, covariances_n)) < high


def test_the_error_grows_as_the_deformation_is_forgotten(sessions):
    session = sessions[0]
    rows = {moment: np.argmin(np.abs(session.time_s - at_s)) for moment, at_s in MOMENTS_S.items()}
    sigmas_arcsec = {moment: session.sigma_on_sky[row] / ARCSEC for moment, row in rows.items()}
    # With lights the floor of 3" to 5"; of the deformation 28.3" (20" in each of two axes) sqrt(1 - exp(-2 t / 600 s)).
    assert 2.0 < sigmas_arcsec["with lights"] < 6.0
    for moment in ("half a minute after", "at the end"):
        forgotten_s = MOMENTS_S[moment] - LEAVE_S
        deformation = 28.3 * np.sqrt(1.0 - np.exp(-2.0 * forgotten_s / 600.0))
        assert deformation < sigmas_arcsec[moment] < np.hypot(deformation, 8.0)
