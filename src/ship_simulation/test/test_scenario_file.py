"""Scenario files with real stars: what is refused, and the suite configuration that fits them."""

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.errors import BadInput
from ship_node.parameters.parameter_file import load_config
from ship_simulation.scenario.scenario import WeatherStation
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite.suite import suite_yaml
from ship_testing.paper_stars import PAPER_STARS, paper_stars, with_position, with_sensor

TEXT = PAPER_STARS.read_text(encoding="utf-8")

BROKEN = {
    "no focal length": (
        "focal_length_m: 0.05",
        "focal_length_m: 0.0",
        "'star_sensors.fore.camera.focal_length_m' and 'star_sensors.fore.camera.pixel_pitch_m' must be given",
    ),
    "no size": (
        "      width_px: 2048\n",
        "",
        "'star_sensors.fore.camera.width_px' and 'star_sensors.fore.camera.height_px' must be given",
    ),
    "output": ("output: observations", "output: pictures", "'star_sensors.fore.output' = 'pictures' must be one of"),
    "camera for nothing": (
        "output: observations",
        "output: inertial_attitude",
        "'star_sensors.fore.camera' is not used with output inertial_attitude: it belongs to observations",
    ),
    "noise of an attitude": (
        "    magnitude_limit: 6.0",
        "    sigma_up_arcsec: 3.0",
        "'star_sensors.fore.sigma_up_arcsec' is not used with output observations: it belongs to",
    ),
    "direction of nobody": (
        "    magnitude_limit: 6.0",
        "    identified: false\n    direction_given: true",
        "'star_sensors.fore.direction_given' needs identified stars",
    ),
    "no Earth orientation": (
        "2014-07-09T11:50:07.8Z",
        "2090-07-09T11:50:07.8Z",
        "'start_utc' = 2090-07-09T11:50:07.8Z cannot be given a sky: no Earth orientation for",
    ),
    "fault that cannot happen": (
        "position:",
        "faults: {f: {topic: star/fore/observations, kind: covariance_unknown, start_s: 1.0, end_s: 2.0}}\nposition:",
        "'faults.f.kind' = covariance_unknown cannot happen to ship_msgs/msg/StarObservationArray",
    ),
    "topic of another output": (
        "position:",
        "faults: {f: {topic: star/fore/horizon_attitude, kind: drop, start_s: 1.0, end_s: 2.0}}\nposition:",
        "'faults.f.topic' = star/fore/horizon_attitude is not simulated: expected one of",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_scenario_is_refused_with_file_line_and_key(case, tmp_path):
    before, after, expected = BROKEN[case]
    assert before in TEXT
    path = tmp_path / "broken.yaml"
    path.write_text(TEXT.replace(before, after, 1), encoding="utf-8")
    with pytest.raises(BadInput) as refused:
        load_scenario(path)
    assert expected in str(refused.value)
    line = str(refused.value).removeprefix(f"{path}:").split(":")[0]
    assert line.isdecimal()


def test_a_voyage_without_real_stars_may_lie_anywhere_in_time(tmp_path):
    path = tmp_path / "far.yaml"
    text = (PAPER_STARS.parent / "paper.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("2014-07-09", "2090-07-09", 1), encoding="utf-8")
    assert load_scenario(path).start_utc.startswith("2090")


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
    assert not config.star_sensors["fore"].camera.given
    assert np.isclose(config.sky.pressure_hpa, 1008.3)
    assert "star_attitude:" not in inertial
    horizon = suite_yaml(load_scenario(PAPER_STARS.parent / "paper.yaml"))
    for word in ("sky", "camera", "input", "star_attitude:"):
        assert word not in horizon
