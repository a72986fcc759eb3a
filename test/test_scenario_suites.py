"""The suite file written by a simulation fits the nodes: each parameter known, each value that of the scenario."""

import dataclasses
import typing
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.parameter_yaml import PARAMETERS_KEY, in_any_namespace
from ship_estimation.parameters.schema import flatten
from ship_node.parameters.parameter_file import has_section, load_config
from ship_simulation.scenario.scenario import FusedAttitude, StarSensor, WeatherStation
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_yaml
from ship_testing.paper_stars import PAPER_STARS, paper_stars, with_position, with_sensor
from ship_testing.theodolite_scenes import bag_scenario, with_beacons, with_theodolite
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.config import OpticalAxisConfig

SCENARIOS = sorted((Path(__file__).parents[1] / "bags" / "scenarios").glob("*.yaml"))
ADAPTERS = {adapter.node_name: adapter for adapter in (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter)}


@pytest.fixture(name="scenario", params=SCENARIOS, ids=lambda path: path.stem)
def fixture_scenario(request, tmp_path):
    text = request.param.read_text(encoding="utf-8")
    if request.param.stem == "recorded":
        # The recording of this scenario is not in the repository. An empty file takes its place, and is not opened
        # here.
        (tmp_path / "recording.mcap").touch()
        values = yaml.safe_load(text)
        values["carrier"]["recording"]["bag"] = "recording.mcap"
        text = yaml.safe_dump(values)
    path = tmp_path / request.param.name
    path.write_text(text, encoding="utf-8")
    return load_scenario(path)


def configured_nodes(scenario):
    """Return node → (its loaded configuration, the parameters in the file, nested)."""
    text = suite_yaml(scenario)
    sections = yaml.safe_load(text)
    nodes = {section.rpartition("/")[2]: values[PARAMETERS_KEY] for section, values in sections.items()}
    return {
        node: (load_config(ADAPTERS[node].config_type, text, in_any_namespace(node)), values)
        for node, values in nodes.items()
    }


def test_the_nodes_accept_the_suite_file_of_each_scenario(scenario):
    nodes = configured_nodes(scenario)
    assert nodes
    for config, values in nodes.values():
        loaded, written = flatten(config), dict(flatten_names(values))
        assert {name: loaded[name] for name in written} == written


def test_parameters_with_the_name_of_a_scenario_key_are_written(scenario):
    for config, values in configured_nodes(scenario).values():
        for device, written, kind in devices(scenario, config, values):
            missing = {
                name for name in shared_names(device, kind) - written.keys() if has_other_default(name, device, kind)
            }
            assert not missing, (type(device).__name__, kind.__name__, missing)


def has_other_default(name, device, kind):
    """True if a node's default differs from the scenario's value."""
    (field,) = (field for field in dataclasses.fields(kind) if field.name == name)
    return getattr(device, name) != field.default


def flatten_names(values, prefix=""):
    for name, value in values.items():
        if isinstance(value, dict):
            yield from flatten_names(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def devices(scenario, config, values):
    """Yield (device of the scenario, its parameters in the suite file, the node's dataclass), also of nested groups."""
    yield from grouped_parameters(scenario.ins, values["ins"], type(config.ins))
    for key, written in values.get("star_sensors", {}).items():
        yield from grouped_parameters(scenario.star_sensors[key], written, type(config.star_sensors[key]))
    for key, written in values.get("references", {}).items():
        yield from grouped_parameters(scenario.references[key], written, type(config.references[key]))
    for key, written in values.get("beacons", {}).items():
        yield from grouped_parameters(scenario.beacons[key], written, type(config.beacons[key]))
    for key, written in values.get("telescopes", {}).items():
        yield from grouped_parameters(scenario.telescopes[key], written, type(config.telescopes[key]))
    if "telescope" in values:
        yield from grouped_parameters(scenario.theodolite, values, type(config))


def grouped_parameters(device, values, kind):
    yield device, values, kind
    for name, group in typing.get_type_hints(kind).items():
        # A camera belongs to sensors that give single stars, Schuler's sensors to an INS that oscillates, a main
        # detector to a theodolite with targets: only they have these groups.
        belongs = name not in ("camera", "schuler", "main_detector") or name in values
        if dataclasses.is_dataclass(group) and hasattr(device, name) and belongs:
            yield from grouped_parameters(getattr(device, name), values[name], group)


def shared_names(device, kind):
    """Return the names of the plain values that both the device and the dataclass have."""
    values = {field.name for field in dataclasses.fields(device)} & {field.name for field in dataclasses.fields(kind)}
    return {name for name in values if not isinstance(getattr(device, name), dict)} - {
        name for name in values if dataclasses.is_dataclass(getattr(device, name))
    }


def test_the_suite_configuration_of_both_nodes_has_the_scenarios_cameras_and_sigmas():
    scenario = with_sensor(
        paper_stars(weather=WeatherStation(999.0, -5.0, 80.0, 2.0, 3.0, "almanac")),
        camera={"distortion_k1": -0.3},
        magnitude_limit=5.5,
        time_offset_s=0.01,
    )
    scenario = with_position(scenario, sigma_m=3.0, slow_sigma_m=4.0, slow_time_s=500.0)
    suite = suite_yaml(scenario)
    ship = load_config(ShipAttitudeConfig, suite, "ship_attitude")
    stars = load_config(StarAttitudeConfig, suite, "star_attitude")
    assert ship.star_sensors["fore"].input == "observations"
    assert ship.star_sensors["fore"].time_offset_s == 0.01
    for config in (ship, stars):
        fore = config.star_sensors["fore"]
        assert fore.frame_id == "star_fore"
        assert (fore.camera.focal_length_m, fore.camera.distortion_k1) == (0.05, -0.3)
        assert fore.camera.camera("camera") == scenario.star_sensors["fore"].camera.camera("camera")
        assert fore.installation_sigma_forward_arcsec == 20.0
        sky = config.sky
        assert (sky.refraction_model, sky.pressure_hpa, sky.temperature_c) == ("almanac", 999.0, -5.0)
        assert sky.relative_humidity == pytest.approx(0.8)
        assert (sky.measured_pressure_sigma_hpa, sky.measured_temperature_sigma_k) == (2.0, 3.0)
        assert (sky.fix_sigma_m, sky.position_time_s) == (5.0, 500.0)
        assert sky.magnitude_limit == 5.5
        assert config.ins.tilt_sigma_arcsec == 10.0


def test_sensors_that_give_attitudes_have_no_camera_and_no_node_of_their_own():
    inertial = suite_yaml(with_sensor(paper_stars(), output="inertial_attitude", sigma_up_arcsec=4.0))
    config = load_config(ShipAttitudeConfig, inertial, "ship_attitude")
    assert config.star_sensors["fore"].input == "inertial_attitude"
    assert config.star_sensors["fore"].sigma_up_arcsec == 4.0
    assert not config.star_sensors["fore"].camera.is_given
    assert np.isclose(config.sky.pressure_hpa, 1008.3)
    assert "star_attitude:" not in inertial
    horizon = suite_yaml(load_scenario(PAPER_STARS.parent / "paper.yaml"))
    for word in ("sky", "camera", "input", "star_attitude:"):
        assert word not in horizon


def configuration_of(scenario):
    return load_config(OpticalAxisConfig, suite_yaml(scenario), "optical_axis")


def test_the_suite_configuration_agrees_with_the_scenario():
    scenario = with_beacons(bag_scenario(), rtk__bias_sigma_m=0.07, imu__heading_sigma_deg=1.7, light__up_m=-0.4)
    scenario = with_theodolite(
        scenario,
        axes__c_arcsec=12.0,
        encoder__sigma_arcsec=1.5,
        deformation__time_s=700.0,
        telescope__lens__right_m=0.11,
        telescope__rotation_sigma_arcsec=6.0,
        air__light_sigma=0.015,
        ship_antenna__sigma_m=0.012,
    )
    config = configuration_of(scenario)
    np.testing.assert_array_equal(config.axes.values, scenario.theodolite.axes.values)
    np.testing.assert_array_equal(config.axes.sigma, scenario.theodolite.axes.sigma)
    telescope = config.telescope
    np.testing.assert_array_equal(telescope.parallelism, scenario.theodolite.telescope.parallelism)
    np.testing.assert_array_equal(telescope.parallelism_sigma, scenario.theodolite.telescope.parallelism_sigma)
    assert (telescope.lens.right_m, telescope.focal_length_m, telescope.telescope_id) == (0.11, 0.1, "calibration")
    assert (config.lever.vector_m.tolist(), config.lever.sigma_m) == ([12.0, 3.0, -2.0], 0.005)
    assert (config.encoder.sigma_arcsec, config.deformation.time_s, config.air.light_sigma) == (1.5, 700.0, 0.015)
    assert config.ship_antenna.sigma_m == 0.012
    assert set(config.beacons) == {"a", "b"}
    beacon = config.beacons["b"]
    assert (beacon.rtk.bias_sigma_m, beacon.rtk.rover_id, beacon.imu.frame_id) == (0.07, "b", "beacon_b")
    assert (beacon.imu.heading_sigma_deg, beacon.light.up_m) == (1.7, -0.4)
    assert (config.ship.source, config.ship.slow_time_s, config.ins.frame_id) == ("ship/attitude", 600.0, "ins")


def test_the_ship_attitude_comes_from_where_the_bag_has_it():
    scenario = bag_scenario()
    assert not has_section(suite_yaml(scenario), "ship_attitude")
    alone = dataclasses.replace(scenario, fused_attitude=FusedAttitude())
    assert has_section(suite_yaml(alone), "ship_attitude")
    assert configuration_of(alone).ship.source == "ins/imu"
    with_stars = dataclasses.replace(alone, star_sensors={"fore": StarSensor(azimuth_deg=0.0, elevation_deg=45.0)})
    assert configuration_of(with_stars).ship.source == "ship/attitude"
