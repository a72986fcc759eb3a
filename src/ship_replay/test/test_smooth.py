"""``smooth``: smoothed attitudes and pointings of a bag."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import ns_from_stamp
from ship_replay.commands.evaluate import main as evaluate
from ship_replay.commands.replay import main as replay
from ship_replay.commands.smooth import main as smooth
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
from ship_testing.overconfident_filter import make_overconfident

SCENARIO = """\
start_utc: "2014-07-09T11:50:07.8Z"
duration_s: 12.0
carrier:
  kind: sinusoids
  roll: {waves: {swell: {amplitude_deg: 4.0, period_s: 11.0}}}
ins: {tilt_sigma_arcsec: 11.0, heading_sigma_arcsec: 70.0, white_sigma_arcsec: 0.5, rate_hz: 20.0}
star_sensors:
  fore: {azimuth_deg: 0.0, elevation_deg: 45.0}
  starboard: {azimuth_deg: 90.0, elevation_deg: 45.0}
"""


THEODOLITE = """\
theodolite:
  aboard: true
  encoder: {rate_hz: 10.0}
  axes: {g_sigma_arcsec: 30.0, h_sigma_arcsec: 30.0}
  telescope: {rate_hz: 2.0, phase_s: 0.25, focal_length_m: 0.1, sigma_m: 6.5e-7}
beacons:
  a:
    flight: {kind: escort, escort: {right_deg: 3.0, up_deg: 2.0, distance_m: 2000.0}}
    hidden: {early: {start_s: 0.0, end_s: 6.0}}
    rtk: {rate_hz: 5.0}
  b:
    flight: {kind: escort, escort: {right_deg: -2.0, up_deg: -3.0, distance_m: 2000.0}}
    hidden: {early: {start_s: 0.0, end_s: 6.0}}
    rtk: {rate_hz: 5.0}
"""


def simulate_bag(folder, text):
    path = folder / "in.mcap"
    scenario = path.with_suffix(".yaml")
    scenario.write_text(text)
    write_bag(load_scenario(scenario), 3, path, text.encode())
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return simulate_bag(tmp_path_factory.mktemp("smooth"), SCENARIO)


@pytest.fixture(scope="module")
def theodolite_bag(tmp_path_factory):
    return simulate_bag(tmp_path_factory.mktemp("smooth_theodolite"), SCENARIO + THEODOLITE)


def messages(path, topic):
    with read_bag(path) as bag:
        return [(record.log_time_ns, record.decode()) for record in bag.records([topic])]


def variances(message):
    return np.diagonal(message.covariance.reshape(3, 3))


def test_each_attitude_is_smoothed(bag, tmp_path, capsys):
    smoothed, replayed = tmp_path / "smoothed.mcap", tmp_path / "replayed.mcap"
    assert smooth([str(bag), "--out", str(smoothed)]) == 0
    assert replay([str(bag), "--out", str(replayed)]) == 0
    again, at_once = messages(smoothed, "ship/attitude_smoothed"), messages(replayed, "ship/attitude")
    valid = [(log_ns, message) for log_ns, message in at_once if message.status != message.INVALID]
    assert len(again) == len(valid) == 241
    for (log_ns, message), (at_once_log_ns, before) in zip(again, valid, strict=True):
        assert log_ns == at_once_log_ns
        assert ns_from_stamp(message.header.stamp) == ns_from_stamp(before.header.stamp)
        assert message.status == before.status
        assert np.all(variances(message) <= variances(before) * (1.0 + 1e-6))
    # One and a half seconds of stars contain less information than twelve.
    assert np.all(variances(again[30][1]) < 0.7 * variances(valid[30][1]))
    assert "241 messages on ship/attitude_smoothed" in capsys.readouterr().out


@pytest.mark.slow
def test_each_pointing_is_smoothed_with_the_smoothed_attitude(theodolite_bag, tmp_path, capsys):
    smoothed, replayed = tmp_path / "smoothed.mcap", tmp_path / "replayed.mcap"
    assert smooth([str(theodolite_bag), "--out", str(smoothed)]) == 0
    assert "121 messages on theodolite/pointing_smoothed" in capsys.readouterr().out
    assert replay([str(theodolite_bag), "--out", str(replayed)]) == 0
    again, at_once = messages(smoothed, "theodolite/pointing_smoothed"), messages(replayed, "theodolite/pointing")
    valid = [(log_ns, message) for log_ns, message in at_once if message.status != message.INVALID]
    assert len(again) == len(valid) == 121
    for (log_ns, message), (at_once_log_ns, before) in zip(again, valid, strict=True):
        assert log_ns == at_once_log_ns
        assert ns_from_stamp(message.header.stamp) == ns_from_stamp(before.header.stamp)
        assert (message.status, message.mode, message.light_count) == (before.status, before.mode, before.light_count)
        assert np.isfinite(message.telescope_azimuth) == np.isfinite(before.telescope_azimuth)
    # Before the first lights the sigma of the encoders' zero points was 30".
    assert again[20][1].mode == again[20][1].ENCODER
    assert np.all(variances(again[20][1])[:2] < 0.1 * variances(valid[20][1])[:2])
    # The attitudes of the ship are smoothed as without a theodolite, and both outputs are evaluated.
    assert len(messages(smoothed, "ship/attitude_smoothed")) == 241
    numbers = tmp_path / "numbers.json"
    assert evaluate([str(smoothed), "--json", str(numbers)]) == 0
    evaluated = json.loads(numbers.read_text())
    assert evaluated["smoothed.samples"] == evaluated["smoothed_pointing.samples"] == 121


def test_pointings_are_smoothed_by_a_recorded_attitude_too(theodolite_bag, tmp_path):
    # Without a section of ship_attitude the attitude is that of the bag, here of a replay.
    recorded, config, out = tmp_path / "recorded.mcap", tmp_path / "suite.yaml", tmp_path / "out.mcap"
    assert replay([str(theodolite_bag), "--out", str(recorded)]) == 0
    with read_bag(theodolite_bag) as inputs, read_bag(recorded) as outputs, BagWriter(tmp_path / "both.mcap") as both:
        config.write_bytes(inputs.attachments["suite.yaml"])
        records = [*inputs.records(), *outputs.records(["ship/attitude"])]
        for name, type_name in {record.topic: record.type_name for record in records}.items():
            both.add_topic(name, type_name)
        for record in sorted(records, key=lambda record: record.log_time_ns):
            both.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    whole = yaml.safe_load(config.read_text())
    config.write_text(yaml.safe_dump({"/**/optical_axis": whole["/**/optical_axis"]}))
    assert smooth([str(tmp_path / "both.mcap"), "--out", str(out), "--config", str(config)]) == 0
    assert not messages(out, "ship/attitude_smoothed")
    again = messages(out, "theodolite/pointing_smoothed")
    at_once = [message for _, message in messages(recorded, "theodolite/pointing") if message.status != message.INVALID]
    assert len(again) == len(at_once) == 121
    assert np.all(variances(again[20][1])[:2] < 0.1 * variances(at_once[20])[:2])


def test_the_same_bag_gives_the_same_bytes(theodolite_bag, tmp_path):
    outputs = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for path in outputs:
        assert smooth([str(theodolite_bag), "--out", str(path)]) == 0
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_evaluate_compares_it_with_the_truth(bag, tmp_path, capsys):
    smoothed, bounds, numbers = tmp_path / "smoothed.mcap", tmp_path / "bounds.yaml", tmp_path / "numbers.json"
    assert smooth([str(bag), "--out", str(smoothed)]) == 0
    bounds.write_text("smoothed.heading.rms_over_sigma: {max: 2.6}\nsmoothed.nees_mean: {max: 11.3}\n")
    arguments = [str(smoothed), "--skip", "2", "--bounds", str(bounds), "--json", str(numbers)]
    assert evaluate(arguments) == 0, capsys.readouterr().out
    bounds.write_text("smoothed.heading.rms_over_sigma: {max: 0.001}\n")
    assert evaluate([*arguments, "--force"]) == 1


def test_bad_input_is_one_line(bag, tmp_path, capsys):
    out, config = tmp_path / "out.mcap", tmp_path / "suite.yaml"
    assert smooth([str(bag), "--out", str(bag), "--force"]) == 2
    assert "overwrite the input" in capsys.readouterr().err
    telescope = "{telescope_id: main, focal_length_m: 0.1}"
    config.write_text(f"optical_axis:\n  ros__parameters: {{telescope: {telescope}}}\n")
    assert smooth([str(bag), "--out", str(out), "--config", str(config)]) == 2
    config.write_text("star_attitude:\n  ros__parameters: {}\n")
    assert smooth([str(bag), "--out", str(out), "--config", str(config)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 2
    assert "theodolite/encoder, ship/attitude are missing" in lines[0]
    assert "there is nothing to smooth" in lines[1]
    assert not out.exists()


@pytest.mark.slow
def test_attitudes_of_before_an_adoption_are_smoothed_too(tmp_path, monkeypatch):
    """The filter is corrupted after 15 s and replaced half a minute later; at most three attitudes are lost."""
    bag, out = simulate_bag(tmp_path, SCENARIO.replace("duration_s: 12.0", "duration_s: 60.0")), tmp_path / "out.mcap"
    look, adapters = ShipAttitudeAdapter._decide, set()
    (start_ns, _), *_ = messages(bag, "ins/imu")

    def decide_with_fault(self, now_ns, waiting_ns):
        self.recovery._config = replace(self.recovery._config, confirm_s=25.0)
        if waiting_ns - start_ns >= 15_000_000_000 and self not in adapters:
            adapters.add(self)
            make_overconfident(self)
        return look(self, now_ns, waiting_ns)

    monkeypatch.setattr(ShipAttitudeAdapter, "_decide", decide_with_fault)
    assert smooth([str(bag), "--out", str(out)]) == 0
    (adapter,) = adapters
    assert adapter.recovery.adopted == 1
    stamps_ns = [ns_from_stamp(message.header.stamp) for _, message in messages(out, "ship/attitude_smoothed")]
    assert stamps_ns == sorted(set(stamps_ns))
    inputs = messages(bag, "ins/imu")
    assert len(stamps_ns) >= len(inputs) - 3
