"""Interpolation errors of sparse samples are part of the stated noise."""

import numpy as np

from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_testing.simulated_session import config
from theodolite_calib.samples.samples import BaselineSample, EncoderSample, ShipSample
from theodolite_calib.samples.tracks import MeasuredTracks

STEP_NS, SECOND_NS = 400_000_000, 1_000_000_000
ENCODER_SIGMA = 1.0 * ARCSEC
BASELINE_VARIANCE = 0.01**2
VALID, DEGRADED = Status.VALID, Status.DEGRADED
ABOUT = {"long before": -STEP_NS - 1, "before": -1, "at it": 0, "after": 1, "long after": STEP_NS}
"""Times relative to one sample, ns."""


def encoder_angles(time_s: float) -> np.ndarray:
    """Return encoder angles as of a telescope that is moved by hand, rad."""
    azimuth_deg, elevation_deg = 10.0 * np.sin(2.0 * np.pi * time_s / 6.0), 5.0 * np.cos(2.0 * np.pi * time_s / 5.0)
    return np.deg2rad([30.0 + azimuth_deg, 40.0 + elevation_deg])


def ship_attitude(time_s: float) -> np.ndarray:
    return rotation_from_angles(0.3, np.deg2rad(2.0) * np.sin(time_s), np.deg2rad(6.0) * np.sin(0.7 * time_s))


def baseline(time_s: float) -> np.ndarray:
    """Return the baseline of a drone on a circle of 50 m in 12 s."""
    angle = 2.0 * np.pi * time_s / 12.0
    return np.array([1000.0 + 50.0 * np.cos(angle), 200.0, 50.0 * np.sin(angle)])


def inputs() -> MeasuredTracks:
    slow = MeasuredTracks(config(encoder__max_gap_s=0.5, ship__max_gap_s=0.5, beacons__alpha__rtk__max_gap_s=0.5))
    for k in range(60):
        time_ns, time_s = k * STEP_NS, k * STEP_NS / SECOND_NS
        slow.encoder.insert(EncoderSample(time_ns, encoder_angles(time_s), ENCODER_SIGMA))
        slow.ship.insert(ShipSample(time_ns, ship_attitude(time_s)))
        slow.baselines["alpha"].insert(BaselineSample(time_ns, baseline(time_s), BASELINE_VARIANCE * np.eye(3)))
        if "alpha" in slow.drones:
            slow.drones["alpha"].insert(AttitudeSample(time_ns, ship_attitude(time_s)))
    return slow


def test_an_attitude_between_two_is_worth_no_more_than_either() -> None:
    """The source may have jumped between two attitudes: an interpolated attitude then contains a part of the jump."""
    slow = inputs()
    jumped_ns = 20 * STEP_NS
    slow.ship.insert(ShipSample(jumped_ns, ship_attitude(8.0) @ rotation_from_angles(0.001, 0.0, 0.0), status=DEGRADED))
    worth = {name: slow.ship_at(jumped_ns + offset) for name, offset in ABOUT.items()}
    statuses = {name: ship.status for name, ship in worth.items() if ship is not None}
    assert statuses == {
        "long before": VALID,
        "before": DEGRADED,
        "at it": DEGRADED,
        "after": DEGRADED,
        "long after": VALID,
    }


def test_assembled_sighting_includes_interpolation_errors() -> None:
    slow = inputs()
    of_encoder, of_ship, of_baseline = [], [], []
    for time_ns in np.random.default_rng(27).integers(2 * STEP_NS, 56 * STEP_NS, 200).tolist():
        time_s = time_ns / SECOND_NS
        encoder, ship = slow.encoder_at(time_ns), slow.ship_at(time_ns)
        placed = slow.baselines["alpha"].baseline_at(time_ns)
        assert encoder is not None
        assert ship is not None
        assert isinstance(placed, tuple)
        off = np.array([encoder.azimuth, encoder.elevation]) - encoder_angles(time_s)
        of_encoder.append(off @ off / encoder.noise)
        off = log_rotation(ship.rotation_nd.T @ ship_attitude(time_s))
        of_ship.append(off @ off / ship.noise)
        off = placed[0] - baseline(time_s)
        of_baseline.append(off @ np.linalg.solve(placed[1], off))
    # The samples are without noise, so the errors are of interpolation alone. If the stated noise did not include these
    # errors, the ratios would be thousands of times as large.
    for found in (of_encoder, of_ship, of_baseline):
        assert 0.05 < np.mean(found) < 1.5
        assert np.max(found) < 12.0
