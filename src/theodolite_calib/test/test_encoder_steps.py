"""Detection of encoder steps, despite motions that begin and end, and despite single wrong readings."""

import math

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.sample_track import VectorTrack
from theodolite_calib.samples.encoder_check import EncoderCheck
from theodolite_calib.samples.samples import EncoderSample

RATE_HZ = 50
PERIOD_NS = 20_000_000
FAST = math.radians(100.0)
"""Usual maximum acceleration of a mount, rad/s²: from rest to rest within a period it moves by FAST/4 (1/50)² = 36"."""


def motion(seconds, rng, sigma_arcsec=1.0):
    """Return noisy readings of a sweep as in theodolite.yaml: azimuth 1.2 deg/s, elevation 40 ± 30 deg in 110 s."""
    azimuth, elevation = np.radians(1.2) * seconds, np.radians(40.0 + 30.0 * np.sin(2 * np.pi * seconds / 110.0))
    noise = sigma_arcsec * ARCSEC * rng.standard_normal((len(seconds), 2))
    return np.column_stack([azimuth, elevation]) % (2 * np.pi) + noise


def check_readings(angles, acceleration=FAST, times_ns=None):
    """Return the check, and for each reading: True if readings are unconfirmed after it, its rejection, its slip."""
    check, found = EncoderCheck(ARCSEC, acceleration), []
    for number, row in enumerate(angles):
        time_ns = number * PERIOD_NS if times_ns is None else int(times_ns[number])
        checked = check.check(EncoderSample(time_ns, row, ARCSEC), VectorTrack(PERIOD_NS))
        found.append((bool(check.unconfirmed_reason), checked.rejection, checked.jump))
    return check, found


@pytest.mark.parametrize("axis", [0, 1])
def test_step_is_unconfirmed_until_beacons_agree(axis):
    """A cubic through twelve readings predicts with a sigma of 1.92"; 20" is 3.9 sigma above the bound of 12.5"."""
    seconds, at = np.arange(120) / RATE_HZ, 100
    first = lasts = 0
    for seed in range(200):
        angles = motion(seconds, np.random.default_rng(seed))
        angles[at:, axis] += 20.0 * ARCSEC
        check, found = check_readings(angles)
        first += found[at][0]
        lasts += all(is_unconfirmed for is_unconfirmed, *_ in found[at:])
        assert all(rejection is None and jump is None for _, rejection, jump in found)
        check.confirm((at - 1) * PERIOD_NS)
        assert bool(check.unconfirmed_reason) == found[-1][0]
        check.confirm(119 * PERIOD_NS)
        assert not check.unconfirmed_reason
    assert first == 200
    assert lasts >= 196  # 2.5 sigma one-sided: the second error is at most 1.25 times the first


def test_a_step_that_no_mount_can_make_in_place_is_a_slip():
    """55" are less than FAST · period² = 144", so the first reading might be the start of a slew."""
    seconds, at = np.arange(120) / RATE_HZ, 100
    for seed in range(50):
        angles = motion(seconds, np.random.default_rng(seed))
        angles[at:, 1] -= 55.0 * ARCSEC
        _, found = check_readings(angles)
        (number,) = [n for n, (_, rejection, _) in enumerate(found) if rejection is not None]
        _, rejection, jump = found[number]
        assert number == at + 1
        assert rejection.reason is Reason.GATE
        assert jump.time_ns == at * PERIOD_NS - 1
        assert np.all(np.abs(jump.jump - [0.0, -55.0 * ARCSEC]) < 4.5 * jump.sigma_rad)
        assert all(is_unconfirmed for is_unconfirmed, *_ in found[at:])
        # A mount with twice the acceleration moves by 72" from rest to rest, so it may have moved.
        assert all(rejection is None for _, rejection, _ in check_readings(angles, 2.0 * FAST)[1])


def test_slews_are_no_steps():
    """Slews with trapezoidal rates at any phase: on average at most two readings at each corner are unconfirmed."""
    seconds = np.arange(600) / RATE_HZ
    corners = unconfirmed = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        acceleration, top = np.radians(rng.uniform(1.0, 60.0)), np.radians(rng.uniform(0.5, 10.0))
        fine = np.arange(0.0, 12.0, 1e-4)
        start, stop = rng.uniform(3.0, 4.0), rng.uniform(7.0, 8.0)
        rate = np.clip(acceleration * (fine - start), 0.0, top) - np.clip(acceleration * (fine - stop), 0.0, top)
        turned = np.interp(seconds, fine, np.cumsum(rate) * 1e-4)
        angles = motion(seconds, rng)
        angles[:, 0] += turned * rng.choice([-1.0, 1.0])
        _, found = check_readings(angles % (2 * np.pi), FAST)
        assert all(rejection is None and jump is None for _, rejection, jump in found)
        assert not found[-1][0]
        corners, unconfirmed = corners + 4, unconfirmed + sum(is_unconfirmed for is_unconfirmed, *_ in found)
    assert unconfirmed <= 2 * corners


def test_single_wrong_reading_is_not_unconfirmed():
    angles = motion(np.arange(130) / RATE_HZ, np.random.default_rng(1))
    angles[100] += 60.0 * ARCSEC
    _, found = check_readings(angles)
    assert [number for number, (is_unconfirmed, *_) in enumerate(found) if is_unconfirmed] == [100]


@pytest.mark.statistics
@pytest.mark.parametrize("sigma_arcsec", [0.3, 1.0, 5.0])
def test_valid_readings_are_no_steps(sigma_arcsec):
    """Noise above the stated sigma is estimated; stamps with a jitter of a tenth of a period are used unchanged."""
    rng = np.random.default_rng(7)
    seconds = np.arange(20_000) / RATE_HZ + rng.uniform(-0.1, 0.1, 20_000) / RATE_HZ
    angles = motion(seconds, rng, sigma_arcsec)
    _, found = check_readings(angles, times_ns=np.round(seconds * 1e9) + 10**9)
    assert not any(is_unconfirmed for is_unconfirmed, *_ in found)


def test_a_mount_that_takes_out_the_roll_at_twenty_hertz_hides_no_step():
    """A roll of 4 deg in 11 s: a parabola through eight readings is wrong by 2.7", a cubic by less than its noise."""
    seconds, at = np.arange(200) / 20.0, 150
    first = 0
    for seed in range(100):
        angles = motion(seconds, np.random.default_rng(seed))
        angles[:, 1] += np.radians(4.0) * np.sin(2.0 * np.pi * seconds / 11.0 + seed)
        angles[at:, 1] += 20.0 * ARCSEC
        _, found = check_readings(angles, times_ns=np.round(seconds * 1e9))
        first += found[at][0]
        assert not any(is_unconfirmed for is_unconfirmed, *_ in found[:at])
    assert first >= 99
