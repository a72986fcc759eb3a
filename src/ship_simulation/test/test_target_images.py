"""Targets in the main tube: images against formulas of this file, their noise, and their truth."""

import dataclasses

import numpy as np

from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import ns_from_stamp
from ship_geometry.frames import ENU_FROM_HORIZON, rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.theodolite.devices import _true_detector
from ship_testing.consistency import sigma_ratio_band
from ship_testing.theodolite_scenes import SCENARIOS, replace_nested, with_theodolite, without_errors

IMAGE, TRUTH, POINTING = "theodolite/target", "truth/target_direction", "truth/pointing"
FOCAL_LENGTH_M, EARTH_RADIUS_M = 1.5, 6_371_000.0


def short_run(duration_s=6.0, detector=None, **target):
    """Return the night scenario without beacons and star cameras, with changed fields of its detector and target."""
    scenario = load_scenario(SCENARIOS / "theodolite_night.yaml")
    changes = {f"main_detector__{name}": value for name, value in (detector or {}).items()}
    balloon = replace_nested(scenario.targets["balloon"], **target)
    scenario = dataclasses.replace(
        scenario, duration_s=duration_s, beacons={}, telescopes={}, targets={"balloon": balloon}
    )
    return with_theodolite(scenario, **changes)


def exact(**target):
    """Return the scenario without errors, with images at the stamps of ``truth/pointing``."""
    detector = {"sigma_m": 1e-9, "focal_length_sigma_m": 0.0, "rotation_sigma_arcsec": 0.0, "exposure_s": 0.0}
    return without_errors(short_run(detector=detector, **target))


def target_messages(run):
    """Return topic → its messages."""
    found = {}
    for topic, message, _ in generate_messages([run], RosbagsFactory()):
        found.setdefault(topic, []).append(message)
    return found


def by_stamp(found):
    return {ns_from_stamp(message.header.stamp): message for message in found}


def direction_n(image, pointing, focal_length_m=FOCAL_LENGTH_M, principal_x_m=1e-4):
    """Return the direction (N, U, E) of an inverted image; the detector rotation is positive right side down."""
    rho = image.detector_rotation
    right_v, up_v = -(image.x - principal_x_m) / focal_length_m, -image.z / focal_length_m
    up, right = up_v * np.cos(rho) - right_v * np.sin(rho), right_v * np.cos(rho) + up_v * np.sin(rho)
    angles = pointing.azimuth, pointing.elevation, pointing.image_rotation
    seen_n = rotation_from_angles(*angles) @ [1.0, up, right]
    return seen_n / np.linalg.norm(seen_n)


def of_vector(vector):
    return ENU_FROM_HORIZON.T @ [vector.x, vector.y, vector.z]


def test_images_show_the_direction_of_the_truth():
    found = target_messages(simulate(exact(), seed=1))
    pointings, truths = by_stamp(found[POINTING]), by_stamp(found[TRUTH])
    assert len(found[IMAGE]) == len(truths) == 61
    rotations = set()
    for image in found[IMAGE]:
        stamp_ns = ns_from_stamp(image.header.stamp)
        truth = truths[stamp_ns]
        true_n = of_vector(truth.direction)
        # Six times the noise of 1 nm at the focal length of 1.5 m.
        np.testing.assert_allclose(direction_n(image, pointings[stamp_ns]), true_n, atol=4e-9)
        np.testing.assert_allclose(
            [truth.azimuth, truth.elevation],
            [np.arctan2(true_n[2], true_n[0]) % (2.0 * np.pi), np.arcsin(true_n[1])],
            atol=1e-12,
        )
        rotations.add(round(image.detector_rotation, 3))
        assert (image.target_id, image.header.frame_id, truth.target_id) == ("balloon", "main_detector", "balloon")
    assert len(rotations) == 61


def test_the_true_position_is_along_the_direction_without_refraction_at_the_true_range():
    run = simulate(exact(), seed=1)
    samples, scene = run.theodolite.targets, run.theodolite.truth.scene
    t_s = (samples.time_ns - run.start_ns) * 1e-9
    paths_n = samples.position_n - scene.carrier.attitude(t_s) @ scene.theodolite.lever_d
    distance_m = np.linalg.norm(paths_n, axis=-1)
    np.testing.assert_allclose(distance_m, 3000.0, rtol=1e-12)
    horizontal_m = np.hypot(paths_n[:, 0], paths_n[:, 2])
    seen_n = samples.direction_n
    raised = np.arcsin(seen_n[:, 1]) - np.arctan2(paths_n[:, 1], horizontal_m)
    np.testing.assert_allclose(raised, 0.13 * horizontal_m / (2.0 * EARTH_RADIUS_M), rtol=1e-6)


def test_points_and_ranges_have_white_noise_of_their_sigmas():
    scenario = short_run(duration_s=40.0, detector={"rate_hz": 25.0, "exposure_s": 0.0}, hidden={})
    quiet = with_theodolite(scenario, main_detector__sigma_m=1e-9)
    noisy, clean = simulate(scenario, seed=1).theodolite.targets, simulate(quiet, seed=1).theodolite.targets
    low, high = sigma_ratio_band(noisy.point_m.size, 0.999)
    assert low < np.sqrt(np.mean((noisy.point_m - clean.point_m) ** 2)) / 3e-6 < high
    low, high = sigma_ratio_band(noisy.range_m.size, 0.999)
    assert low < np.sqrt(np.mean((noisy.range_m - 3000.0) ** 2)) / 2.0 < high


def test_a_target_without_a_range_has_none_and_a_hidden_one_no_image():
    scenario = short_run(range_sigma_m=0.0, hidden={"x": Outage(1.0, 2.0)}, leaves_s=4.0)
    found = target_messages(simulate(scenario, seed=1))
    assert len(found[IMAGE]) == len(found[TRUTH]) == 30
    assert all(np.isnan([image.range, image.range_sigma]).all() for image in found[IMAGE])
    assert not any(np.isnan([truth.position.x, truth.position.y, truth.position.z]).any() for truth in found[TRUTH])


def test_a_target_off_the_detector_has_no_image():
    run = simulate(short_run(course__escort__right_deg=0.6), seed=1)
    assert run.theodolite.targets.time_ns.size == 0
    assert IMAGE not in target_messages(run)


def test_an_exposure_shows_the_mean_of_the_path():
    # The expected points are means over two exposures while the mount sweeps: 1001 times each, by the trapezoidal rule.
    turning = {"exposure_s": 1.0, "rotation_rate_deg_per_s": 0.0, "rate_hz": 1.0, "phase_s": 2.0, "sigma_m": 1e-9}
    turning |= {"focal_length_sigma_m": 0.0, "rotation_sigma_arcsec": 0.0, "width_m": 0.2, "height_m": 0.2}
    hanging = {"course__kind": "hover", "course__hover__azimuth_deg": 61.0, "course__hover__elevation_deg": 36.0}
    scenario = short_run(detector=turning, **hanging)
    samples = simulate(scenario, seed=1).theodolite.targets
    points = short_run(
        detector={**turning, "exposure_s": 0.0, "rate_hz": 1000.0, "phase_s": 1.5}, duration_s=4.0, **hanging
    )
    way_m = simulate(points, seed=1).theodolite.targets.point_m[:2001]
    weight = np.r_[0.5, np.ones(999), 0.5] / 1000.0
    np.testing.assert_allclose(samples.point_m[:2], [weight @ way_m[:1001], weight @ way_m[1000:2001]], atol=3e-8)
    assert np.linalg.norm(way_m[0] - way_m[1000]) > 1e-3


def test_the_detector_is_drawn_about_what_is_known():
    detector = {"focal_length_sigma_m": 1e-3, "principal_sigma_m": 1e-5, "rotation_sigma_arcsec": 7.0}
    config = short_run(detector=detector).theodolite.main_detector
    drawn = [_true_detector(config, seed) for seed in range(400)]
    low, high = sigma_ratio_band(400, 0.999)
    errors = [
        [(camera.focal_length_m - 1.5) / 1e-3 for camera, _ in drawn],
        [(camera.principal_point_m[0] - 1e-4) / 1e-5 for camera, _ in drawn],
        [camera.principal_point_m[1] / 1e-5 for camera, _ in drawn],
        [rotation / (7.0 * ARCSEC) for _, rotation in drawn],
    ]
    for each in errors:
        assert low < np.sqrt(np.mean(np.square(each))) < high
