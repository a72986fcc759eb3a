"""``triangulate``: bags of several theodolites in, a table of places out; what is wrong with the input is named.

The true places and directions are made by pyerfa's own routines (ship_testing.theodolite_stations).
"""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header, ns_from_utc_text
from ship_estimation.gates import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_testing.theodolite_stations import AIR, AXES, ORIGIN, ORIGIN_M, seen, station
from theodolite_calib.triangulation.triangulate_command import COLUMNS, main

FACTORY = RosbagsFactory()
START_NS, PERIOD_NS = 1_767_225_600_000_000_000, 100_000_000
SIGMA = 3.0 * ARCSEC
DIRECTION = "ship_msgs/msg/TargetDirection"
TOPIC = "theodolite/target_direction"
VALID, INVALID = 0, 3


def target_n(since_s: float) -> np.ndarray:
    """A buoy that drifts with 2 m/s, 2 km away: (North, Up, East) from the origin."""
    return np.array([2000.0 + 2.0 * since_s, 3.0, -400.0 + 1.0 * since_s])


def write(path: Path, number: int, phase_ns: int, seed: int, count: int = 20, noise: float = 1.0, turn: float = 0.0):
    """A bag with what one of the theodolites sees, its noise being new each time."""
    at, rng = station(f"t{number}", np.array([50.0 * number, 0.0, 0.0])), np.random.default_rng(seed)
    with BagWriter(path) as writer:
        writer.add_topic(TOPIC, DIRECTION)
        for index in range(count):
            time_ns = START_NS + phase_ns + index * PERIOD_NS
            foot_m = ORIGIN_M + np.array([50.0 * number, 0.0, 0.0]) @ AXES
            true_n = seen(at, foot_m, ORIGIN_M + target_n((time_ns - START_NS) * 1e-9) @ AXES, AIR.coefficient)
            turned_n = exp_rotation(noise * SIGMA * rng.standard_normal(3) + [0.0, turn, 0.0]) @ true_n
            across = SIGMA**2 * (np.eye(3) - np.outer(turned_n, turned_n))
            enu = [2, 0, 1]
            east, north, up = turned_n[enu]
            message = FACTORY.make(
                DIRECTION,
                header=make_header(FACTORY, time_ns, "horizon"),
                target_id="buoy",
                azimuth=float(np.arctan2(east, north)),
                elevation=float(np.arcsin(up)),
                covariance=np.full(4, np.nan),
                direction=FACTORY.make("geometry_msgs/msg/Vector3", x=east, y=north, z=up),
                position=FACTORY.make("geometry_msgs/msg/Vector3", x=np.nan, y=np.nan, z=np.nan),
                position_covariance=np.full(9, np.nan),
                direction_covariance=across[np.ix_(enu, enu)].ravel(),
                status=INVALID if index == 3 else VALID,
            )
            writer.write(TOPIC, message, time_ns)
    return at


def described(folder: Path, *phases_ns: int, **changes) -> Path:
    stations = {}
    for number, phase_ns in enumerate(phases_ns):
        at = write(folder / f"t{number}.mcap", number, phase_ns, seed=number, **changes)
        stations[at.name] = {
            "bag": f"t{number}.mcap",
            "latitude_deg": float(np.rad2deg(at.place.latitude)),
            "longitude_deg": float(np.rad2deg(at.place.longitude)),
            "height_m": at.place.height_m,
            "sigma_m": 0.0,
        }
    origin = {
        "latitude_deg": float(np.rad2deg(ORIGIN.latitude)),
        "longitude_deg": float(np.rad2deg(ORIGIN.longitude)),
        "height_m": ORIGIN.height_m,
    }
    described = {"origin": origin, "stations": stations, "refraction": {"coefficient": AIR.coefficient, "sigma": 0.0}}
    path = folder / "stations.yaml"
    path.write_text(yaml.safe_dump(described))
    return path


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_places_are_as_good_as_their_covariance_says(tmp_path: Path, capsys) -> None:
    # Stamps of all three are alike: nothing is interpolated, errors are independent from row to row.
    stations = described(tmp_path, 0, 0, 0, count=60)
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) in (0, 1)
    rows = table(tmp_path / "places.csv")
    assert tuple(rows[0]) == COLUMNS
    # At the stamp at which they claim nothing there is no place.
    assert len(rows) == 59
    squares = []
    for row in rows:
        since_s = 1e-9 * (ns_from_utc_text(row["utc"]) - START_NS)
        found = np.array([float(row[name]) for name in ("north_m", "up_m", "east_m")])
        north, up, east = (float(row[f"sigma_{name}_m"]) ** 2 for name in ("north", "up", "east"))
        en, eu, nu = (float(row[f"cov_{name}_m2"]) for name in ("east_north", "east_up", "north_up"))
        covariance = np.array([[north, nu, en], [nu, up, eu], [en, eu, east]])
        squares.append(float(normalized_error_squared(found - target_n(since_s), covariance)))
    low, high = mean_nees_band(len(squares), 3)
    assert low < np.mean(squares) < high


def test_theodolites_that_expose_at_other_moments_are_brought_together(tmp_path: Path) -> None:
    stations = described(tmp_path, 0, 37_000_000, -21_000_000, noise=0.0)
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 0
    rows = table(tmp_path / "places.csv")
    assert {row["stations"] for row in rows} >= {"t0 t1 t2"}
    for row in rows[1:3]:
        since_s = 1e-9 * (ns_from_utc_text(row["utc"]) - START_NS)
        found = np.array([float(row[name]) for name in ("north_m", "up_m", "east_m")])
        np.testing.assert_allclose(found, target_n(since_s), atol=0.02)


def test_directions_that_do_not_fit_one_another_are_told(tmp_path: Path, capsys) -> None:
    stations = described(tmp_path, 0, 0, 0, noise=0.0)
    write(tmp_path / "t1.mcap.new", 1, 0, seed=9, noise=0.0, turn=0.01)
    (tmp_path / "t1.mcap.new").replace(tmp_path / "t1.mcap")
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 1
    rows = table(tmp_path / "places.csv")
    assert {row["fits"] for row in rows} == {"0"}
    assert "do not fit" in capsys.readouterr().out


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
def test_what_is_wrong_is_named(tmp_path: Path, capsys, change: dict, target: str, named: str) -> None:
    stations = described(tmp_path, 0, 0)
    values = yaml.safe_load(stations.read_text())
    values["stations"]["t0"] |= change
    stations.write_text(yaml.safe_dump(values))
    assert main([str(stations), "--target", target, "--out", str(tmp_path / "places.csv")]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "places.csv").exists()


def test_one_theodolite_gives_no_place(tmp_path: Path, capsys) -> None:
    stations = described(tmp_path, 0)
    assert main([str(stations), "--target", "buoy", "--out", str(tmp_path / "places.csv")]) == 2
    assert "two theodolites or more" in capsys.readouterr().err
