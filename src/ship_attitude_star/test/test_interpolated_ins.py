"""An INS with few samples: the interpolation error is in the published covariance."""

import os

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.measurements.device import SOURCE_INTERPOLATION
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeMeasurement

SECOND_NS, START_NS = 1_000_000_000, 1_700_000_000_000_000_000
INS_SIGMA_N = np.array([10.0, 72.0, 10.0]) * ARCSEC
STAR_SIGMA_S = np.array([100.0, 3.0, 3.0]) * ARCSEC
INSTALLATION_SIGMA_S = np.array([20.0, 1.0, 1.0]) * ARCSEC
DURATION_S, STAR_PERIOD_S = 24.0, 0.4
RUNS = int(os.environ.get("SEEDS", "16"))
"""Number of seeds; ``make campaign`` sets SEEDS to take more."""


class Swell:
    """Roll of about 5° in 10 s, pitch of 2° in 7 s, yaw of 0.7° in 20 s; sizes, periods and phases are random."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._period_s = np.array([20.0, 7.0, 10.0]) * rng.uniform(0.85, 1.2, 3)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        self._amplitude = np.deg2rad([0.7, 2.0, 5.0]) * rng.uniform(0.7, 1.2, 3)
        self._mean = np.array([rng.uniform(0.0, 2.0 * np.pi), 0.0, 0.0])

    def attitude(self, time_s: float) -> FloatArray:
        swing = np.sin(2.0 * np.pi * time_s / self._period_s + self._phase)
        return rotation_from_angles(*(self._mean + self._amplitude * swing))

    def rate(self, time_s: float) -> FloatArray:
        return log_rotation(self.attitude(time_s - 1e-3).T @ self.attitude(time_s + 1e-3)) / 2e-3


def configuration(rate_hz: float) -> ShipAttitudeConfig:
    gap_s = 1.5 / rate_hz
    return build(
        ShipAttitudeConfig,
        {
            "ins": {"max_gap_s": gap_s, "silence_s": max(1.0, 2.0 * gap_s)},
            "coasting_after_s": max(2.0, 3.0 * gap_s),
            "star_sensors": {
                "fore": {"azimuth_deg": 0.0, "elevation_deg": 45.0},
                "starboard": {"azimuth_deg": 90.0, "elevation_deg": 45.0},
            },
        },
    )


def last_estimate(rate_hz: float, rates: bool, seed: int) -> tuple[FloatArray, AttitudeEstimate]:
    """Return the error of the last attitude of a run, horizon frame, rad, and this attitude."""
    rng = np.random.default_rng([27, seed])
    swell, core = Swell(rng), ShipAttitudeCore(configuration(rate_hz))
    ins_error_n, tau_s = rng.normal(size=3) * INS_SIGMA_N, rng.normal() * 0.005
    arrivals = [(k / rate_hz, "ins", k / rate_hz) for k in range(int(DURATION_S * rate_hz) + 1)]
    mounted = {}
    for name in ("star.fore", "star.starboard"):
        mounted[name] = core.filter.devices[name].rotation_dv0 @ exp_rotation(rng.normal(size=3) * INSTALLATION_SIGMA_S)
        phase_s = rng.uniform(0.0, STAR_PERIOD_S)
        stamps_s = phase_s + STAR_PERIOD_S * np.arange(int(DURATION_S / STAR_PERIOD_S))
        arrivals += [(stamp_s + 0.05, name, stamp_s) for stamp_s in stamps_s.tolist()]
    newest: tuple[float, AttitudeEstimate] | None = None
    for _, source, stamp_s in sorted(arrivals):
        time_ns = START_NS + round(stamp_s * SECOND_NS)
        if source == "ins":
            white = exp_rotation(rng.normal(size=3) * ARCSEC)
            attitude = exp_rotation(-ins_error_n) @ white @ swell.attitude(stamp_s + tau_s)
            rate_d = swell.rate(stamp_s + tau_s) if rates else None
            for estimate in core.ins.add(AttitudeSample(time_ns, attitude, rate_d)).estimates:
                newest = stamp_s, estimate
        else:
            noise = exp_rotation(rng.normal(size=3) * STAR_SIGMA_S)
            attitude = swell.attitude(stamp_s) @ mounted[source] @ noise
            core.add_measurement(AttitudeMeasurement(source, time_ns, attitude, np.diag(STAR_SIGMA_S**2)))
    assert newest is not None
    stamp_s, estimate = newest
    return log_rotation(swell.attitude(stamp_s) @ estimate.rotation_nd.T), estimate


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("rate_hz", "rates", "conservative"),
    [(5.0, True, False), (5.0, False, True), (2.5, False, True), (1.0, True, False), (1.0, False, True)],
)
def test_errors_are_consistent_with_the_covariance_at_low_rates(
    rate_hz: float, rates: bool, conservative: bool
) -> None:
    """A covariance without the interpolation error gives a mean NEES of 6 at 5 Hz and 15 at 2.5 Hz, both without rates.

    At 1 Hz the mean NEES is 6 with rates and 850 without rates.
    """
    nees = []
    for seed in range(RUNS):
        error_n, estimate = last_estimate(rate_hz, rates, seed)
        assert estimate.status is Status.VALID
        nees.append(float(normalized_error_squared(error_n, estimate.covariance_n)))
    low, high = mean_nees_band(RUNS, 3)
    print(f"{rate_hz:g} Hz, rates {rates}: mean NEES {np.mean(nees):.2f} in [{low:.2f}, {high:.2f}]")
    assert (0.0 if conservative else low) < np.mean(nees) < high
    assert max(nees) < 25.0


def test_measurements_between_the_same_two_samples_share_their_error_of_interpolation() -> None:
    swell, core = Swell(np.random.default_rng(3)), ShipAttitudeCore(configuration(1.0))
    for second in range(6):
        sample = AttitudeSample(START_NS + second * SECOND_NS, swell.attitude(second), swell.rate(second))
        core.ins.add(sample)
    time_ns, mounted = START_NS + 3_500_000_000, core.filter.devices["star.fore"].rotation_dv0
    measured = AttitudeMeasurement("star.fore", time_ns, swell.attitude(3.5) @ mounted, np.diag(STAR_SIGMA_S**2))
    tenth_ns, noise = SECOND_NS // 10, []
    # Factors: 1 for a first measurement, 5 at 5 Hz, 10 at 5 Hz with another sensor, 1 at 0.2 Hz, 1 with another sensor
    # 2 s before.
    for used in (
        {},
        {"star.fore": 2 * tenth_ns},
        {"star.fore": 2 * tenth_ns, "star.starboard": tenth_ns},
        {"star.fore": 50 * tenth_ns},
        {"star.starboard": 20 * tenth_ns},
    ):
        used_ns = {source: time_ns - before_ns for source, before_ns in used.items()}
        state, track = core.state, core.ins.track
        found = core.filter.linearisation.linearise(measured, state.mean, state.covariance, used_ns, track, None)
        row = core.filter.model.source_indices[SOURCE_INTERPOLATION]
        noise.append(np.trace(found.compared.linear.noise_by_source[row]))
    np.testing.assert_allclose(np.array(noise) / noise[0], [1.0, 5.0, 10.0, 1.0, 1.0])


def test_the_budget_names_interpolation() -> None:
    core = ShipAttitudeCore(configuration(2.5))
    _, slow = last_estimate(2.5, False, 1)
    _, fast = last_estimate(10.0, True, 1)
    row = core.filter.model.sources.index(SOURCE_INTERPOLATION)
    parts = slow.covariance_by_source_n
    np.testing.assert_allclose(parts.sum(axis=0), slow.covariance_n, rtol=1e-9)
    assert np.trace(parts[row]) > (1.0 * ARCSEC) ** 2
    # At 10 Hz with rates the interpolation error is negligible.
    assert np.trace(fast.covariance_by_source_n[row]) < 0.01 * np.trace(fast.covariance_n)
