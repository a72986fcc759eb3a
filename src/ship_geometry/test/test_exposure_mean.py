"""The mean over an exposure against averages of true motions, and the noise of the mean due to the samples."""

import numpy as np
import pytest

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S, exposure_motion, exposure_nodes

SECOND_NS = 1_000_000_000
# Time of the largest roll, where the angular acceleration is largest.
CREST_S = 2.75


def roll(time_s: np.ndarray) -> np.ndarray:
    """Roll with an amplitude of 4° and a period of 11 s, rad."""
    return np.deg2rad(4.0) * np.sin(2.0 * np.pi * np.asarray(time_s) / 11.0)


def attitude(time_s: float) -> np.ndarray:
    """Return the attitude of a ship that rolls, pitches and turns."""
    heading, pitch = np.deg2rad(3.0 * time_s), np.deg2rad(5.0) * np.sin(2 * np.pi * time_s / 6.0)
    return rotation_from_angles(heading, pitch, np.deg2rad(10.0) * np.sin(2 * np.pi * time_s / 8.0 + 0.3))


def times_s(exposure_s: float, count: int = 4000) -> np.ndarray:
    """Return many evenly spaced times of an exposure, each the middle of its part."""
    return exposure_s * ((np.arange(count) + 0.5) / count - 0.5)


@pytest.mark.parametrize(("exposure_s", "issue_arcsec"), [(0.05, 0.5), (0.1, 2.0), (0.2, 7.8)])
def test_mean_of_a_roll_differs_from_the_middle(exposure_s, issue_arcsec):
    true = np.mean(roll(CREST_S + times_s(exposure_s))) - roll(CREST_S)
    assert abs(true) / ARCSEC == pytest.approx(issue_arcsec, abs=0.06)
    nodes = exposure_nodes(exposure_s)
    found = nodes.mean(roll(CREST_S + np.array(nodes.offset_ns) * 1e-9)) - roll(CREST_S)
    assert found == pytest.approx(true, rel=1e-3)


@pytest.mark.parametrize("exposure_s", [1e-3, 0.1, 0.2, 0.21, 0.5, 1.3, LONGEST_EXPOSURE_S])
def test_mean_and_spread_equal_those_of_many_times(exposure_s):
    nodes, many = exposure_nodes(exposure_s), 1.7 + times_s(exposure_s)
    assert nodes.weight.sum() == pytest.approx(1.0, abs=1e-15)
    assert np.all(nodes.weight >= 0.0)
    assert 0 in nodes.offset_ns
    at_nodes = np.stack([roll(1.7 + np.array(nodes.offset_ns) * 1e-9), np.array(nodes.offset_ns) * 1e-9], axis=-1)
    true = np.stack([roll(many), many - 1.7], axis=-1)
    np.testing.assert_allclose(nodes.mean(at_nodes), true.mean(axis=0), atol=1e-3 * ARCSEC)
    np.testing.assert_allclose(nodes.covariance(at_nodes), np.cov(true.T, bias=True), rtol=3e-3, atol=1e-18)


def track(rate_hz: float, measured_rates: bool, noise: np.ndarray | None = None) -> AttitudeTrack:
    """Return a track of the ship from -1 s to 1 s; each sample is rotated by its noise (rotation vector), if given."""
    found = AttitudeTrack(round(2.5 * SECOND_NS / rate_hz))
    for row, number in enumerate(range(round(-rate_hz), round(rate_hz) + 1)):
        time_s = number / rate_hz
        rotation_nd = attitude(time_s)
        turned = log_rotation(attitude(time_s - 1e-4).T @ attitude(time_s + 1e-4)) / 2e-4 if measured_rates else None
        if noise is not None:
            rotation_nd = rotation_nd @ exp_rotation(noise[row])
        found.insert(AttitudeSample(round(time_s * SECOND_NS), rotation_nd, turned))
    return found


@pytest.mark.parametrize(("rate_hz", "measured_rates"), [(100.0, True), (100.0, False), (20.0, True), (5.0, True)])
@pytest.mark.parametrize("exposure_s", [0.05, 0.2, 0.5])
def test_mean_direction_is_that_of_the_true_motion(rate_hz, measured_rates, exposure_s):
    """Angular and centripetal acceleration both move the mean direction in the rotating body."""
    middle_ns = 33_000_000
    turning = exposure_motion(track(rate_hz, measured_rates), middle_ns, exposure_nodes(exposure_s))
    seen = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    true = np.mean([attitude(0.033 + t).T @ attitude(0.033) @ seen for t in times_s(exposure_s, 400)], axis=0)
    found = turning.nodes.mean(turning.turns @ seen)
    assert np.max(np.abs(true - seen)) > 0.4 * ARCSEC * (exposure_s / 0.05) ** 2
    np.testing.assert_allclose(found, true, atol=max(0.02 * ARCSEC, 2e-3 * np.max(np.abs(true - seen))))


def test_the_rate_is_that_of_the_mean_and_holds_little_of_the_noise():
    """Over a quarter of a second two samples with 1" give a rate with 6" per second, about each axis."""
    middle_ns, nodes, rng = 33_000_000, exposure_nodes(0.25), np.random.default_rng(5)
    true = log_rotation(attitude(0.033).T @ np.array([attitude(0.033 + t) for t in (-0.125, 0.125)]))
    noisy = []
    for _ in range(100):
        turning = exposure_motion(track(100.0, True, ARCSEC * rng.standard_normal((201, 3))), middle_ns, nodes)
        noisy.append(turning.rate - (true[1] - true[0]) / 0.25)
    # 99.9 % of chi-square with 300 degrees of freedom: RMS/sigma in [0.87, 1.14]; between the samples sigma is smaller.
    assert np.sqrt(np.mean(np.square(noisy))) < 1.14 * np.sqrt(2.0) / 0.25 * ARCSEC


@pytest.mark.parametrize(("rate_hz", "measured_rates"), [(100.0, True), (100.0, False), (7.0, True), (7.0, False)])
def test_the_noise_gains_are_what_each_sample_does(rate_hz, measured_rates):
    """Derivative of the mean attitude by each sample, by finite differences, squared and summed."""
    middle_ns, step = 13_000_000, 1e-6
    count = 2 * round(rate_hz) + 1
    nodes = exposure_nodes(0.15)

    def mean_and_middle(noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        samples = track(rate_hz, measured_rates, noise)
        exact = track(rate_hz, measured_rates)
        errors = [
            log_rotation(exact.at(middle_ns + ns).rotation_nd.T @ samples.at(middle_ns + ns).rotation_nd)
            for ns in (*nodes.offset_ns, 0)
        ]
        return nodes.mean(np.array(errors[:-1]))[0] / step, errors[-1][0] / step

    of_mean, of_difference = [], []
    for row in range(count):
        noise = np.zeros((count, 3))
        noise[row, 0] = step
        mean, middle = mean_and_middle(noise)
        of_mean.append(mean)
        of_difference.append(mean - middle)
    turning = exposure_motion(track(rate_hz, measured_rates), middle_ns, nodes)
    assert turning.noise_gain == pytest.approx(np.sum(np.square(of_mean)), rel=0.01)
    assert turning.correction_gain == pytest.approx(np.sum(np.square(of_difference)), rel=0.02)


def test_no_exposure_motion_with_a_gap_in_the_track():
    whole, nodes = track(100.0, measured_rates=True), exposure_nodes(0.1)
    assert exposure_motion(whole, 0, nodes) is not None
    for outside_ns in (-950_000_000, 950_000_000, 3 * SECOND_NS):
        assert exposure_motion(whole, outside_ns, nodes) is None


@pytest.mark.parametrize(("rate_hz", "measured_rates"), [(100.0, False), (5.0, True), (5.0, False), (2.5, False)])
def test_interpolation_error_of_the_correction_is_within_its_sigma(rate_hz, measured_rates):
    samples = track(rate_hz, measured_rates)
    distances, claimed_arcsec = [], []
    for exposure_s in (0.05, 0.1, 0.2):
        for middle_ns in range(-500_000_000, 500_000_000, 37_000_000):
            turning = exposure_motion(samples, middle_ns, exposure_nodes(exposure_s))
            if turning is None:
                continue
            true = np.mean(
                [
                    log_rotation(attitude(middle_ns * 1e-9).T @ attitude(middle_ns * 1e-9 + t))
                    for t in times_s(exposure_s, 100)
                ],
                axis=0,
            )
            found = turning.nodes.mean(log_rotation(np.swapaxes(turning.turns, -1, -2)))
            sigma = np.sqrt(turning.correction_error + (0.01 * ARCSEC) ** 2)
            distances.append(np.linalg.norm(found - true) / sigma)
            claimed_arcsec.append(np.sqrt(turning.correction_error) / ARCSEC)
    assert len(distances) > 30
    assert np.sqrt(np.mean(np.square(distances))) < 1.0
    assert np.max(distances) < 3.0
    assert rate_hz < 50.0 or np.max(claimed_arcsec) < 0.1
