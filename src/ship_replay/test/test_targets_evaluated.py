"""Errors of targets against the truth by hand: across the direction, in position, target by target."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_geometry.rotations import ARCSEC
from ship_replay.commands.evaluate import main
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.evaluation.targets import TARGET_DIRECTION, TARGET_TRUTH

FACTORY = RosbagsFactory()
START_NS, SECOND_NS = 1_767_225_600_000_000_000, 1_000_000_000
SIGMA, SIGMA_M, NORTH_M = 2.0 * ARCSEC, 3.0, 1000.0


def target_direction(
    number: int,
    east_arcsec: float = 0.0,
    up_arcsec: float = 0.0,
    off_m: float = 0.0,
    target_id: str = "buoy",
    **changes: Any,
) -> Any:
    """Return a published target in the north with errors of direction and position; the axes are East, North, Up."""
    direction = np.array([east_arcsec * ARCSEC, 1.0, up_arcsec * ARCSEC])
    fields = {
        "header": make_header(FACTORY, START_NS + number * SECOND_NS, "horizon"),
        "target_id": target_id,
        "azimuth": 0.0,
        "elevation": 0.0,
        "covariance": np.zeros(4),
        "direction": FACTORY.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", direction.tolist(), strict=True))),
        "direction_covariance": np.diag([SIGMA**2, 0.0, SIGMA**2]).ravel(),
        "position": FACTORY.make("geometry_msgs/msg/Vector3", x=0.0, y=NORTH_M + off_m, z=0.0),
        "position_covariance": (SIGMA_M**2 * np.eye(3)).ravel(),
        "status": 0,
    }
    return FACTORY.make("ship_msgs/msg/TargetDirection", **{**fields, **changes})


@pytest.fixture(name="bag")
def _bag(tmp_path: Path) -> Path:
    unknown = FACTORY.make("geometry_msgs/msg/Vector3", x=np.nan, y=np.nan, z=np.nan)
    no_place = {"position": unknown, "position_covariance": np.full(9, np.nan)}
    with BagWriter(tmp_path / "run.mcap") as bag:
        for number in range(4):
            for target_id in ("buoy", "kite"):
                bag.write(TARGET_TRUTH, target_direction(number, target_id=target_id), START_NS + number * SECOND_NS)
        published = [
            target_direction(0, 4.0, 0.0, 6.0),
            target_direction(1, 0.0, 2.0, **no_place),
            target_direction(2, 100.0, status=3),
            target_direction(9, 100.0),
            target_direction(3, 1.0, 1.0, 3.0, target_id="kite"),
        ]
        for number, message in enumerate(published):
            bag.write(TARGET_DIRECTION, message, START_NS + number * SECOND_NS)
        bag.write("theodolite/calibration", calibration(), START_NS + 5 * SECOND_NS)
    return tmp_path / "run.mcap"


def calibration() -> Any:
    empty = {"names": ["c"], "values": np.zeros(1), "covariance": np.zeros(1), "units": ["rad"], "unobservable": []}
    header = make_header(FACTORY, START_NS, "theodolite_base")
    kind = "ship_msgs/msg/TheodoliteCalibration"
    return FACTORY.make(kind, header=header, sighting_count=0, residual_rms=float("nan"), **empty)


def test_errors_are_those_by_hand(bag: Path) -> None:
    values = evaluate(bag).quantities()
    expected = {
        "target.buoy.samples": 2,
        # INVALID at 2 s, and no answer at 3 s.
        "target.buoy.not_claimed": 2,
        # 4" and 0" east, 0" and 2" up: per axis the root of (16 + 4) / 4.
        "target.buoy.direction.rms_arcsec": np.sqrt(5.0),
        "target.buoy.direction.sigma_arcsec": 2.0,
        "target.buoy.direction.nees_mean": 0.5 * (4.0 + 1.0),
        "target.buoy.position.samples": 1,
        "target.buoy.position.rms_m": 6.0,
        "target.buoy.position.sigma_m": 3.0 * np.sqrt(3.0),
        "target.buoy.position.nees_mean": 4.0,
        "target.kite.samples": 1,
        "target.kite.direction.rms_arcsec": 1.0,
        "target.kite.position.nees_mean": 1.0,
    }
    assert {name: values[name] for name in expected} == pytest.approx(expected, rel=1e-6)


def test_what_is_skipped_is_left_out_with_its_target(bag: Path) -> None:
    values = evaluate(bag, skip_s=1.5).quantities()
    # No valid direction of the buoy was published after 1.5 s: the buoy is listed without statistics.
    assert (values["target.buoy.samples"], values["target.buoy.not_claimed"]) == (0, 2)
    assert "target.buoy.direction.rms_arcsec" not in values
    assert (values["target.kite.samples"], values["target.kite.not_claimed"]) == (1, 1)


def test_the_command_shows_them_in_a_table_and_in_json(bag: Path, tmp_path: Path, capsys) -> None:
    assert main([str(bag), "--json", str(tmp_path / "values.json")]) == 0
    shown = capsys.readouterr().out
    assert "Targets against the truth" in shown
    assert [line.split("│")[1].strip() for line in shown.splitlines() if line.startswith("│ ")][:2] == ["buoy", "kite"]
    assert json.loads((tmp_path / "values.json").read_text())["target.buoy.position.rms_m"] == pytest.approx(6.0)


def test_without_truth_there_are_none(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run.mcap") as bag:
        bag.write(TARGET_DIRECTION, target_direction(0), START_NS)
        bag.write("theodolite/calibration", calibration(), START_NS)
    assert not any(name.startswith("target.") for name in evaluate(tmp_path / "run.mcap").quantities())


def vector3(x: float, y: float, z: float) -> Any:
    return FACTORY.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"direction": vector3(np.inf, 1.0, 0.0)}, "non_finite: direction holds inf"),
        ({"direction": vector3(np.nan, 1.0, 0.0)}, "non_finite: direction holds nan"),
        ({"direction_covariance": np.full(9, np.inf)}, "non_finite: direction_covariance holds NaN or infinity"),
        ({"direction_covariance": -2.0 * np.eye(3).ravel()}, "bad_covariance: direction_covariance holds a negative"),
        ({"position": vector3(0.0, -np.inf, 0.0)}, "non_finite: position holds -inf"),
        ({"position_covariance": np.diag([1.0, -1.0, 1.0]).ravel()}, "bad_covariance: position_covariance holds a"),
    ],
)
def test_a_direction_of_wrong_form_is_left_out_by_name(tmp_path: Path, changes: dict[str, Any], text: str) -> None:
    found = []
    for name, bad in (("without", {}), ("with", {3: target_direction(3, **changes)})):
        with BagWriter(tmp_path / f"{name}.mcap") as bag:
            for number in range(4):
                bag.write(TARGET_TRUTH, target_direction(number), START_NS + number * SECOND_NS)
            for number, message in enumerate(
                [target_direction(0, 4.0), target_direction(1, 0.0, 2.0), target_direction(2, 1.0)]
            ):
                bag.write(TARGET_DIRECTION, message, START_NS + number * SECOND_NS)
            for number, message in bad.items():
                bag.write(TARGET_DIRECTION, message, START_NS + number * SECOND_NS)
            bag.write("theodolite/calibration", calibration(), START_NS + 5 * SECOND_NS)
        found.append(evaluate(tmp_path / f"{name}.mcap"))
    without, with_it = found
    assert with_it.quantities() == without.quantities()
    (line,) = with_it.problems
    assert line.startswith(f"topic '{TARGET_DIRECTION}': messages excluded: 1, the first because {text}")


def test_a_truth_that_is_no_number_is_left_out_by_name(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run.mcap") as bag:
        bag.write(TARGET_TRUTH, target_direction(0), START_NS)
        bag.write(TARGET_TRUTH, target_direction(1, direction=vector3(np.inf, 0.0, 0.0)), START_NS + SECOND_NS)
        for number in range(2):
            bag.write(TARGET_DIRECTION, target_direction(number), START_NS + number * SECOND_NS)
        bag.write("theodolite/calibration", calibration(), START_NS + 5 * SECOND_NS)
    found = evaluate(tmp_path / "run.mcap")
    assert found.quantities()["target.buoy.samples"] == 1.0
    assert found.problems == [
        f"topic '{TARGET_TRUTH}': messages excluded: 1, the first because non_finite: direction of the truth holds inf"
    ]
