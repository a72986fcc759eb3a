"""The command ``simulate``: bags reproducible to the byte, matching attachments, one line for each error."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.mcap.bag_reader import read_bag
from ship_node.parameters.parameter_file import has_section, load_config
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import main
from ship_simulation.suite_file import suite_yaml
from ship_testing.short_scenario import SHORT
from ship_testing.usage_errors import usage_error

SCENARIOS = Path(__file__).resolve().parents[3] / "bags" / "scenarios"

QUIET = ("tilt_sigma_arcsec", "heading_sigma_arcsec", "white_sigma_arcsec", "time_offset_sigma_s")


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def test_the_same_seed_gives_the_same_bytes(scenario, tmp_path):
    digests = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert main([str(scenario), "--out", str(tmp_path / f"{name}.mcap"), "--seed", str(seed)]) == 0
        digests.append(hashlib.sha256((tmp_path / f"{name}.mcap").read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]


def test_another_process_gives_the_same_bytes(scenario, tmp_path):
    assert main([str(scenario), "--out", str(tmp_path / "here.mcap"), "--seed", "1"]) == 0
    code = "import sys; from ship_simulation.simulate_command import main; sys.exit(main())"
    arguments = [str(scenario), "--out", str(tmp_path / "there.mcap"), "--seed", "1"]
    subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True)
    assert (tmp_path / "here.mcap").read_bytes() == (tmp_path / "there.mcap").read_bytes()


def test_the_bag_contains_the_scenario_and_a_suite_configuration_with_its_sigmas(scenario, tmp_path):
    out = tmp_path / "short.mcap"
    assert main([str(scenario), "--out", str(out), "--seed", "1"]) == 0
    with read_bag(out) as bag:
        assert bag.attachments["scenario.yaml"].decode() == SHORT
        suite = bag.attachments["suite.yaml"].decode()
        assert bag.metadata["simulation"] == {"seed": "1"}
        counts = dict.fromkeys(bag.topics, 0)
        for record in bag.records():
            counts[record.topic] += 1
    assert counts["ins/imu"] == 401
    assert counts["star/fore/horizon_attitude"] == 21
    config = load_config(ShipAttitudeConfig, suite, "ship_attitude")
    assert (config.ins.tilt_sigma_arcsec, config.ins.heading_sigma_arcsec) == (11.0, 70.0)
    assert (config.ins.white_sigma_arcsec, config.ins.frame_id) == (2.0, "ins")
    fore = config.star_sensors["fore"]
    assert (fore.azimuth_deg, fore.sigma_up_arcsec, fore.flexure_sigma_arcsec) == (10.0, 4.0, 5.0)
    assert fore.frame_id == "star_fore"
    assert config.references["gyro"].sigma_roll_arcsec == 33.0


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_scenario_of_the_repository_can_be_simulated(path, tmp_path):
    recording = None
    if path.stem == "recorded":
        recording = tmp_path / "carrier.mcap"
        assert main([str(SCENARIOS / "demo.yaml"), "--out", str(recording)]) == 0
    scenario = load_scenario(path, recording)
    suite = suite_yaml(scenario)
    assert has_section(suite, "ship_attitude") != scenario.fused_attitude.written
    if has_section(suite, "ship_attitude"):
        config = load_config(ShipAttitudeConfig, suite, "ship_attitude")
        assert set(config.star_sensors) == set(scenario.star_sensors)
    assert has_section(suite, "optical_axis") == scenario.theodolite.aboard
    assert scenario.duration_s >= 60.0


def test_a_recorded_attitude_can_be_followed(scenario, tmp_path):
    recording = tmp_path / "carrier.mcap"
    zeros = ", ".join(f"{name}: 0.0" for name in QUIET)
    quiet = f"ins: {{{zeros}}}"
    lines = SHORT.splitlines()
    calm = "\n".join([*lines[:5], quiet, *lines[6:]])
    scenario.write_text(calm.replace("duration_s: 4.0", "duration_s: 20.0"))
    assert main([str(scenario), "--out", str(recording)]) == 0
    follower = tmp_path / "follower.yaml"
    follower.write_text(
        'start_utc: "2020-01-01T00:00:00Z"\nduration_s: 10.0\n'
        "carrier: {kind: recorded, recording: {bag: carrier.mcap}}\n" + quiet + "\n"
    )
    run = simulate(load_scenario(follower), seed=1)
    # The simulation starts one second into the record: roll 4° sin(2 pi (t + 1) / 11).
    t_s = np.arange(1001) / 100.0
    roll_rate = np.deg2rad(4.0) * (2.0 * np.pi / 11.0) * np.cos(2.0 * np.pi * (t_s + 1.0) / 11.0)
    np.testing.assert_allclose(run.ins.rate_d[:, 0], roll_rate, rtol=0.0, atol=1e-6)


def test_a_record_that_is_too_short_is_refused(scenario, tmp_path, capsys):
    recording = tmp_path / "carrier.mcap"
    assert main([str(scenario), "--out", str(recording)]) == 0
    capsys.readouterr()
    line = usage_error(main, capsys, SCENARIOS / "recorded.yaml", "--out", tmp_path / "x.mcap", "--carrier", recording)
    assert "the recorded motion lasts 4.0 s" in line
    assert "reduce duration_s" in line
    assert not (tmp_path / "x.mcap").exists()


BROKEN = {
    "unknown key": ("white_sigma_arcsec", "wite_sigma_arcsec", ":6: parameter 'ins.wite_sigma_arcsec' is unknown"),
    "negative sigma": ("sigma_arcsec: 2.0", "sigma_arcsec: -2.0", ":6: parameter 'ins.white_sigma_arcsec' = -2.0"),
    "range": ("sigma_arcsec: 2.0", "sigma_arcsec: -2.0", "out of its range [0.0, 360000.0] arcsec"),
    "wrong type": (
        "sigma_up_arcsec: 4.0",
        "sigma_up_arcsec: four",
        ":8: parameter 'star_sensors.fore.sigma_up_arcsec' must be",
    ),
    "nan": ("duration_s: 4.0", "duration_s: .nan", ":2: parameter 'duration_s' must be finite"),
    "missing": ("elevation_deg: 45.0, ", "", ":8: parameter 'star_sensors.fore.elevation_deg'"),
    "unknown group": ("references:", "refs:", ":10: parameter 'refs' is unknown"),
    "kind": ("kind: sinusoids", "kind: magic", ":4: parameter 'carrier.kind' = 'magic' must be one of sinusoids"),
    "not a time": ("11:50:07.8Z", "11:50:07.8", ":1: 'start_utc' = 2014-07-09T11:50:07.8 is not a time"),
    "unused group": ("kind: sinusoids", "kind: recorded", ":5: 'carrier.roll' is not used by a carrier of kind"),
    "no recording": (
        "  kind: sinusoids\n  roll: {waves: {swell: {amplitude_deg: 4.0, period_s: 11.0}}}",
        "  kind: recorded\n  recording: {bag: nothing.mcap}",
        ":5: 'carrier.recording.bag'",
    ),
    "not YAML": ("carrier:", "carrier: [", "not YAML"),
    "twice": (
        "duration_s: 4.0",
        "duration_s: 4.0\nduration_s: 5.0",
        ":3: 'duration_s' is given twice, first in line 2",
    ),
    "window": (
        "references:",
        "faults: {f: {topic: ins/imu, kind: drop, start_s: 2.0, end_s: 1.0}}\nreferences:",
        ":9: 'faults.f.end_s' = 1.0 s must be after start_s = 2.0 s",
    ),
    "fault topic": (
        "references:",
        "faults: {f: {topic: ins/imo, kind: drop, start_s: 1.0, end_s: 2.0}}\nreferences:",
        ":9: 'faults.f.topic' = ins/imo is not simulated: expected one of ins/imu",
    ),
    "fault kind": (
        "references:",
        "faults: {f: {topic: gnss/fix, kind: rate_in_degrees, start_s: 1.0, end_s: 2.0}}\nreferences:",
        ":9: 'faults.f.kind' = rate_in_degrees does not apply to sensor_msgs/msg/NavSatFix",
    ),
    "fault delay": (
        "references:",
        "faults: {f: {topic: ins/imu, kind: delay, start_s: 1.0, end_s: 2.0}}\nreferences:",
        ":9: 'faults.f' of kind delay needs delay_s",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_scenario_is_one_line_with_file_line_and_key(case, scenario, tmp_path, capsys):
    before, after, expected = BROKEN[case]
    assert before in SHORT
    scenario.write_text(SHORT.replace(before, after, 1))
    line = usage_error(main, capsys, scenario, "--out", tmp_path / "x.mcap")
    assert str(scenario) in line
    assert expected in line
    assert list(tmp_path.iterdir()) == [scenario]


def test_missing_files_are_named(scenario, tmp_path, capsys):
    line = usage_error(main, capsys, tmp_path / "none.yaml", "--out", tmp_path / "x.mcap")
    assert "none.yaml" in line
    assert "No such file" in line
    line = usage_error(main, capsys, scenario, "--out", tmp_path / "no_folder" / "x.mcap")
    assert "no_folder/x.mcap: cannot be written" in line
    (tmp_path / "empty.yaml").write_text("")
    assert "empty.yaml:1: expected 'name: value' entries" in usage_error(
        main, capsys, tmp_path / "empty.yaml", "--out", tmp_path / "x.mcap"
    )


@pytest.mark.parametrize("seed", ["-1", "1.5", "one", ""])
def test_a_seed_is_a_whole_number(seed, scenario, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([str(scenario), "--out", str(tmp_path / "x.mcap"), f"--seed={seed}"])
    assert stopped.value.code == 2
    assert "whole number" in capsys.readouterr().err


def test_a_carrier_for_a_scenario_without_recording_is_refused(scenario, tmp_path, capsys):
    line = usage_error(main, capsys, scenario, "--out", tmp_path / "x.mcap", "--carrier", tmp_path / "carrier.mcap")
    assert "short.yaml:4: 'carrier.kind' must be recorded" in line
