"""Sightings against the equations of ship_geometry.mount, and the paths of drones and mount."""

import dataclasses

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.mount.image import Camera
from ship_geometry.mount.line_of_sight import BeaconPoses, LeverArm, Ship, Survey, lines_of_sight
from ship_geometry.rotations import ARCSEC, angle_between, exp_rotation, log_rotation
from ship_simulation.run import simulate
from ship_simulation.scenario.theodolite_scenario import Flight, Hover, Orbit, Programme, Waypoint
from ship_simulation.theodolite.devices import points_on_detector
from ship_simulation.theodolite.scene import flight_path
from ship_testing.theodolite_scenes import (
    bag_scenario,
    replace_nested,
    sweep_over_beacons,
    with_beacons,
    with_theodolite,
    without_errors,
)

NONE = np.zeros(3)


def survey_of(scenario):
    config = scenario.theodolite
    lights = [beacon.light.vector_m for _, beacon in sorted(scenario.beacons.items())]
    return Survey(
        theodolite_lever=LeverArm(config.lever.vector_m, NONE),
        principal_point=LeverArm(config.telescope.lens.vector_m, NONE),
        beacon_lever=LeverArm(np.array(lights), NONE),
        rtk_base_sigma_m=NONE,
        rtk_bias_sigma_m=NONE,
        refraction_coefficient=config.air.coefficient,
        refraction_sigma=0.0,
        refraction_beacon_sigma=0.0,
    )


def rows_at(samples, time_ns):
    rows = np.searchsorted(samples.time_ns, time_ns)
    assert np.array_equal(samples.time_ns[rows], time_ns)
    return rows


def test_a_sighting_without_errors_obeys_the_equations():
    scenario = without_errors(bag_scenario(duration_s=39.0))
    run = simulate(scenario, seed=3)
    theodolite, time_ns = run.theodolite, run.theodolite.images.time_ns
    assert set(np.diff(theodolite.images.first)) == {2}
    encoder, fused = theodolite.encoder, run.fused
    at = rows_at(encoder, time_ns)
    errors = AxisErrors.from_vector(scenario.theodolite.axes.values)
    rotation_dm = main_axis_rotation(errors, encoder.azimuth[at], encoder.elevation[at])
    rotation_nd = fused.rotation_nd[rows_at(fused, time_ns)]
    beacons = sorted(scenario.beacons)
    baselines = [theodolite.baselines[key] for key in beacons]
    drones = [theodolite.drones[key] for key in beacons]
    lights = BeaconPoses(
        np.stack([b.baseline_n[rows_at(b, time_ns)] for b in baselines], axis=1),
        np.zeros((3, 3)),
        np.stack([d.rotation_nb[rows_at(d, time_ns)] for d in drones], axis=1),
        np.zeros((3, 3)),
    )
    lines = lines_of_sight(lights, Ship(rotation_nd, np.zeros((3, 3)), rotation_dm), survey_of(scenario))
    telescope = scenario.theodolite.telescope
    camera = Camera(telescope.focal_length_m, 0.0, np.array([telescope.principal_x_m, telescope.principal_z_m]))
    rotation_tm = rotation_from_angles(*telescope.parallelism)
    direction_t = lines.direction_n @ (rotation_nd @ rotation_dm @ rotation_tm.T)
    # The simulated detection noise is 1 nm, 1e-8 rad; the scene's directions below are without noise.
    points = theodolite.images.point_m.reshape(-1, 2, 2)
    assert np.abs(camera.points(direction_t) - points).max() < 6e-9
    scene = theodolite.truth.scene
    t_s = (time_ns - run.start_ns) / SECOND_NS
    assert angle_between(scene.directions_n(t_s, scene.mount(t_s)), lines.direction_n).max() < 1e-9


def test_the_image_is_inverted_and_the_lights_are_at_the_scenario_positions():
    scenario = without_errors(bag_scenario(duration_s=20.0))
    scenario = with_theodolite(
        scenario,
        telescope__azimuth_arcsec=0.0,
        telescope__elevation_arcsec=0.0,
        telescope__rotation_arcsec=0.0,
        telescope__principal_x_m=0.0,
        telescope__principal_z_m=0.0,
        air__coefficient=0.0,
    )
    level = dataclasses.replace(scenario.carrier, pitch=replace_nested(scenario.carrier.pitch, waves={}))
    level = dataclasses.replace(level, roll=replace_nested(level.roll, waves={}))
    run = simulate(dataclasses.replace(scenario, carrier=level), seed=1)
    first = dict(run.theodolite.images.sightings(0))
    # Beacon a is 3° right of and 2° above the axis: both coordinates are -f tan by [W18] (12). Levers of half a metre
    # are 50" here.
    np.testing.assert_allclose(first["a"], -0.1 * np.tan(np.deg2rad([3.0, 2.0])), atol=1e-4)
    np.testing.assert_allclose(first["b"], -0.1 * np.tan(np.deg2rad([-2.0, -3.0])), atol=1e-4)


def test_the_true_pointing_follows_from_the_true_values():
    run = simulate(bag_scenario(duration_s=30.0), seed=2)
    truth = run.theodolite.truth
    mount, constants = truth.mount, truth.scene.theodolite
    rotation_dm = main_axis_rotation(constants.axis_errors, mount.azimuth, mount.elevation)
    expected = mount.rotation_nd @ exp_rotation(mount.deformation_d) @ rotation_dm
    assert np.abs(log_rotation(np.swapaxes(expected, -1, -2) @ mount.rotation_nm)).max() < 1e-12
    turned = np.swapaxes(truth.rotation_nt, -1, -2) @ mount.rotation_nm
    assert np.abs(log_rotation(rotation_from_angles(*constants.parallelism).T @ turned)).max() < 1e-12
    # The mount follows its programme: 1.2°/s, from elevation 10° upwards.
    azimuth = np.arctan2(mount.rotation_nm[:, 2, 0], mount.rotation_nm[:, 0, 0])
    seconds = (run.theodolite.encoder.time_ns[truth.encoder_index] - run.start_ns) / SECOND_NS
    np.testing.assert_allclose(np.rad2deg(azimuth), 1.2 * seconds, atol=1e-9)
    assert mount.rotation_nm[0, 1, 0] == pytest.approx(np.sin(np.deg2rad(10.0)), abs=1e-12)
    # Deformation and axis errors are tens of arcseconds: without them the direction differs.
    plain = mount.rotation_nd @ main_axis_rotation(AxisErrors(), mount.azimuth, mount.elevation)
    off = np.linalg.norm(log_rotation(np.swapaxes(plain, -1, -2) @ mount.rotation_nm), axis=-1) / ARCSEC
    assert 5.0 < off.min() < off.max() < 200.0


@pytest.mark.parametrize("exposure_s", [0.05, 0.5])
def test_a_simulated_point_is_the_mean_of_the_light_s_true_path(exposure_s):
    scenario = sweep_over_beacons(exposure_s)
    telescope, run = scenario.theodolite.telescope, simulate(scenario, seed=3)
    images, scene = run.theodolite.images, run.theodolite.truth.scene
    assert set(np.diff(images.first)) == {2}
    middle_s = (images.time_ns - run.start_ns) / SECOND_NS
    since_s = exposure_s * ((np.arange(400) + 0.5) / 400 - 0.5)
    way = [points_on_detector(telescope, scene, middle_s + t, scene.mount(middle_s + t)) for t in since_s]
    mean_m = np.mean(way, axis=0)
    # The image noise is 1 nm, a hundred times as much along the streaks.
    np.testing.assert_allclose(images.point_m.reshape(mean_m.shape), mean_m, atol=2e-6 * exposure_s)
    assert np.linalg.norm(way[-1] - way[0], axis=-1).min() > 1.5e-3 * exposure_s


def test_hover_orbit_and_legs_go_where_they_should():
    t_s = np.array([0.0, 10.0, 100.0])
    hover = Flight(hover=Hover(azimuth_deg=90.0, elevation_deg=30.0, distance_m=1000.0, north_m_per_s=2.0))
    east, up = 1000.0 * np.cos(np.pi / 6.0), 500.0
    expected = [[0.0, up, east], [20.0, up, east], [200.0, up, east]]
    np.testing.assert_allclose(flight_path(hover, Programme())(t_s), expected, atol=1e-9)
    orbit = Flight(kind="orbit", orbit=Orbit(elevation_deg=0.0, distance_m=500.0, rate_deg_per_s=9.0))
    expected = [[500.0, 0.0, 0.0], [0.0, 0.0, 500.0], [-500.0, 0.0, 0.0]]
    np.testing.assert_allclose(flight_path(orbit, Programme())(np.array([0.0, 10.0, 20.0])), expected, atol=1e-9)
    ends = {"z": Waypoint(20.0, 0.0, 0.0, 1000.0), "y": Waypoint(30.0, 90.0, 0.0, 1000.0)}
    legs = flight_path(Flight(kind="legs", waypoints=ends | {"x": Waypoint(50.0, 90.0, 0.0, 500.0)}), Programme())
    places = legs(np.array([0.0, 20.0, 25.0, 30.0, 40.0, 50.0, 99.0]))
    expected = [[1000, 0, 0], [1000, 0, 0], [500, 0, 500], [0, 0, 1000], [0, 0, 750], [0, 0, 500], [0, 0, 500]]
    np.testing.assert_allclose(places, np.array(expected, dtype=float), atol=1e-9)
    # Straight, with a stop where the legs meet.
    line = legs(np.linspace(20.0, 30.0, 11))
    np.testing.assert_allclose(line[:, 0] + line[:, 2], 1000.0, atol=1e-9)
    assert np.abs(np.diff(legs(np.array([29.99, 30.0, 30.01])), axis=0)).max() < 1e-4


def test_the_mount_follows_the_lights_and_then_sweeps_on_from_there():
    scenario = with_theodolite(bag_scenario(duration_s=120.0), programme__follows_lights=True)
    offsets = {"a": (340.0, 41.0), "b": (337.0, 38.0)}
    beacons = {
        key: replace_nested(
            scenario.beacons[key],
            flight=Flight(kind="orbit", orbit=Orbit(azimuth, elevation, 2000.0, 0.5)),
            leaves_s=40.0 if key == "a" else 60.0,
            hidden={},
        )
        for key, (azimuth, elevation) in offsets.items()
    }
    run = simulate(dataclasses.replace(scenario, beacons=beacons), seed=1)
    theodolite = run.theodolite
    seconds = (theodolite.images.time_ns - run.start_ns) / SECOND_NS
    expected = np.where(seconds < 40.0, 2, np.where(seconds < 60.0, 1, 0))
    np.testing.assert_array_equal(np.diff(theodolite.images.first), expected)
    axis_n = theodolite.truth.mount.rotation_nm[:, :, 0]
    # The axis is never faster than the sweep of 1.2°/s plus the transition to its elevation: no jump in 0.1 s.
    steps_deg = np.rad2deg(angle_between(axis_n[1:-1], axis_n[:-2]))
    assert steps_deg.max() < 1.0
    at_s = 0.1 * np.arange(len(axis_n))
    azimuth_deg = np.rad2deg(np.unwrap(np.arctan2(axis_n[:, 2], axis_n[:, 0])))
    # After a ramp of 20 s, the mount has the rate and the elevation of the programme.
    late = at_s > 80.0
    np.testing.assert_allclose(np.diff(azimuth_deg[late])[:-1], 0.12, atol=1e-9)
    programme_deg = 40.0 - 30.0 * np.cos(2.0 * np.pi * at_s[late] / 110.0)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(axis_n[late, 1])), programme_deg, atol=1e-9)


def test_a_light_off_the_detector_is_not_seen():
    scenario = with_theodolite(bag_scenario(duration_s=5.0), telescope__width_m=0.001, telescope__height_m=0.001)
    images = simulate(scenario, seed=1).theodolite.images
    assert images.point_m.shape == (0, 2)
    behind = with_beacons(
        bag_scenario(duration_s=5.0), flight=Flight(hover=Hover(azimuth_deg=180.0, elevation_deg=-10.0))
    )
    assert simulate(behind, seed=1).theodolite.images.point_m.shape == (0, 2)


def test_a_line_along_the_vertical_axis_is_refused():
    # A pitch of 5° bow up at heading 0° puts the deck's vertical axis at azimuth 180° and elevation 85°.
    scenario = with_theodolite(
        bag_scenario(),
        programme__least_elevation_deg=85.0,
        programme__greatest_elevation_deg=85.0,
        programme__azimuth_deg=180.0,
        programme__azimuth_rate_deg_per_s=0.0,
        axes__c_arcsec=3600.0,
    )
    still = {
        angle: replace_nested(getattr(scenario.carrier, angle), mean_deg=mean_deg, waves={})
        for angle, mean_deg in (("heading", 0.0), ("pitch", 5.0), ("roll", 0.0))
    }
    with pytest.raises(BadInput, match=r"at 0.00 s the theodolite would point along its vertical axis"):
        simulate(dataclasses.replace(scenario, carrier=replace_nested(scenario.carrier, **still)), seed=1)
