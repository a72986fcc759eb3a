"""Remembered calibration: residuals of beacons against geometry and in distribution, differences, jumps."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC
from ship_testing.simulated_session import config, session, sweep
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.optical_axis.memory import (
    largest_difference_sigmas,
    memory_residuals,
    propagate_memory,
    start_from_memory,
)
from theodolite_calib.optical_axis.streams import STUCK_SIGMA_RAD, StreamJump
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.sighting import Sighting

SETTINGS = config(ship_antenna__sigma_m=0.01)
FILTER = CalibrationFilter(SETTINGS)


def remembered_state(seed: int, later_s: float = 20.0) -> tuple[CalibrationState, Sighting]:
    """Return a state after 40 sightings, and the sighting of some seconds later."""
    times_s = np.append(np.arange(40.0), 40.0 + later_s)
    *before, after = session(SETTINGS, seed, times_s, sweep(times_s)).sightings
    return run_filter(before), after


def run_filter(sightings: list[Sighting]) -> CalibrationState:
    state = FILTER.initial_state()
    for sighting in sightings:
        predicted = FILTER.propagate(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
        comparison = FILTER.compare(predicted, sighting)
        assert comparison is not None
        state, _ = FILTER.update_by_beacons(predicted, sighting, comparison)
    return state


def move_across(sighting: Sighting, right_m: float) -> Sighting:
    """Return the sighting with all baselines moved to the right of their lines of sight."""
    north, _, east = sighting.beacons.baseline_n.T
    right_n = np.column_stack([-east, np.zeros_like(north), north]) / np.hypot(north, east)[:, None]
    return replace(
        sighting, beacons=replace(sighting.beacons, baseline_n=sighting.beacons.baseline_n + right_m * right_n)
    )


def test_moved_baseline_turns_its_beacon_to_the_other_side() -> None:
    """The angle is the shift across the line of sight divided by the distance."""
    state, sighting = remembered_state(1)
    moved_n = np.array([0.4, 0.5, -0.3])
    baseline_n = sighting.beacons.baseline_n.copy()
    baseline_n[0] += moved_n
    moved = replace(sighting, beacons=replace(sighting.beacons, baseline_n=baseline_n))
    first, other = sighting.names
    before, after = memory_residuals(FILTER, state, sighting), memory_residuals(FILTER, state, moved)
    north, up, east = baseline_n[0]
    distance_m, level_m = np.linalg.norm(baseline_n[0]), np.hypot(north, east)
    right_n = np.array([-east, 0.0, north]) / level_m
    up_n = np.array([-up * north, level_m**2, -up * east]) / (level_m * distance_m)
    expected = -np.array([right_n @ moved_n, up_n @ moved_n]) / distance_m
    # The lever rotates the line of sight relative to the baseline by less than 0.01 rad.
    np.testing.assert_allclose(after[first].turn - before[first].turn, expected, atol=0.02 * np.linalg.norm(expected))
    np.testing.assert_allclose(after[other].turn, before[other].turn, atol=1e-12)


def test_separations_have_the_covariance_that_is_stated() -> None:
    """The mean of the normalised squares, one sample a seed, is within the 99.9 % band of chi-square."""
    values = []
    for seed in range(200):
        state, sighting = remembered_state(seed)
        one = memory_residuals(FILTER, state, sighting)[sighting.names[0]]
        values.append(float(one.turn @ np.linalg.solve(one.expected + one.noise, one.turn)))
    low, high = mean_nees_band(len(values), 2)
    assert low < np.mean(values) < high


def test_expected_covariance_grows_with_time() -> None:
    state, sighting = remembered_state(2)
    later = propagate_memory(FILTER, state, [], sighting.time_ns + SECOND_NS)
    now = memory_residuals(FILTER, state, sighting)[sighting.names[0]]
    then = memory_residuals(FILTER, later, replace(sighting, time_ns=later.time_ns))[sighting.names[0]]
    # Within a second, the earlier covariance decays by only a thousandth.
    np.testing.assert_allclose(then.expected - now.expected, now.drift, atol=0.01 * np.max(now.expected))


def test_a_start_from_the_memory_departs_from_it_by_nothing() -> None:
    state, sighting = remembered_state(3)
    now = sighting.ship, sighting.encoder
    start = start_from_memory(FILTER, state)
    assert largest_difference_sigmas(FILTER, start, state, *now) == pytest.approx(0.0, abs=1e-9)
    assert not start.fault_state.excluded
    assert start.last_update_ns is None
    row = FILTER.model.slices["focal_length"].start
    mean = start.mean.copy()
    mean[row] += 10.0 * np.sqrt(state.covariance[row, row])
    # With the sum of both covariances, the sigma is √2 times as large.
    departure = largest_difference_sigmas(FILTER, replace(start, mean=mean), state, *now)
    assert departure == pytest.approx(10.0 / np.sqrt(2.0), rel=1e-6)
    later = largest_difference_sigmas(FILTER, replace(start, mean=mean), state, *now, is_later=True)
    assert later == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize(("moved_m", "least", "most"), [(0.0, 0.0, 3.0), (1.0, 4.0, np.inf)])
def test_difference_from_memory_after_all_beacons_moved(moved_m, least, most) -> None:
    """One metre at 2 km is 103″; no single state shows the shift, as each is uncertain by tens of arcseconds."""
    departures = []
    for seed in range(10):
        times_s = np.append(np.arange(40.0), 70.0 + np.arange(20.0))
        sightings = session(SETTINGS, seed, times_s, sweep(times_s)).sightings
        memory = run_filter(sightings[:40])
        moved = [move_across(sighting, moved_m) for sighting in sightings[40:]]
        departures.append(
            largest_difference_sigmas(FILTER, run_filter(moved), memory, moved[-1].ship, moved[-1].encoder)
        )
    assert least <= np.min(departures)
    assert np.max(departures) < most


def test_jumps_of_the_encoders_widen_the_memory_by_their_size() -> None:
    state, sighting = remembered_state(4)
    jump = StreamJump(EncoderJump(sighting.time_ns - SECOND_NS, np.array([300.0, 0.0]) * ARCSEC, ARCSEC))
    widened = memory_residuals(FILTER, propagate_memory(FILTER, state, [jump], sighting.time_ns), sighting)
    sigma = np.sqrt(np.max(np.linalg.eigvalsh(widened[sighting.names[0]].expected))) / ARCSEC
    elevation = sighting.encoder.elevation
    assert sigma == pytest.approx(300.0 * np.cos(elevation), rel=0.15)
    assert np.sqrt(jump.covariance_n[0, 0]) / ARCSEC == pytest.approx(300.0, rel=0.01)
    stuck = StreamJump(EncoderJump(0, np.zeros(2), STUCK_SIGMA_RAD))
    unknown = memory_residuals(FILTER, propagate_memory(FILTER, state, [stuck], sighting.time_ns), sighting)
    assert np.min(np.diagonal(unknown[sighting.names[0]].expected)) > np.deg2rad(5.0) ** 2
