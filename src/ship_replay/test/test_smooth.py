"""``smooth``: a bag in, its attitudes with hindsight out."""

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import ns_from_stamp
from ship_replay.commands.evaluate import main as evaluate
from ship_replay.commands.replay import main as replay
from ship_replay.commands.smooth import main as smooth
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

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


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("smooth") / "in.mcap"
    scenario = path.with_suffix(".yaml")
    scenario.write_text(SCENARIO)
    write_bag(load_scenario(scenario), 3, path, SCENARIO.encode())
    return path


def messages(path, topic):
    with read_bag(path) as bag:
        return [(record.log_time_ns, record.decode()) for record in bag.records([topic])]


def variances(message):
    return np.diagonal(message.covariance.reshape(3, 3))


def test_each_attitude_is_told_again_with_what_came_later(bag, tmp_path, capsys):
    smoothed, replayed = tmp_path / "smoothed.mcap", tmp_path / "replayed.mcap"
    assert smooth([str(bag), "--out", str(smoothed)]) == 0
    assert replay([str(bag), "--out", str(replayed)]) == 0
    again, at_once = messages(smoothed, "ship/attitude_smoothed"), messages(replayed, "ship/attitude")
    told = [(log_ns, message) for log_ns, message in at_once if message.status != message.INVALID]
    assert len(again) == len(told) == 241
    for (log_ns, message), (at_once_log_ns, before) in zip(again, told, strict=True):
        assert log_ns == at_once_log_ns
        assert ns_from_stamp(message.header.stamp) == ns_from_stamp(before.header.stamp)
        assert message.status == before.status
        assert np.all(variances(message) <= variances(before) * (1.0 + 1e-6))
    # A second and a half of stars tell less than twelve.
    assert np.all(variances(again[30][1]) < 0.7 * variances(told[30][1]))
    assert "241 attitudes on ship/attitude_smoothed" in capsys.readouterr().out


def test_the_same_bag_gives_the_same_bytes(bag, tmp_path):
    outputs = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for path in outputs:
        assert smooth([str(bag), "--out", str(path)]) == 0
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_evaluate_judges_it_against_the_truth(bag, tmp_path, capsys):
    smoothed, bounds, numbers = tmp_path / "smoothed.mcap", tmp_path / "bounds.yaml", tmp_path / "numbers.json"
    assert smooth([str(bag), "--out", str(smoothed)]) == 0
    bounds.write_text("smoothed.heading.rms_over_sigma: {max: 2.6}\nsmoothed.nees_mean: {max: 11.3}\n")
    arguments = [str(smoothed), "--skip", "2", "--bounds", str(bounds), "--json", str(numbers)]
    assert evaluate(arguments) == 0, capsys.readouterr().out
    bounds.write_text("smoothed.heading.rms_over_sigma: {max: 0.001}\n")
    assert evaluate([*arguments, "--force"]) == 1


def test_bad_input_is_one_line_that_says_what_is_wrong(bag, tmp_path, capsys):
    out, config = tmp_path / "out.mcap", tmp_path / "suite.yaml"
    assert smooth([str(bag), "--out", str(bag), "--force"]) == 2
    assert "overwrite the input" in capsys.readouterr().err
    config.write_text("optical_axis:\n  ros__parameters: {}\n")
    assert smooth([str(bag), "--out", str(out), "--config", str(config)]) == 2
    config.write_text("star_attitude:\n  ros__parameters: {}\n")
    assert smooth([str(bag), "--out", str(out), "--config", str(config)]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 2
    assert "ship_attitude" in told[0]
    assert "there is nothing to smooth" in told[1]
    assert not out.exists()
