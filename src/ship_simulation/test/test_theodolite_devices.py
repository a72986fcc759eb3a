"""Errors drawn by a run with a theodolite: size, common parts, and independence."""

import dataclasses

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, log_rotation, wrap_pi
from ship_simulation.random_draws import CorrelatedError, random_stream
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.theodolite.devices import FIXED, FLOAT, NONE, points_on_detector
from ship_simulation.theodolite.scene import draw_theodolite
from ship_testing.consistency import sigma_ratio_band
from ship_testing.theodolite_scenes import bag_scenario, replace_nested, with_beacons, with_theodolite

SEEDS = 400


def assert_sigma(values, sigma, probability=0.999):
    """Check that the RMS of independent values matches a sigma, within the chi² band."""
    low, high = sigma_ratio_band(np.size(values), probability)
    assert low < np.sqrt(np.mean(np.square(values))) / sigma < high


def since_start_s(run, samples):
    return (samples.time_ns - run.start_ns) / SECOND_NS


def baseline_errors(run, beacon_id):
    samples, scene = run.theodolite.baselines[beacon_id], run.theodolite.truth.scene
    t_s = since_start_s(run, samples)
    true_n = scene.beacons[beacon_id].path(t_s) + scene.carrier.attitude(t_s) @ scene.theodolite.lever_d
    return samples.baseline_n - true_n


def test_constants_are_drawn_with_their_sigmas():
    scenario = with_theodolite(bag_scenario(), axes__spread="normal")
    config = scenario.theodolite
    drawn = [draw_theodolite(config, seed) for seed in range(SEEDS)]
    axes, axes_sigma = config.axes.values, config.axes.sigma
    for column, sigma in enumerate(axes_sigma):
        assert_sigma([true.axis_errors.vector()[column] - axes[column] for true in drawn], sigma)
    telescope = config.telescope
    angles = [(true.parallelism - telescope.parallelism) / telescope.parallelism_sigma for true in drawn]
    assert_sigma(angles, 1.0)
    assert_sigma([true.focal_length_m - 0.1 for true in drawn], 1e-4)
    assert_sigma([true.lever_d - config.lever.vector_m for true in drawn], 0.005)
    assert_sigma([true.lens_m - telescope.lens.vector_m for true in drawn], 0.002)


def test_uniform_axis_errors_fill_their_range_and_no_more():
    config = with_theodolite(bag_scenario(), axes__g_arcsec=100.0).theodolite
    drawn = np.array([draw_theodolite(config, seed).axis_errors.vector() for seed in range(SEEDS)]) / ARCSEC
    half_width = np.array([40.0, 40.0, 30.0, 30.0, 20.0, 20.0, 10.0])
    drawn[:, 0] -= 100.0
    assert np.all(np.abs(drawn) < half_width * 1.0001)
    assert np.all(np.abs(drawn).max(axis=0) > 0.97 * half_width)
    for column, width in enumerate(half_width):
        assert_sigma(drawn[:, column], width / np.sqrt(3.0))


def test_correlated_errors_are_gauss_markov_at_any_time():
    # Values twenty correlation times apart are independent; these times lie between grid points.
    times_s = 10.0 * np.arange(2000) + 0.005
    process = CorrelatedError(random_stream(1, "test"), times_s[-1] + 1.0, np.array([3.0]), 0.5)
    first, later = process.values_at(times_s)[:, 0], process.values_at(times_s + 0.15)[:, 0]
    assert_sigma(first, 3.0)
    # The correlation is exp(-0.15/0.5), within 3.3 standard deviations for 2000 pairs.
    assert np.corrcoef(first, later)[0, 1] == pytest.approx(np.exp(-0.3), abs=3.3 * (1 - np.exp(-0.6)) / np.sqrt(2000))


def test_encoders_and_images_have_white_noise_of_their_sigmas():
    scenario = with_theodolite(bag_scenario(duration_s=60.0), telescope__rate_hz=20.0, encoder__sigma_arcsec=2.0)
    run = simulate(dataclasses.replace(scenario, beacons={"b": scenario.beacons["b"]}), seed=1)
    encoder, images, scene = run.theodolite.encoder, run.theodolite.images, run.theodolite.truth.scene
    mount = scene.mount(since_start_s(run, encoder))
    for noise in (wrap_pi(encoder.azimuth - mount.azimuth), encoder.elevation - mount.elevation):
        assert_sigma(noise, 2.0 * ARCSEC)
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 3.3 / np.sqrt(noise.size)
    assert np.all((encoder.azimuth >= 0.0) & (encoder.azimuth < 2.0 * np.pi))
    t_s = since_start_s(run, images)
    true_m = points_on_detector(scenario.theodolite.telescope, scene, t_s, scene.mount(t_s))[:, 0]
    assert images.point_m.shape == true_m.shape
    assert_sigma(images.point_m - true_m, 6.5e-7)


def test_deformation_and_refraction_have_their_sigmas_over_runs():
    scenario = with_theodolite(bag_scenario(duration_s=1.0), air__light_sigma=0.03)
    scenes = [simulate(scenario, seed).theodolite.truth.scene for seed in range(60)]
    times_s = np.array([0.7])
    assert_sigma([scene.deformation.values_at(times_s) for scene in scenes], 20.0 * ARCSEC)
    assert_sigma([scene.refraction.values_at(times_s) for scene in scenes], 0.06)
    own = np.array(
        [[light.refraction.values_at(times_s)[0, 0] for light in scene.beacons.values()] for scene in scenes]
    )
    assert_sigma(own, 0.03)
    assert abs(np.corrcoef(own.T)[0, 1]) < 3.3 / np.sqrt(60)


def test_baselines_have_noise_a_bias_of_their_own_and_the_ship_antenna_in_common():
    scenario = with_theodolite(bag_scenario(duration_s=1.0), ship_antenna__sigma_m=0.05)
    scenario = with_beacons(scenario, rtk__bias_sigma_m=0.03)
    errors = []
    for seed in range(SEEDS // 4):
        run = simulate(scenario, seed)
        errors.append([baseline_errors(run, key) for key in ("a", "b")])
    # (seed, beacon, epoch, axis)
    errors = np.array(errors)
    steps = np.diff(errors, axis=2)
    assert steps.std() == pytest.approx(np.sqrt(2.0) * 0.02, rel=0.05)
    mean = errors.mean(axis=2)
    # The mean of eleven epochs has 0.3 times the sigma of the noise.
    own = np.hypot(0.03, 0.02 / np.sqrt(11.0))
    assert_sigma((mean[:, 0] - mean[:, 1]) / np.sqrt(2.0), own)
    assert_sigma(mean[:, 0], np.hypot(0.05, own))
    correlation = np.corrcoef(mean[:, 0].ravel(), mean[:, 1].ravel())[0, 1]
    assert correlation == pytest.approx(0.05**2 / (0.05**2 + own**2), abs=3.3 * 0.6 / np.sqrt(mean[:, 0].size))


def test_baselines_have_fix_float_and_none_and_stop():
    windows = {
        "rtk__float_times": {"x": Outage(1.0, 3.0)},
        "rtk__no_solution_times": {"y": Outage(4.0, 5.0)},
        "rtk__outages": {"z": Outage(6.0, 7.0)},
        "leaves_s": 9.0,
    }
    scenario = bag_scenario()
    scenario = dataclasses.replace(scenario, beacons={"a": replace_nested(scenario.beacons["a"], **windows)})
    run = simulate(scenario, seed=1)
    samples = run.theodolite.baselines["a"]
    t_s = since_start_s(run, samples)
    expected = np.where((t_s >= 1.0) & (t_s < 3.0), FLOAT, np.where((t_s >= 4.0) & (t_s < 5.0), NONE, FIXED))
    np.testing.assert_array_equal(samples.fix, expected)
    assert not np.any((t_s >= 6.0) & (t_s < 7.0))
    assert t_s.max() == pytest.approx(8.9)
    assert len(samples.time_ns) == 90 - 10
    assert np.all(np.isnan(samples.baseline_n[samples.fix == NONE]))
    assert np.all(np.isnan(samples.covariance_n[samples.fix == NONE]))
    sigma = np.sqrt(samples.covariance_n[:, 0, 0])
    np.testing.assert_allclose(sigma[samples.fix == FLOAT], np.hypot(0.3, 0.02))
    np.testing.assert_allclose(sigma[samples.fix == FIXED], 0.02)
    # Over seeds the errors match the stated sigmas.
    means = [baseline_errors(simulate(scenario, seed), "a")[expected == FLOAT].mean(axis=0) for seed in range(60)]
    assert np.std(means) == pytest.approx(0.3, rel=0.25)
    assert np.abs(baseline_errors(run, "a")[expected == FIXED]).max() < 0.15


def test_errors_of_drone_and_ship_attitudes_match_their_covariances():
    scenario = with_beacons(bag_scenario(duration_s=1.0), leaves_s=0.8)
    nees = []
    for seed in range(100):
        run = simulate(scenario, seed)
        drone, light = run.theodolite.drones["a"], run.theodolite.truth.scene.beacons["a"]
        assert since_start_s(run, drone).max() < 0.8
        true_nb = light.attitude.attitude(since_start_s(run, drone))
        true_nd = run.theodolite.truth.scene.carrier.attitude(since_start_s(run, run.fused))
        of_drone = log_rotation(true_nb[3] @ drone.rotation_nb[3].T)
        of_ship = log_rotation(true_nd[3] @ run.fused.rotation_nd[3].T)
        nees.append(
            [
                normalized_error_squared(of_drone, drone.covariance_n),
                normalized_error_squared(of_ship, run.fused.covariance_n),
            ]
        )
    low, high = mean_nees_band(100, degrees=3)
    of_drones, of_ships = np.mean(nees, axis=0)
    assert low < of_drones < high
    assert low < of_ships < high


def test_the_same_seed_gives_the_same_run_and_a_further_drone_changes_no_other():
    scenario = bag_scenario(duration_s=3.0)
    first, again, other = simulate(scenario, 1), simulate(scenario, 1), simulate(scenario, 2)
    more = simulate(dataclasses.replace(scenario, beacons=scenario.beacons | {"c": scenario.beacons["a"]}), 1)
    for values in (
        lambda run: run.theodolite.encoder.azimuth,
        lambda run: run.theodolite.baselines["b"].baseline_n,
        lambda run: run.theodolite.drones["a"].rotation_nb,
        lambda run: run.fused.rotation_nd,
        lambda run: run.ins.rotation_nd,
    ):
        np.testing.assert_array_equal(values(first), values(again))
        np.testing.assert_array_equal(values(first), values(more))
        assert not np.array_equal(values(first), values(other))
    np.testing.assert_array_equal(first.theodolite.images.point_m, again.theodolite.images.point_m)
    assert set(np.diff(more.theodolite.images.first)) == {3}


def test_arrivals_for_the_pointing_come_in_order_with_latency():
    run = simulate(bag_scenario(duration_s=2.0), seed=1)
    arrivals = run.pointing_arrivals()
    assert [log for log, _, _ in arrivals] == sorted(log for log, _, _ in arrivals)
    counts = {source: sum(name == source for _, name, _ in arrivals) for _, source, _ in arrivals}
    expected = {"ins": 41, "fused": 41, "encoder": 101, "image": 8}
    expected |= {"drone.a": 21, "drone.b": 21, "baseline.a": 21, "baseline.b": 21}
    assert counts == expected
    images = run.theodolite.images
    assert set(images.log_time_ns - images.time_ns) == {SECOND_NS // 20}
