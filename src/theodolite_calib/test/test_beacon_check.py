"""Beacons with exchanged names, or at wrong positions."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation
from ship_testing.simulated_sightings import (
    BEACONS_DEG,
    CAMERA,
    FOUR_BEACONS_DEG,
    Epochs,
    error_free_epochs,
    paper_epochs,
    truth_of,
)
from theodolite_calib.filter.sighting_gate import BeaconCheck, BeaconCheckResult, angle_residuals, check_beacons
from theodolite_calib.filter.telescope_attitude import AttitudePrior, solve_attitude

PROBABILITY = 0.999
THREE_LIGHTS_DEG = FOUR_BEACONS_DEG[:3]


def an_epoch(lights_deg: FloatArray = BEACONS_DEG, seed: int = 2) -> Epochs:
    """Return one of the paper's epochs."""
    many = paper_epochs(truth_of(np.array([75.0]), 35.0, 15.0, lights_deg), seed=seed)
    return replace(
        many,
        truth=replace(many.truth, rotation_nt=many.truth.rotation_nt[0], direction_n=many.truth.direction_n[0]),
        image=replace(many.image, point_m=many.image.point_m[0], sigma_m=many.image.sigma_m[0]),
        beacons=replace(
            many.beacons,
            baseline_n=many.beacons.baseline_n[0],
            baseline_covariance_n=many.beacons.baseline_covariance_n[0],
            rotation_nb=many.beacons.rotation_nb[0],
        ),
        ship=replace(many.ship, rotation_nd=many.ship.rotation_nd[0], rotation_dm=many.ship.rotation_dm[0]),
        survey=replace(many.survey, refraction_beacon_sigma=many.survey.refraction_beacon_sigma[0]),
    )


def with_order(epoch: Epochs, order: list[int]) -> Epochs:
    """Return the epoch with sighting i of beacon ``order[i]``."""
    return replace(epoch, image=replace(epoch.image, point_m=epoch.image.point_m[order]))


def encoder_prior(epoch: Epochs, offset_arcmin: float = 1.0) -> AttitudePrior:
    """Return a prior as from encoder and INS: sigma 1′ per axis, with an error of ``offset_arcmin``."""
    off = np.array([0.6, -0.6, 0.5]) * offset_arcmin * 60.0 * ARCSEC
    return AttitudePrior(exp_rotation(off) @ epoch.truth.rotation_nt, {"prior": (60.0 * ARCSEC) ** 2 * np.eye(3)})


def check_epoch(epoch: Epochs, prior: AttitudePrior | None = None) -> BeaconCheck:
    return check_beacons(epoch.image, epoch.camera, epoch.lines(), PROBABILITY, prior)


def axis_error_arcsec(epoch: Epochs, check: BeaconCheck) -> float:
    return float(angle_between(epoch.truth.rotation_nt[:, 0], check.attitude.rotation_nt[:, 0]) / ARCSEC)


@pytest.mark.parametrize("lights_deg", [BEACONS_DEG, THREE_LIGHTS_DEG], ids=["two", "three"])
@pytest.mark.parametrize("with_prior", [False, True])
def test_right_beacons(lights_deg, with_prior):
    epoch = an_epoch(lights_deg)
    check = check_epoch(epoch, encoder_prior(epoch) if with_prior else None)
    assert check.result is BeaconCheckResult.CONSISTENT
    assert check.order == tuple(range(len(lights_deg)))
    assert axis_error_arcsec(epoch, check) < 15.0
    assert (check.prior_chi2 is not None) == with_prior


def test_two_swapped_beacons_are_found_with_a_prior():
    epoch = an_epoch()
    check = check_epoch(with_order(epoch, [1, 0]), encoder_prior(epoch))
    assert check.result is BeaconCheckResult.SWAPPED
    assert check.order == (1, 0)
    assert axis_error_arcsec(epoch, check) < 15.0


def test_two_swapped_beacons_are_consistent_without_a_prior():
    # The angle between the beacons is the same: the attitude is only rotated by half a turn.
    epoch = an_epoch()
    check = check_epoch(with_order(epoch, [1, 0]))
    assert check.result is BeaconCheckResult.CONSISTENT
    turned = check.attitude.rotation_nt.T @ epoch.truth.rotation_nt
    assert np.rad2deg(np.arccos(0.5 * (np.trace(turned) - 1.0))) == pytest.approx(180.0, abs=2.0)


@pytest.mark.parametrize("order", [[1, 0, 2], [2, 1, 0], [0, 2, 1], [1, 2, 0], [2, 0, 1]])
def test_three_swapped_beacons_need_no_prior(order):
    epoch = an_epoch(THREE_LIGHTS_DEG)
    check = check_epoch(with_order(epoch, order))
    assert check.result is BeaconCheckResult.SWAPPED
    # Sighting check.order[i] is light i.
    assert [order[i] for i in check.order] == [0, 1, 2]
    assert axis_error_arcsec(epoch, check) < 15.0


@pytest.mark.parametrize("with_prior", [False, True])
@pytest.mark.parametrize("lights_deg", [BEACONS_DEG, THREE_LIGHTS_DEG], ids=["two", "three"])
def test_wrong_beacon(lights_deg, with_prior):
    # Instead of the second beacon another one 0.05° away is detected.
    epoch = an_epoch(lights_deg)
    elsewhere_deg = lights_deg.copy()
    elsewhere_deg[1, 0] += 0.05
    other = an_epoch(elsewhere_deg)
    check = check_epoch(replace(epoch, image=other.image), encoder_prior(epoch) if with_prior else None)
    assert check.result is BeaconCheckResult.CONFLICT


def test_a_baseline_a_second_late():
    # The drone moves at 2 m/s across the line of sight.
    epoch = an_epoch()
    across = np.cross(epoch.truth.direction_n[1], epoch.truth.direction_n[0])
    late = np.cross(across / np.linalg.norm(across), epoch.truth.direction_n[1]) * 2.0
    lights = replace(epoch.beacons, baseline_n=epoch.beacons.baseline_n + np.stack([np.zeros(3), late]))
    assert check_epoch(replace(epoch, beacons=lights)).result is BeaconCheckResult.CONFLICT


def test_consistent_beacons_with_an_inconsistent_prior():
    # An encoder was stuck while the telescope moved on by half a degree.
    epoch = an_epoch()
    check = check_epoch(epoch, encoder_prior(epoch, offset_arcmin=30.0))
    assert check.result is BeaconCheckResult.PRIOR_CONFLICT
    assert check.order == (0, 1)
    assert axis_error_arcsec(epoch, check) < 15.0


def test_a_little_better_the_other_way_round_is_no_swap():
    # Three lights are in a row, the middle one 2" from half way: within errors of 4", the reversed order fits as well.
    # If the image of the middle light is shifted, the named order fails a little before the reversed order.
    along = np.array([3.0, 2.0]) / np.hypot(3.0, 2.0)
    row_deg = np.stack([3.0 * along, 5e-4 * along, -3.0 * along])
    exact = error_free_epochs(truth_of(75.0, 35.0, 15.0, row_deg))
    lights = replace(exact.beacons, baseline_covariance_n=0.027**2 * np.eye(3))
    epoch = replace(exact, beacons=lights)
    results = {
        check_epoch(replace(epoch, image=replace(epoch.image, point_m=point_m))).result
        for shift_m in np.arange(-12e-6, 12e-6, 1e-6)
        for point_m in [epoch.image.point_m + np.outer([0.0, 1.0, 0.0], shift_m * along)]
    }
    assert results == {BeaconCheckResult.CONSISTENT, BeaconCheckResult.CONFLICT}


def test_beacons_in_one_direction_give_no_attitude():
    epoch = an_epoch()
    one_place = replace(epoch, image=replace(epoch.image, point_m=epoch.image.point_m[[0, 0]]))
    check = check_epoch(one_place)
    assert check.result is BeaconCheckResult.CONFLICT


def test_angle_residual_is_what_the_likelihood_leaves():
    epochs = paper_epochs(truth_of(np.full(2_000, 75.0), 35.0, 15.0), seed=4)
    angles = angle_residuals(epochs.image, epochs.camera, epochs.lines())
    assert angles.pairs.tolist() == [[0, 1]]
    # By the paper's numbers: 2.7 cm at 2 km for each beacon, 0.1 % of the angle of 7°, and smaller errors.
    assert angles.sigma.mean() / ARCSEC == pytest.approx(26.0, abs=0.5)
    low, high = mean_nees_band(2_000, 1)
    assert low < angles.chi2.mean() < high
    attitude = solve_attitude(epochs.image, epochs.camera, epochs.lines())
    # Both are equal to first order: three sigma of the focal length are 0.3 % of the angle and 0.6 % of chi².
    assert angles.chi2[:, 0] == pytest.approx(attitude.chi2, rel=1e-2, abs=5e-3)


def test_angles_of_three_beacons():
    epochs = paper_epochs(truth_of(np.full(2_000, 75.0), 35.0, 15.0, THREE_LIGHTS_DEG), seed=4, common_refraction=True)
    angles = angle_residuals(epochs.image, epochs.camera, epochs.lines())
    assert angles.pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    low, high = mean_nees_band(2_000, 1)
    assert np.all((angles.chi2.mean(axis=0) > low) & (angles.chi2.mean(axis=0) < high))
    exact = error_free_epochs(truth_of(75.0, 35.0, 15.0, THREE_LIGHTS_DEG))
    assert np.abs(angle_residuals(exact.image, CAMERA, exact.lines()).residual).max() < 1e-8
