"""``triangulate``: bags of several theodolites in, a table of positions out; messages for bad input.

The true positions and directions are computed by pyerfa's own routines (ship_testing.theodolite_stations).
"""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import ns_from_utc_text
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_testing.theodolite_stations import DIRECTION, buoy_direction, buoy_n, direction_message, triangulation_values
from theodolite_calib.commands.triangulate import COLUMNS, main

START_NS, PERIOD_NS = 1_767_225_600_000_000_000, 100_000_000
SIGMA = 3.0 * ARCSEC
TOPIC = "theodolite/target_direction"
INVALID = 3


def write(path: Path, number: int, phase_ns: int, seed: int, count: int = 20, noise: float = 1.0, turn: float = 0.0):
    """Write a bag with the directions of one theodolite, with new noise each time."""
    rng = np.random.default_rng(seed)
    with BagWriter(path) as writer:
        writer.add_topic(TOPIC, DIRECTION)
        for index in range(count):
            time_ns = START_NS + phase_ns + index * PERIOD_NS
            true_n = buoy_direction(number, (time_ns - START_NS) * 1e-9)
            turned_n = exp_rotation(noise * SIGMA * rng.standard_normal(3) + [0.0, turn, 0.0]) @ true_n
            changes = {"status": INVALID} if index == 3 else {}
            writer.write(TOPIC, direction_message(time_ns, turned_n, SIGMA, **changes), time_ns)


def describe_stations(folder: Path, *phases_ns: int, **changes) -> Path:
    values = triangulation_values(len(phases_ns))
    for number, phase_ns in enumerate(phases_ns):
        write(folder / f"t{number}.mcap", number, phase_ns, seed=number, **changes)
        values["stations"][f"t{number}"]["bag"] = f"t{number}.mcap"
    path = folder / "stations.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_positions_match_their_covariance(tmp_path: Path, capsys) -> None:
    # Stamps of all three are equal: nothing is interpolated, errors are independent from row to row.
    stations = describe_stations(tmp_path, 0, 0, 0, count=60)
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) in (0, 1)
    rows = table(tmp_path / "places.csv")
    assert tuple(rows[0]) == COLUMNS
    # At the stamp of the INVALID directions there is no position.
    assert len(rows) == 59
    squares = []
    for row in rows:
        since_s = 1e-9 * (ns_from_utc_text(row["utc"]) - START_NS)
        found = np.array([float(row[name]) for name in ("north_m", "up_m", "east_m")])
        north, up, east = (float(row[f"sigma_{name}_m"]) ** 2 for name in ("north", "up", "east"))
        en, eu, nu = (float(row[f"cov_{name}_m2"]) for name in ("east_north", "east_up", "north_up"))
        covariance = np.array([[north, nu, en], [nu, up, eu], [en, eu, east]])
        squares.append(float(normalized_error_squared(found - buoy_n(since_s), covariance)))
    low, high = mean_nees_band(len(squares), 3)
    assert low < np.mean(squares) < high


def test_directions_at_other_times_are_interpolated(tmp_path: Path) -> None:
    stations = describe_stations(tmp_path, 0, 37_000_000, -21_000_000, noise=0.0)
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 0
    rows = table(tmp_path / "places.csv")
    assert {row["stations"] for row in rows} >= {"t0 t1 t2"}
    for row in rows[1:3]:
        since_s = 1e-9 * (ns_from_utc_text(row["utc"]) - START_NS)
        found = np.array([float(row[name]) for name in ("north_m", "up_m", "east_m")])
        np.testing.assert_allclose(found, buoy_n(since_s), atol=0.02)


def test_next_theodolite_leads_if_the_first_has_no_direction(tmp_path: Path) -> None:
    stations = describe_stations(tmp_path, 0, 20_000_000, 40_000_000, noise=0.0)
    write(tmp_path / "t0.mcap.new", 0, 0, seed=0, count=8, noise=0.0)
    (tmp_path / "t0.mcap.new").replace(tmp_path / "t0.mcap")
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 0
    rows = table(tmp_path / "places.csv")
    leaders = [(row["stations"], (ns_from_utc_text(row["utc"]) - START_NS) % PERIOD_NS) for row in rows]
    # Of the eight directions of the first theodolite, the first is before all others and that at 0.3 s is INVALID.
    # Nothing is interpolated across INVALID directions: of the first theodolite at 0.22 s, of the others at 0.4 s.
    first, next_two = ("t0 t1 t2", 0), ("t1 t2", 20_000_000)
    assert leaders[:6] == [first, first, next_two, first, first, first]
    assert set(leaders[6:]) == {next_two}
    assert len(leaders) > 15


def test_inconsistent_directions_are_reported(tmp_path: Path, capsys) -> None:
    stations = describe_stations(tmp_path, 0, 0, 0, noise=0.0)
    write(tmp_path / "t1.mcap.new", 1, 0, seed=9, noise=0.0, turn=0.01)
    (tmp_path / "t1.mcap.new").replace(tmp_path / "t1.mcap")
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 1
    rows = table(tmp_path / "places.csv")
    assert {row["fits"] for row in rows} == {"0"}
    assert "inconsistent directions" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "target", "named"),
    [
        ({}, "ship", "no direction of target 'ship' (other targets: buoy)"),
        ({"topic": "west/target_direction"}, "buoy", f"of that type it has: {TOPIC}"),
        ({"latitude_deg": 95.0}, "buoy", "stations.t0.latitude_deg"),
        ({"bag": "gone.mcap"}, "buoy", "gone.mcap"),
        ({"height": 1.0}, "buoy", "stations.t0.height"),
    ],
)
def test_bad_input_is_named(tmp_path: Path, capsys, change: dict, target: str, named: str) -> None:
    stations = describe_stations(tmp_path, 0, 0)
    values = yaml.safe_load(stations.read_text())
    values["stations"]["t0"] |= change
    stations.write_text(yaml.safe_dump(values))
    assert main([str(stations), "--target", target, "--out", str(tmp_path / "places.csv")]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "places.csv").exists()


def test_one_theodolite_gives_no_place(tmp_path: Path, capsys) -> None:
    stations = describe_stations(tmp_path, 0)
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 2
    assert "two theodolites or more" in capsys.readouterr().err


def test_unknown_distance_is_reported(tmp_path: Path, capsys) -> None:
    """The theodolites' own positions are known to a kilometre: the distance of a buoy at two kilometres is unknown."""
    path = describe_stations(tmp_path, 0, 0)
    values = yaml.safe_load(path.read_text())
    for station in values["stations"].values():
        station["sigma_m"] = 1000.0
    path.write_text(yaml.safe_dump(values))
    assert main([str(path), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 2
    error = capsys.readouterr().err
    assert "the first one because the distance from t0" in error
    assert "set the theodolites further apart" in error
    assert not (tmp_path / "places.csv").exists()
