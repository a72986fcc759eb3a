"""Pixels counted from 1 are detected by the rotations of cameras: detection rate and false alarms."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import binom, f, norm

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_replay.preflight.check_camera import CameraTurn, cameras_counting_from_one, rate_corrected_turn

PIXEL = 22.7 * ARCSEC
INS_D = np.diag([10.0, 72.0, 10.0]) * ARCSEC
FORE, STARBOARD = (rotation_from_angles(*np.deg2rad([azimuth, 45.0, 0.0])) for azimuth in (0.0, 90.0))
ONE_PIXEL = PIXEL * np.array([0.0, 1.0, 1.0])


def camera(rng, ins_d, rotation_ds, installation_arcsec, counts_from_one):
    """Return a camera with an installation error and a measurement error drawn by their sigmas."""
    root_d = rotation_ds * (np.array(installation_arcsec) * ARCSEC)
    covariance_d = root_d @ root_d.T + ARCSEC**2 * np.eye(3)
    turn_d = ins_d + root_d @ rng.standard_normal(3) + ARCSEC * rng.standard_normal(3)
    pixel_d = rotation_ds @ ONE_PIXEL
    return CameraTurn(turn_d + counts_from_one * pixel_d, covariance_d, pixel_d)


def find_counted_from_one(seed, of_fore, of_starboard, installation_arcsec=(20.0, 1.0, 1.0)):
    rng = np.random.default_rng([63, seed])
    ins_d = INS_D @ rng.standard_normal(3)
    cameras = [
        camera(rng, ins_d, FORE, installation_arcsec, of_fore),
        camera(rng, ins_d, STARBOARD, installation_arcsec, of_starboard),
    ]
    return cameras_counting_from_one(cameras, INS_D**2)


def separation(of_fore, of_starboard):
    """Return the Mahalanobis distance between the rotations with and without a count from 1."""
    cameras = [camera(np.random.default_rng(0), np.zeros(3), r, (20.0, 1.0, 1.0), False) for r in (FORE, STARBOARD)]
    covariance = np.kron(np.ones((2, 2)), INS_D**2) + block_diag(*(c.covariance_d for c in cameras))
    shift = np.concatenate([of_fore * cameras[0].pixel_d, of_starboard * cameras[1].pixel_d])
    return np.sqrt(shift @ np.linalg.solve(covariance, shift))


@pytest.mark.parametrize(("of_fore", "of_starboard"), [(True, False), (False, True), (True, True)])
def test_pixels_counted_from_one_are_named(of_fore, of_starboard):
    """The difference of chi² between two hypotheses d apart is normal: mean d², standard deviation 2 d."""
    found = [find_counted_from_one(seed, of_fore, of_starboard) for seed in range(500)]
    true = tuple(np.flatnonzero([of_fore, of_starboard]))
    offsets = [
        separation(of_fore - other_fore, of_starboard - other_starboard)
        for other_fore, other_starboard in ((0, 0), (1, 0), (0, 1), (1, 1))
        if (other_fore, other_starboard) != (of_fore, of_starboard)
    ]
    # Least probability that no other hypothesis is likely, minus 1 % for hypotheses that do not fit the data.
    share = 1.0 - sum(norm.sf((d**2 - 12.0) / (2.0 * d)) for d in offsets) - 0.01
    assert found.count(true) >= binom.ppf(0.001, len(found), share)
    # Only by chance is another camera named.
    wrong = [cameras for cameras in found if not set(cameras) <= set(true)]
    assert len(wrong) <= binom.ppf(0.999, len(found), 9e-4)


@pytest.mark.parametrize("installation_arcsec", [(20.0, 1.0, 1.0), (20.0, 5.0, 5.0), (60.0, 60.0, 60.0)])
def test_pixels_counted_from_zero_are_hardly_ever_named(installation_arcsec):
    """Each of three alternatives has a probability of at most 3e-4; the bound is binomial, 99.9 % for 2000 draws."""
    found = [find_counted_from_one(seed, False, False, installation_arcsec) for seed in range(2000)]
    assert len(found) - found.count(()) <= binom.ppf(0.999, len(found), 9e-4)


def test_an_installation_that_is_off_is_no_count_from_one():
    rng = np.random.default_rng(3)
    turned = camera(rng, np.zeros(3), FORE, (20.0, 1.0, 1.0), False)
    off_d = FORE @ (PIXEL * np.array([0.0, -1.0, -1.0]))
    cameras = [CameraTurn(turned.turn_d + off_d, turned.covariance_d, turned.pixel_d)]
    assert cameras_counting_from_one(cameras, np.eye(3) * ARCSEC**2) == ()
    assert cameras_counting_from_one([], INS_D**2) == ()


def test_a_time_offset_of_the_ins_is_no_turn():
    """300 voyages of 3 s in a swell: the mean normalised squared error of the corrected rotation is in its band."""
    squares, times_s = [], np.linspace(0.0, 3.0, 30)
    rates_d = np.deg2rad(2.3) * np.sin(0.57 * times_s[:, None]) * np.array([1.0, 0.1, 0.3])
    for seed in range(300):
        rng = np.random.default_rng([64, seed])
        true_d, offset_s = 10.0 * ARCSEC * rng.standard_normal(3), 0.005 * rng.standard_normal()
        turns_d = true_d + offset_s * rates_d + 3.0 * ARCSEC * rng.standard_normal((30, 3))
        turn_d, covariance_d = rate_corrected_turn(turns_d, rates_d)
        squares.append((turn_d - true_d) @ np.linalg.solve(covariance_d, turn_d - true_d))
    # The covariance is itself estimated, from 29 degrees of freedom: Hotelling's T², a multiple of an F.
    hotelling = f(3, 27, scale=3.0 * 29.0 / 27.0)
    assert abs(np.mean(squares) - hotelling.mean()) < 3.3 * hotelling.std() / np.sqrt(len(squares))


def test_a_ship_at_rest_has_a_mean_and_its_noise():
    turns_d = 3.0 * ARCSEC * np.random.default_rng(5).standard_normal((30, 3))
    turn_d, covariance_d = rate_corrected_turn(turns_d, np.zeros((30, 3)))
    np.testing.assert_array_equal(turn_d, turns_d.mean(axis=0))
    np.testing.assert_allclose(covariance_d, np.cov(turns_d.T) / 30.0, rtol=1e-12)
