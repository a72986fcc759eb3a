"""From a bag with lights to the axis errors that the bag was made with."""

from pathlib import Path

import pytest
import yaml

from ship_replay.axis_sightings import axis_sightings
from ship_replay.axis_sightings_command import main
from ship_replay.bag_reader import read_bag
from theodolite_calib import fit_axes_command
from theodolite_calib.axis_fit.sighting_file import read_sightings

BAGS = Path(__file__).parents[3] / "bags"


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("sightings") / "sightings.csv"
    assert main([str(BAGS / "theodolite.mcap"), "--out", str(path)]) == 0
    return path


def true_axes() -> dict[str, float]:
    """What the bag was simulated with, rad."""
    with read_bag(BAGS / "theodolite.mcap") as bag:
        name = next(topic for topic in bag.topics if topic.endswith("truth/calibration"))
        message = next(iter(bag.records({name}))).decode()
    return dict(zip(message.names, message.values, strict=True))


def test_the_axis_errors_of_the_bag_come_out(table, tmp_path):
    """The deformation of the deck (20″) and the ship's own error are in the offsets too: they bound what is found."""
    sightings = read_sightings(table)
    assert len(sightings.labels) > 100
    assert fit_axes_command.main([str(table), "--out", str(tmp_path / "fit")]) == 0
    found = yaml.safe_load((tmp_path / "fit" / "axes.yaml").read_text(encoding="utf-8"))["values_arcsec"]
    true = true_axes()
    for name in ("c", "I"):
        # Collimation and trunnion tilt are nothing that a deformation could do.
        assert found[name] == pytest.approx(true[name] * 206_264.806, abs=15.0), name


def test_the_same_bag_gives_the_same_table(table, tmp_path):
    again = tmp_path / "again.csv"
    axis_sightings(BAGS / "theodolite.mcap").write(again)
    assert again.read_bytes() == table.read_bytes()


@pytest.mark.parametrize(
    ("bag", "out", "said"),
    [("theodolite.mcap", "table.txt", "fit_axes reads .csv"), ("demo.mcap", "table.csv", "optical_axis")],
)
def test_bad_input_is_one_line(bag, out, said, tmp_path, capsys):
    assert main([str(BAGS / bag), "--out", str(tmp_path / out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
