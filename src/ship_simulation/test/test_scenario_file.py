"""Scenario files with real stars: refused values."""

import pytest

from ship_bags.errors import BadInput
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.paper_stars import PAPER_STARS

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
    "direction of unidentified stars": (
        "    magnitude_limit: 6.0",
        "    identified: false\n    direction_given: true",
        "'star_sensors.fore.direction_given' needs identified stars",
    ),
    "masks that hide all": (
        "    magnitude_limit: 6.0",
        "    masks: {wall: {azimuths_deg: [340.0, 380.0, 380.0, 340.0], elevations_deg: [9.0, 9.0, 80.0, 80.0]}}",
        "parameter 'star_sensors.fore.masks': wall cover the whole field of view",
    ),
    "mask of two corners": (
        "    magnitude_limit: 6.0",
        "    masks:\n      flag: {azimuths_deg: [1.0, 2.0], elevations_deg: [1.0, 2.0]}",
        "parameter 'star_sensors.fore.masks.flag': 2 azimuths and 2 elevations do not define a polygon",
    ),
    "no Earth orientation": (
        "2014-07-09T11:50:07.8Z",
        "2090-07-09T11:50:07.8Z",
        "'start_utc' = 2090-07-09T11:50:07.8Z: no sky can be computed: no Earth orientation for",
    ),
    "fault that does not apply": (
        "position:",
        "faults: {f: {topic: star/fore/observations, kind: covariance_unknown, start_s: 1.0, end_s: 2.0}}\nposition:",
        "'faults.f.kind' = covariance_unknown does not apply to ship_msgs/msg/StarObservationArray",
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


def test_a_voyage_without_real_stars_may_have_any_date(tmp_path):
    path = tmp_path / "far.yaml"
    text = (PAPER_STARS.parent / "paper.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("2014-07-09", "2090-07-09", 1), encoding="utf-8")
    assert load_scenario(path).start_utc.startswith("2090")
