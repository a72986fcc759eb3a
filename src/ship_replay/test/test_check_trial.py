"""check_config with a bag: inputs that would not be used, sigmas that the data contradict, healthy bags."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.stamps import ns_from_stamp
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_replay.commands.check_config import main
from ship_replay.preflight.check_trial import ins_noise
from ship_simulation.simulate_command import main as simulate

BAGS = Path(__file__).parents[3] / "bags"


@pytest.fixture
def check(tmp_path, capsys):
    """Run the command on a bag with its own suite, or a changed one; return exit code and lines."""

    def run(bag, change=lambda suite: None):
        with read_bag(bag) as content:
            suite = yaml.safe_load(content.attachments[SUITE_ATTACHMENT])
        change(suite)
        config = tmp_path / "suite.yaml"
        config.write_text(yaml.safe_dump(suite))
        code = main([str(config), str(bag)])
        captured = capsys.readouterr()
        return code, (captured.err + captured.out).replace(str(bag), "BAG").replace(f"{tmp_path}/", "").splitlines()

    return run


def simulate_bag(folder, name, duration_s, change=lambda scenario: None):
    scenario = yaml.safe_load((BAGS / "scenarios" / f"{name}.yaml").read_text()) | {"duration_s": duration_s}
    change(scenario)
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(scenario))
    bag = folder / f"{name}.mcap"
    assert simulate([str(folder / f"{name}.yaml"), "--out", str(bag)]) == 0
    return bag


def rewrite_bag(path, source, change, until_s=30.0):
    """Write the first ``until_s`` seconds of a bag; ``change`` changes each message in place, by its topic."""
    with read_bag(source) as bag, BagWriter(path) as out:
        for name, content in bag.attachments.items():
            out.add_attachment(name, content)
        for record in bag.records():
            if record.log_time_ns > bag.start_ns + until_s * 1e9:
                break
            message = record.decode()
            change(record.topic, message)
            out.write(record.topic, message, record.log_time_ns)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", "theodolite"])
def test_a_healthy_bag_is_good(check, name):
    code, lines = check(BAGS / f"{name}.mcap")
    assert (code, [line for line in lines if not line.startswith("load: ")]) == (0, ["suite.yaml: good for BAG"])


@pytest.mark.slow
def test_an_ins_that_stamps_gps_time_is_reported_with_advice(check, tmp_path):
    def stamp_ahead(topic, message):
        if topic == "ins/imu":
            message.header.stamp.sec += 18

    code, lines = check(rewrite_bag(tmp_path / "ahead.mcap", BAGS / "demo.mcap", stamp_ahead))
    assert code == 1
    assert lines[0].startswith("not used: BAG: ship_attitude: 0 of 3000 messages on 'ins/imu' were used, 3000 rejected")
    assert re.search(r"\(100 % not used\): stamp is 1[78]\.\d+ s ahead", lines[0])
    assert "set the device's clock to UTC (GPS time is 18 s ahead)" in lines[0]
    assert "on 'star/fore/horizon_attitude'" in lines[1]
    assert lines[-1] == "check_config: suite.yaml: errors: 0, inputs not used: 3, warnings: 0"


@pytest.mark.slow
def test_an_input_rejected_for_the_second_half_of_the_bag_ends_with_one(check, tmp_path):
    first_ns = []

    def from_10_s_on(topic, message):
        first_ns.append(ns_from_stamp(message.header.stamp))
        if topic == "star/fore/horizon_attitude" and ns_from_stamp(message.header.stamp) > first_ns[0] + 10e9:
            message.header.stamp.sec += 18

    code, lines = check(rewrite_bag(tmp_path / "later.mcap", BAGS / "demo.mcap", from_10_s_on))
    assert code == 1
    (line,) = [line for line in lines if line.startswith("not used: ")]
    assert re.search(r"\d+ of 1\d\d messages on 'star/fore/horizon_attitude' were used, \d+ rejected: future", line)


def test_stars_without_fixes_end_with_one(check, tmp_path):
    bag = simulate_bag(tmp_path, "paper_stars", 8.0)

    def no_fix(topic, message):
        if topic == "gnss/fix":
            message.status.status = -1

    code, lines = check(rewrite_bag(tmp_path / "no_fix.mcap", bag, no_fix))
    assert code == 1
    pattern = r"rejected: no_fix \(100 % not used\): .*; provide position fixes on gnss"
    assert any(re.search(pattern, line) for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.5])
def test_a_wrong_centroid_sigma_is_named_with_the_value_that_fits(check, tmp_path, factor):
    bag = simulate_bag(tmp_path, "paper_stars", 12.0)
    configured = {}

    def change(suite):
        for node in suite.values():
            for id_, sensor in node["ros__parameters"].get("star_sensors", {}).items():
                configured[id_] = sensor["camera"]["centroid_sigma_px"]
                sensor["camera"]["centroid_sigma_px"] = factor * configured[id_]

    def without_sigma(topic, message):
        if topic.endswith("/observations"):
            for star in message.stars:
                star.sigma_px = 0.0

    assert check(bag)[0] == 0
    code, lines = check(rewrite_bag(tmp_path / "bare.mcap", bag, without_sigma), change)
    assert code == 0
    matches = [
        re.fullmatch(r".*'star_sensors.(\w+).camera.centroid_sigma_px' = .*: (\S+) fits", line) for line in lines
    ]
    fits = {match[1]: float(match[2]) for match in matches if match}
    assert fits.keys() == configured.keys()
    for id_, value in fits.items():
        assert value == pytest.approx(configured[id_], rel=0.15)


@pytest.mark.slow
def test_stars_that_state_too_small_a_noise_are_named_with_the_factor_of_their_variance(check, tmp_path):
    def reduce_covariance(topic, message):
        if topic == "star/fore/horizon_attitude":
            message.noise_covariance = np.array(message.noise_covariance) / 9.0

    _, lines = check(rewrite_bag(tmp_path / "small.mcap", BAGS / "demo.mcap", reduce_covariance))
    (line,) = [line for line in lines if "topic 'star/fore/horizon_attitude' states a noise" in line]
    assert 6.0 < float(re.search(r"(\S+) times its variance fits", line)[1]) < 12.0


@pytest.mark.slow
def test_a_coarse_ins_is_named_with_the_value_that_fits_and_no_star_with_it(check, tmp_path):
    def coarse(topic, message):
        if topic == "ins/imu":
            for axis in "xyzw":
                setattr(message.orientation, axis, round(getattr(message.orientation, axis), 4))

    _, lines = check(rewrite_bag(tmp_path / "coarse.mcap", BAGS / "demo.mcap", coarse))
    (line,) = [line for line in lines if line.startswith("warning: ")]
    assert "parameter 'ins.white_sigma_arcsec' = 1 arcsec, but 'ins/imu' in BAG: attitudes scatter" in line
    # Rounding of the quaternion to 1e-4 rotates by 2 · 1e-4 / sqrt(12) about each of three axes.
    assert float(re.search(r"by (\S+) arcsec, 1 sigma", line)[1]) == pytest.approx(12.0, rel=0.3)


@pytest.mark.parametrize(("white_arcsec", "rate_arcsec_per_s"), [(10.0, 0.0), (1.0, 600.0), (5.0, 300.0)])
def test_attitude_noise_and_rate_noise_of_an_ins_are_separated(white_arcsec, rate_arcsec_per_s):
    rng, hz, count = np.random.default_rng(1), 100.0, 20_000
    t_s = np.arange(count) / hz
    angles = 0.05 * np.sin(0.6 * t_s)[:, None] * [1.0, 0.3, 0.0]
    rates = 0.03 * np.cos(0.6 * t_s)[:, None] * [1.0, 0.3, 0.0]
    rates = rates + rate_arcsec_per_s * ARCSEC * rng.standard_normal((count, 3))
    rotations = exp_rotation(angles) @ exp_rotation(white_arcsec * ARCSEC * rng.standard_normal((count, 3)))
    noise = ins_noise(np.rint(1e9 * t_s).astype(int), rotations, rates)
    assert noise.attitude_sigma_rad / ARCSEC == pytest.approx(white_arcsec, rel=0.2)
    assert noise.rate_sigma_rad_per_s / ARCSEC == pytest.approx(rate_arcsec_per_s, rel=0.1)
