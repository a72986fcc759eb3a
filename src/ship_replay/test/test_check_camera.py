"""check_config with a bag: stars that contradict the camera's configuration, on the deck and on the theodolite.

Bags are simulated; the error is put into the bag's messages, or into the suite configuration. The expected result
follows from the error: the true focal length, the offset of the magnitudes, the reversed axis.
"""

import re
from pathlib import Path

import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_replay.commands.check_config import main
from ship_simulation.simulate_command import main as simulate
from ship_testing.paper_stars import make_optics_exact, without_optics_sigmas

pytestmark = pytest.mark.slow
SCENARIOS = Path(__file__).parents[3] / "bags" / "scenarios"
CASES = Path(__file__).parents[4] / "shared" / "cases"
"""Inputs that are not in the repository."""

FORE, STARBOARD, NIGHT = "star/fore/observations", "star/starboard/observations", "theodolite/night/stars"
IMAGE_PX = {FORE: 2047.0, NIGHT: 2199.0}
"""Topic → largest u and v of its camera, px."""


def deck_scenario(identified):
    """Two cameras with about ten stars over a small sea, for twenty seconds."""
    scenario = yaml.safe_load((SCENARIOS / "paper_stars.yaml").read_text())
    scenario["duration_s"], scenario["ins"]["rate_hz"] = 20.0, 20.0
    for sensor in scenario["star_sensors"].values():
        sensor |= {"rate_hz": 2.0, "most_stars": 10, "identified": identified}
    return scenario


def mount_scenario(identified):
    """A camera on the theodolite with ten stars, for twenty seconds."""
    scenario = yaml.safe_load((SCENARIOS / "theodolite_night.yaml").read_text())
    scenario["duration_s"] = 20.0
    scenario["telescopes"]["night"]["identified"] = identified
    return scenario


def simulate_bag(folder, scenario, seed=1):
    """Return a bag of a scenario with exact optics, and its suite configuration with the default errors of optics."""
    make_optics_exact(scenario)
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    bag = folder / f"bag_{seed}.mcap"
    assert simulate([str(folder / "scenario.yaml"), "--out", str(bag), "--seed", str(seed)]) == 0
    with read_bag(bag) as recorded:
        suite = without_optics_sigmas(recorded.attachments[SUITE_ATTACHMENT].decode())
        return bag, re.sub(r"(?m)^([a-z_]+:)", r"/**/\1", suite)


@pytest.fixture(scope="module", params=[True, False], ids=["named", "unnamed"])
def deck(tmp_path_factory, request):
    return simulate_bag(tmp_path_factory.mktemp("deck"), deck_scenario(request.param))


@pytest.fixture(scope="module", params=[True, False], ids=["named", "unnamed"])
def mount(tmp_path_factory, request):
    return simulate_bag(tmp_path_factory.mktemp("mount"), mount_scenario(request.param))


@pytest.fixture
def check(tmp_path, capsys):
    """Run the command; return its findings about cameras, without file names and line numbers."""

    def run(text, bag):
        config = tmp_path / "suite.yaml"
        config.write_text(text)
        main([str(config), str(bag)])
        captured = capsys.readouterr()
        lines = (captured.err + captured.out).replace(f"{config}", "suite").replace(str(bag), "BAG").splitlines()
        found = [re.sub(r" suite:\d+:", "", line) for line in lines if line.startswith(("error", "warning"))]
        # Both nodes with a camera report the same.
        return list(dict.fromkeys(line for line in found if "camera" in line or "magnitudes" in line))

    return run


def change_bag(bag, folder, topic, change):
    """A copy of a bag with each star of a topic changed."""
    copy = folder / "changed.mcap"
    with read_bag(bag) as whole, BagWriter(copy) as writer:
        for record in whole.records():
            message = record.decode()
            if record.topic == topic:
                for star in message.stars:
                    change(star)
            writer.write(record.topic, message, record.log_time_ns)
    return copy


def shift_by_a_pixel(star):
    star.u, star.v = star.u + 1.0, star.v + 1.0


def u_to_the_left(star, edge_px):
    star.u = edge_px - star.u


def v_upwards(star, edge_px):
    star.v = edge_px - star.v


def exchange_axes(star, edge_px):
    star.u, star.v = star.v, star.u


def instrumental(star):
    star.magnitude += 7.5


def in_blue(star):
    star.magnitude += 0.7


MIRRORS = pytest.mark.parametrize(
    ("mirror", "words"),
    [
        (u_to_the_left, "u counts to the left"),
        (v_upwards, "v counts upwards"),
        (exchange_axes, "u and v are exchanged"),
    ],
)


def hold_focal_length(lines, name):
    """Return the focal length that fits and its sigma, m, and the difference, %, from the only line."""
    (line,) = lines
    found = re.fullmatch(
        rf"warning: parameter '{name}' = \S+ m, but angles between stars on '\S+' in BAG are those of (\S+) m, "
        r"sigma (\S+) m, with pixels of \S+ m: (\S+) %",
        line,
    )
    assert found, line
    return tuple(map(float, found.groups()))


def test_cameras_as_configured_are_not_named(check, deck, mount):
    for bag, text in (deck, mount):
        assert check(text, bag) == []


@pytest.mark.parametrize("scale", [5e-4, -5e-4, 3e-3])
def test_a_focal_length_a_twentieth_of_a_percent_off_is_named_with_the_value_that_fits(check, deck, scale):
    bag, text = deck
    wrong = text.replace("focal_length_m: 0.05", f"focal_length_m: {0.05 * (1.0 - scale):.7f}", 1)
    fits_m, sigma_m, percent = hold_focal_length(check(wrong, bag), "star_sensors.fore.camera.focal_length_m")
    assert abs(fits_m - 0.05) < 3.3 * sigma_m + 5e-8
    assert 1e-7 < sigma_m < 1e-6
    assert percent == pytest.approx(100.0 * scale, abs=0.006)


@pytest.mark.parametrize("scale", [5e-4, -5e-4, 3e-3])
def test_the_focal_length_of_a_camera_on_the_theodolite_is_named(check, mount, scale):
    bag, text = mount
    camera = text.index("principal_u_px: 1100.0")
    at = text.rindex("focal_length_m: 0.1", 0, camera)
    wrong = text[:at] + f"focal_length_m: {0.1 * (1.0 - scale):.7f}" + text[at + len("focal_length_m: 0.1") :]
    fits_m, sigma_m, percent = hold_focal_length(check(wrong, bag), "telescopes.night.camera.focal_length_m")
    assert abs(fits_m - 0.1) < 3.3 * sigma_m + 1e-7
    assert 1e-7 < sigma_m < 3e-6
    assert percent == pytest.approx(100.0 * scale, abs=0.01)


@MIRRORS
def test_mirrored_axes_are_named(check, deck, tmp_path, mirror, words):
    bag, text = deck
    lines = check(text, change_bag(bag, tmp_path, FORE, lambda star: mirror(star, IMAGE_PX[FORE])))
    expected = "expected u to the right and v down, looking out of the sensor"
    expected_text = f"stars on '{FORE}' in BAG fit the sky only in a mirrored image: {words}; {expected}"
    assert lines[0] == f"error: star_sensors.fore.camera: {expected_text}"
    assert len(lines) == 1


def test_mirrored_axes_without_an_ins_are_named_as_such(check, tmp_path):
    """The reversed axis is not named, since there is no predicted attitude."""
    bag, text = simulate_bag(tmp_path, deck_scenario(True))
    mirrored = change_bag(bag, tmp_path, FORE, lambda star: v_upwards(star, IMAGE_PX[FORE]))
    alone = tmp_path / "alone.mcap"
    with read_bag(mirrored) as whole, BagWriter(alone) as writer:
        for record in whole.records():
            if record.topic != "ins/imu":
                writer.write(record.topic, record.decode(), record.log_time_ns)
    (line,) = [line for line in check(text, alone) if "mirrored" in line]
    assert "fit the sky only in a mirrored image: u or v is reversed, or both are exchanged; expected" in line


@MIRRORS
def test_mirrored_axes_of_a_camera_on_the_theodolite_are_named(check, mount, tmp_path, mirror, words):
    bag, text = mount
    lines = check(text, change_bag(bag, tmp_path, NIGHT, lambda star: mirror(star, IMAGE_PX[NIGHT])))
    assert len(lines) == 1
    assert lines[0].startswith(f"error: telescopes.night.camera: stars on '{NIGHT}' in BAG fit the sky only in a mirr")
    assert f"mirrored image: {words}; expected" in lines[0]


@pytest.mark.parametrize(("change", "offset"), [(instrumental, 7.5), (in_blue, 0.7)])
def test_magnitudes_that_are_not_the_catalogues_are_named(check, deck, mount, tmp_path, change, offset):
    for (bag, text), topic, section in ((deck, FORE, "star_sensors.fore"), (mount, NIGHT, "telescopes.night")):
        (line,) = check(text, change_bag(bag, tmp_path, topic, change))
        match = re.fullmatch(
            rf"warning: {section}: magnitudes of stars on '{topic}' in BAG are (\S+) fainter than the catalogue's "
            r"\(Hp\), sigma \S+: instrumental, or of another band; subtract \S+, or give NaN",
            line,
        )
        assert match, line
        # The simulated sensors measure magnitudes with a sigma of 0.1.
        assert float(match[1]) == pytest.approx(offset, abs=0.1)


def test_pixels_counted_from_one_are_named(check, deck, tmp_path):
    bag, text = deck
    (line,) = check(text, change_bag(bag, tmp_path, STARBOARD, shift_by_a_pixel))
    assert line.startswith("warning: parameter 'star_sensors.starboard.camera.principal_u_px': by ")
    assert line.endswith("one pixel to the right and down: if pixels are counted from 1, subtract 1 from u and v")


@pytest.mark.statistics
@pytest.mark.parametrize("identified", [True, False], ids=["named", "unnamed"])
@pytest.mark.parametrize(("scenario", "seeds"), [(deck_scenario, range(10, 20)), (mount_scenario, range(10, 15))])
def test_bags_without_faults_give_no_finding(check, tmp_path, scenario, seeds, identified):
    """Installations, INS and stars are drawn for each seed by their sigmas."""
    for seed in seeds:
        bag, text = simulate_bag(tmp_path, scenario(identified), seed)
        assert check(text, bag) == []


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases from the field are not on this machine")
@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("62-magnitudes/instrumental", r"star_sensors.fore: magnitudes of stars .* are 7.50 fainter"),
        ("63-image-axes/one_based", r"fore.camera.principal_u_px'.*: if pixels are counted from 1, subtract 1"),
    ],
)
def test_cases_from_the_field(check, case, words):
    bag = CASES / f"{case}.mcap"
    with read_bag(bag) as recorded:
        text = recorded.attachments[SUITE_ATTACHMENT].decode()
    (line,) = check(text, bag)
    assert re.search(words, line), line
