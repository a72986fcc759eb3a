"""Axis errors fitted from a bag with lights, compared with those of its simulation."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.offline.adapter_chain import suite_text
from ship_replay.offline.replay import replay
from ship_studies.axis_fit import fit_axes_command
from ship_studies.axis_fit.axis_sightings_command import AxisSighting, AxisSightings, axis_sightings, main
from ship_studies.axis_fit.sightings import read_sightings
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

BAGS = Path(__file__).parents[3] / "bags"


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("sightings") / "sightings.csv"
    assert main([str(BAGS / "theodolite.mcap"), "--out", str(path)]) == 0
    return path


def true_axes() -> dict[str, float]:
    """Return the axis errors of the simulation, rad."""
    with read_bag(BAGS / "theodolite.mcap") as bag:
        name = next(topic for topic in bag.topics if topic.endswith("truth/calibration"))
        message = next(iter(bag.records({name}))).decode()
    return dict(zip(message.names, message.values, strict=True))


@pytest.fixture(scope="module")
def fit_folder(table, tmp_path_factory):
    """Return a folder with a fit that includes flexure, because the scenario bends the tube."""
    folder = tmp_path_factory.mktemp("fit")
    assert fit_axes_command.main([str(table), "--out", str(folder), "--flexure"]) == 0
    return folder


@pytest.mark.statistics
def test_fitted_axis_errors_are_within_their_sigmas(table, fit_folder):
    """Sightings contain a deck deformation of 45″. Treated as noise, it would shift βx by 57″ at a sigma of 0.8″."""
    assert len(read_sightings(table).labels) > 100
    document = yaml.safe_load((fit_folder / "axes.yaml").read_text(encoding="utf-8"))
    true = true_axes()
    error_arcsec = np.array([document["values_arcsec"][name] - true[name] / ARCSEC for name in NAMES])
    assert document["covariance_of"] == list(NAMES)
    covariance = np.array(document["covariance_rad2"]) / ARCSEC**2
    sigma_arcsec = np.sqrt(np.diagonal(covariance))
    assert np.all(np.abs(error_arcsec) < 3.0 * sigma_arcsec), error_arcsec / sigma_arcsec
    # 99.9 % of chi square with seven degrees of freedom.
    assert error_arcsec @ np.linalg.solve(covariance, error_arcsec) < 24.3
    # The sigma is limited because a deck rotation of 20″ and the theodolite's tilt cannot be separated.
    assert 15.0 < sigma_arcsec[NAMES.index("beta_x")] < 25.0


@pytest.mark.slow
def test_node_loads_the_fit_from_its_calibration_file(fit_folder, tmp_path):
    """Pointings from encoders and fitted axis errors alone have RMS errors below 2.6 sigmas."""
    with read_bag(BAGS / "theodolite.mcap") as bag:
        suite = yaml.safe_load(suite_text(bag, None))
    sections = [section for name, section in suite.items() if name.endswith("optical_axis")]
    sections[0]["ros__parameters"]["calibration_file"] = str(fit_folder / "calibration.yaml")
    config, out = tmp_path / "suite.yaml", tmp_path / "out.mcap"
    config.write_text(yaml.safe_dump(suite))

    def without_lights(records, bag):
        return (record for record in records if not record.topic.endswith("theodolite/beacons"))

    replay(BAGS / "theodolite.mcap", out, (OpticalAxisAdapter,), config, progress=without_lights)
    values = evaluate(out, against=BAGS / "theodolite.mcap", skip_s=1.0).quantities()
    assert values["pointing.encoder.nees_mean"] < 11.3
    # Without any calibration the elevation is off by 27″ and the sigma is 40″.
    assert values["pointing.encoder.elevation.sigma_arcsec"] < 35.0
    assert values["pointing.encoder.elevation.rms_over_sigma"] < 2.6
    assert values["pointing.encoder.azimuth_cos_elevation.rms_over_sigma"] < 2.6


def test_number_of_rows_is_limited_to_that_of_a_fit(tmp_path):
    sightings = AxisSightings()
    hull = {("hull.1", 600.0): np.array([1e-5, 2e-5]), ("nothing.1", 600.0): np.zeros(2)}
    for number in range(2500):
        sightings.rows[number * 10**9 + 7] = AxisSighting((0.1 * number, 30.0, 0.01, 0.01), hull)
    sightings.write(tmp_path / "s.csv")
    read = read_sightings(tmp_path / "s.csv")
    assert len(read.labels) == 1000
    assert (read.time_s[0], read.time_s[-1]) == (7e-9, 2499.000000007)
    assert np.ptp(np.diff(read.time_s)) <= 1.0 + 1e-6
    (slow,) = read.correlated_errors
    assert (slow.name, slow.time_s) == ("hull.1", 600.0)
    np.testing.assert_allclose(slow.effect[0], [1e-5, 2e-5], atol=1e-9)


@pytest.mark.slow
def test_the_same_bag_gives_the_same_table(table, tmp_path):
    again = tmp_path / "again.csv"
    axis_sightings(BAGS / "theodolite.mcap").write(again)
    assert again.read_bytes() == table.read_bytes()


@pytest.mark.parametrize(
    ("bag", "out", "expected"),
    [("theodolite.mcap", "table.txt", "fit_axes reads .csv"), ("demo.mcap", "table.csv", "optical_axis")],
)
def test_bad_input_is_one_line(bag, out, expected, tmp_path, capsys):
    assert main([str(BAGS / bag), "--out", str(tmp_path / out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line
