"""check_config with a bag: installation, focal lengths and units compared with the sensors' data."""

import re
from pathlib import Path

import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_replay.commands.check_config import main
from ship_simulation.simulate_command import main as simulate
from ship_testing.hand_made_bags import START_NS, imu
from ship_testing.paper_stars import make_optics_exact, without_optics_sigmas

BAGS = Path(__file__).parents[3] / "bags"


@pytest.fixture
def check(tmp_path, capsys):
    """Run the command; return exit code and findings."""

    def run(text, bag):
        config = tmp_path / "suite.yaml"
        config.write_text(text)
        code = main([str(config), str(bag)])
        captured = capsys.readouterr()
        lines = (captured.err + captured.out).replace(f"{tmp_path}/", "").replace(str(bag), "BAG").splitlines()
        # Another test is about the load.
        return code, [line for line in lines if not line.startswith(("check_config: ", "load: "))]

    return run


def simulate_bag(folder, name, duration_s, **changes):
    """A bag of a scenario of the repository with exact optics, and its suite configuration."""
    scenario = yaml.safe_load((BAGS / "scenarios" / f"{name}.yaml").read_text())
    scenario["duration_s"] = duration_s
    for sensor in scenario["star_sensors"].values():
        sensor |= changes
    make_optics_exact(scenario)
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(scenario))
    assert simulate([str(folder / f"{name}.yaml"), "--out", str(folder / f"{name}.mcap"), "--seed", "1"]) == 0
    return folder / f"{name}.mcap", suite_of(folder / f"{name}.mcap")


def suite_of(path):
    with read_bag(path) as bag:
        suite = without_optics_sigmas(bag.attachments[SUITE_ATTACHMENT].decode())
        return re.sub(r"(?m)^([a-z_]+:)", r"/**/\1", suite)


@pytest.fixture(scope="module")
def solved_bag(tmp_path_factory):
    return simulate_bag(tmp_path_factory.mktemp("solved"), "paper", 6.0)


@pytest.fixture(scope="module")
def observed_bag(tmp_path_factory):
    return simulate_bag(tmp_path_factory.mktemp("observed"), "paper_stars", 6.0, rate_hz=2.0)


def test_a_matching_configuration_is_good(check, solved_bag, observed_bag):
    for bag, text in (solved_bag, observed_bag):
        assert check(text, bag) == (0, ["suite.yaml: good for BAG"])


def test_radians_for_degrees_contradict_the_bag(check, solved_bag):
    bag, text = solved_bag
    assert text.count("elevation_deg: 45.0") == 2
    text = text.replace("_deg: 90.0", "_deg: 1.5708").replace("elevation_deg: 45.0", "elevation_deg: 0.7854")
    code, lines = check(text, bag)
    assert code == 2
    parameters = [re.sub(r"^error: suite.yaml:\d+: parameter '|'.*give|\d\d deg: radians", "", line) for line in lines]
    assert parameters == [
        "star_sensors.fore.elevation_deg 45. for degrees?",
        "star_sensors.starboard.azimuth_deg 89. for degrees?",
        "star_sensors.starboard.elevation_deg 45. for degrees?",
    ]


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_a_focal_length_ten_times_off_contradicts_the_bag(check, observed_bag, factor):
    bag, text = observed_bag
    wrong = f"{0.05 * factor:g}"
    code, lines = check(text.replace("focal_length_m: 0.05", f"focal_length_m: {wrong}"), bag)
    assert code == 2
    assert len(lines) == 4  # two sensors, of two nodes
    for line in lines:
        assert f".camera.focal_length_m' = {wrong} m, but angles between stars on 'star/" in line
        assert line.endswith("are those of 0.05 m with pixels of 5.5e-06 m")


def test_replaced_values_are_not_reported(check, observed_bag):
    bag, text = observed_bag
    code, lines = check(text.replace("focal_length_m: 0.05", "focal_length_m: 50.0"), bag)
    assert code == 2
    assert len(lines) == 4  # two sensors, of two nodes
    assert all(".camera.focal_length_m' = 50.0 m is out of its range" in line for line in lines)


def test_wrong_angles_are_found_with_a_wrong_focal_length(check, observed_bag):
    bag, text = observed_bag
    text = text.replace("focal_length_m: 0.05", "focal_length_m: 0.5").replace("_deg: 90.0", "_deg: 1.5708")
    code, lines = check(text, bag)
    assert code == 2
    assert sum("focal_length_m" in line for line in lines) == 4
    turned = [line for line in lines if "star_sensors.starboard.azimuth_deg' = 1.5708 deg" in line]
    assert len(turned) == 2
    assert all(line.endswith("give 89.98 deg: radians for degrees?") for line in turned)


def test_a_rotation_common_to_all_sensors_is_that_of_the_ins(check, solved_bag):
    bag, text = solved_bag
    turned = "      frame_id: ins\n      installation_heading_deg: 90.0\n"
    code, lines = check(text.replace("      frame_id: ins\n", turned), bag)
    assert code == 2
    (line,) = lines
    assert "all of 'star/fore/horizon_attitude', 'star/starboard/horizon_attitude' in BAG have the same" in line
    assert "check 'ins.convention' and 'ins.installation_heading_deg'" in line


def test_an_installation_beyond_its_sigma_is_reported_with_its_effect(check, solved_bag):
    bag, text = solved_bag
    code, (error, warning) = check(text.replace("elevation_deg: 45.0", "elevation_deg: 45.2", 1), bag)
    assert code == 2
    assert "ship_attitude: 0 of 31 messages on 'star/fore/horizon_attitude' were used, " in error
    assert re.fullmatch(
        r"warning: suite.yaml:\d+: star_sensors.fore: by 'star/fore/horizon_attitude' and 'ins/imu' in BAG the "
        r"installation is 0.2\d\d deg off, \d+ of its sigmas: run calibrate_installation",
        warning,
    )


def test_the_telescopes_focal_length_and_rejected_inputs(check):
    bag = BAGS / "theodolite.mcap"
    text = suite_of(bag)
    assert check(text, bag)[0] == 0
    code, (line,) = check(text.replace("focal_length_m: 0.1\n", "focal_length_m: 1.0\n"), bag)
    assert code == 2
    expected = (
        "parameter 'telescope.focal_length_m' = 1 m, but lights on 'theodolite/beacons' in BAG have distances that"
    )
    assert line.endswith(f"{expected} fit 0.1 m")


def test_attitudes_in_degrees_are_reported(check, tmp_path):
    factory, bag = RosbagsFactory(), tmp_path / "degrees.mcap"
    with BagWriter(bag) as writer:
        for number in range(40):
            stamp_ns = START_NS + number * 100_000_000
            writer.write("ins/imu", imu(stamp_ns), stamp_ns)
            fields = {"sensor_id": "fore", "azimuth": 120.0, "elevation": 45.0, "roll": 3.0, "star_count": 9}
            header = make_header(factory, stamp_ns, "star_fore")
            writer.write("star/fore/horizon_attitude", degrees(factory, header, fields), stamp_ns)
    text = "/**/ship_attitude: {ros__parameters: {star_sensors: {fore: {azimuth_deg: 0.0, elevation_deg: 45.0}}}}\n"
    code, lines = check(text, bag)
    assert code == 2
    expected = "ship_attitude: 0 of 40 messages on 'star/fore/horizon_attitude' were used, 40 rejected: units"
    assert lines == [f"error: degrees.mcap: {expected}"]


def degrees(factory, header, fields):
    """A StarHorizonAttitude without covariances."""
    zeros = {name: [0.0] * 9 for name in ("covariance", "rotation_covariance", "noise_covariance")}
    rest = {"rejected_count": 0, "residual_rms": 0.0, "status": 0}
    return factory.make("ship_msgs/msg/StarHorizonAttitude", header=header, **fields, **zeros, **rest)


def test_a_reference_is_compared_with_the_ins(check, tmp_path):
    bag = tmp_path / "reference.mcap"
    with BagWriter(bag) as writer:
        for number in range(100):
            stamp_ns = START_NS + number * 50_000_000
            writer.write("ins/imu", imu(stamp_ns, heading=0.3), stamp_ns)
            writer.write("reference/b/imu", imu(stamp_ns, "b", heading=0.3 + 0.5), stamp_ns)
    text = "/**/ship_attitude: {ros__parameters: {references: {b: {heading_deg: 28.6}}}}\n"
    assert check(text, bag) == (0, ["suite.yaml: good for reference.mcap"])
    code, lines = check(text.replace("28.6", "0.5"), bag)
    assert code == 2
    expected = "parameter 'references.b.heading_deg' = 0.5 deg, but 'reference/b/imu' and 'ins/imu' in reference.mcap"
    assert lines == [f"error: suite.yaml:1: {expected} give 28.65 deg: radians for degrees?"]


@pytest.mark.parametrize("name", ["demo", "theodolite"])
def test_a_bag_of_only_nan_is_no_contradiction(check, tmp_path, name):
    """Unreadable data show no installation: only the rejection by the nodes is reported."""
    bag = tmp_path / "nan.mcap"
    with read_bag(BAGS / f"{name}.mcap") as whole, BagWriter(bag) as writer:
        for record in whole.records():
            if record.log_time_ns > whole.start_ns + 3_000_000_000:
                break
            message = record.decode()
            if record.topic != "theodolite/encoder":
                without_numbers(message)
            writer.write(record.topic, message, record.log_time_ns)
    _, lines = check(suite_of(BAGS / f"{name}.mcap"), bag)
    assert len(lines) > 1
    for line in lines[:-1]:
        assert re.search(r": 0 of \d+ messages on .* were used, \d+ rejected: non_finite", line), line


def without_numbers(message):
    """Set every float of a message to NaN."""
    for field in message.__dataclass_fields__:
        value = getattr(message, field)
        if isinstance(value, float):
            setattr(message, field, float("nan"))
        elif isinstance(value, list) or hasattr(value, "__dataclass_fields__"):
            for part in value if isinstance(value, list) else [value]:
                if hasattr(part, "__dataclass_fields__"):
                    without_numbers(part)
