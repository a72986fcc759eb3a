"""Drifting encoders under observation of beacons: the solution separations inflate the published covariance."""

import functools
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_testing.simulated_session import config, session, sweep
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.output import PendingPointing, PointingLevels, PointingOutput
from theodolite_calib.samples.samples import EncoderSample, Exposure, PointingEstimate

SEEDS = 8
START_S = 30.0
DRIFT_PER_S = 200.0 / 60.0 * ARCSEC
SETTINGS = config()
FILTER = CalibrationFilter(SETTINGS)


@dataclass(frozen=True)
class ValidPointing:
    """VALID pointing, the time since the encoders began to drift, and the truth."""

    since_s: float
    estimate: PointingEstimate
    rotation_nm: FloatArray

    @property
    def separation_covariance_n(self) -> FloatArray:
        """Return the part of the covariance from the solution separations."""
        return self.estimate.covariance_n - self.estimate.covariance_without_separation_n

    def sigmas(self, covariance_n: FloatArray) -> float:
        """Return the largest error of azimuth, elevation and image rotation in sigmas of a covariance."""
        azimuth, elevation, _ = angles_from_rotation(self.estimate.rotation_nm)
        to_angles = angle_errors_from_rotation_vector(azimuth, elevation)
        error = to_angles @ log_rotation(self.rotation_nm @ self.estimate.rotation_nm.T)
        return float(np.max(np.abs(error) / np.sqrt(np.diagonal(to_angles @ covariance_n @ to_angles.T))))


@functools.cache
def valid_pointings() -> tuple[ValidPointing, ...]:
    """Return VALID pointings of each session before an exclusion; sightings at 5 Hz, azimuth drift from 30 s on."""
    times_s, out, found = np.arange(0.0, START_S + 60.0, 0.2), PointingOutput(SETTINGS, FILTER), []
    for seed in range(SEEDS):
        given = session(SETTINGS, seed, times_s, sweep(times_s))
        state, step = FILTER.initial_state(), SightingStep(SETTINGS, FILTER)
        for time_s, sighting, rotation_nm in zip(times_s, given.sightings, given.rotation_nm, strict=True):
            azimuth = sighting.encoder.azimuth + DRIFT_PER_S * max(time_s - START_S, 0.0)
            drifted = replace(sighting, encoder=replace(sighting.encoder, azimuth=azimuth))
            state, _ = step(state, drifted, Exposure(drifted.time_ns, ()))
            sigma = float(np.sqrt(drifted.encoder.noise))
            sample = EncoderSample(drifted.time_ns, np.array([azimuth, drifted.encoder.elevation]), sigma)
            estimate = out.estimate(PendingPointing(sample, drifted.ship, "", 0.0, state))
            if state.fault_state.excluded:
                break
            if estimate.status is Status.VALID:
                found.append(ValidPointing(time_s - START_S, estimate, rotation_nm))
    return tuple(found)


@pytest.mark.slow
def test_separations_inflate_the_covariance_before_an_exclusion() -> None:
    drifting = [one for one in valid_pointings() if one.since_s > 0.0]
    with_it = [one.sigmas(one.estimate.covariance_n) > 5.0 for one in drifting]
    without = [one.sigmas(one.estimate.covariance_without_separation_n) > 5.0 for one in drifting]
    # Some errors remain, because they begin before the solution separation exceeds three sigmas.
    assert sum(without) > 60
    assert sum(with_it) < sum(without) / 3


def test_separations_are_small_without_faults() -> None:
    right = [np.any(one.separation_covariance_n) for one in valid_pointings() if -25.0 < one.since_s <= 0.0]
    assert len(right) > 500
    assert np.mean(right) < 0.05


def test_levels_and_separations_rest_on_the_covariance_without_it() -> None:
    one = max(valid_pointings(), key=lambda one: float(np.trace(one.separation_covariance_n))).estimate
    assert np.trace(one.covariance_n) > 2.0 * np.trace(one.covariance_without_separation_n)
    assert one.covariance_by_source_n.sum(axis=0) == pytest.approx(one.covariance_n, rel=1e-12)
    plain = replace(one, covariance_n=one.covariance_without_separation_n)
    report, expected = (PointingLevels(FILTER, SETTINGS, each.state).integrity_of(each) for each in (one, plain))
    np.testing.assert_array_equal(report.statistic, expected.statistic)
    np.testing.assert_array_equal(report.level, expected.level)
    assert np.all(np.isfinite(report.level))
    lower = replace(one, covariance_without_separation_n=one.covariance_n)
    less = PointingLevels(FILTER, SETTINGS, lower.state).integrity_of(lower)
    assert np.any(less.level > report.level)
