"""A mast in the field of a star sensor, from the scenario through the suite file of its bag to both nodes' outputs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.replay import main as replay
from ship_simulation.simulate_command import main as simulate

PAPER_STARS = Path(__file__).parents[1] / "bags" / "scenarios" / "paper_stars.yaml"
MAST = {"azimuths_deg": [-20.0, -1.0, -1.0, -20.0], "elevations_deg": [0.0, 0.0, 80.0, 80.0]}
VALID = 0


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a replayed voyage of six seconds, with a mast in the field of ``fore``.

    The stars are unidentified, and each exposure has about six false stars.
    """
    folder = tmp_path_factory.mktemp("run")
    voyage = yaml.safe_load(PAPER_STARS.read_text(encoding="utf-8"))
    voyage["duration_s"], voyage["ins"]["rate_hz"] = 6.0, 20.0
    for sensor in voyage["star_sensors"].values():
        sensor.update(identified=False, false_stars=6.0, rate_hz=2.0)
    voyage["star_sensors"]["fore"]["masks"] = {"mast": MAST}
    (folder / "voyage.yaml").write_text(yaml.safe_dump(voyage), encoding="utf-8")
    assert simulate([str(folder / "voyage.yaml"), "--out", str(folder / "in.mcap"), "--seed", "3"]) == 0
    assert replay([str(folder / "in.mcap"), "--out", str(folder / "out.mcap")]) == 0
    return folder


def messages(path: Path, topic: str) -> list[Any]:
    with read_bag(path) as bag:
        return [record.decode() for record in bag.records([topic])]


def in_the_mast(stars: list[Any]) -> int:
    """Return the number of pixels (u, v) of the sensor ``fore`` in the rectangle of the mast."""
    pixels = np.array([[star.u, star.v] for star in stars]) - 1023.5
    seen_s = np.stack([np.full(len(pixels), 0.05 / 5.5e-6), -pixels[:, 1], pixels[:, 0]], axis=-1)
    bow, _, starboard = (seen_s @ rotation_from_angles(0.0, np.deg2rad(45.0), 0.0).T).T
    azimuth_deg = np.rad2deg(np.arctan2(starboard, bow))
    return int(np.count_nonzero((azimuth_deg > -20.0) & (azimuth_deg < -1.0)))


def test_every_detection_on_the_mast_is_rejected_with_its_reason(run_folder: Path) -> None:
    spots = sum(in_the_mast(message.stars) for message in messages(run_folder / "in.mcap", "star/fore/observations"))
    rejections = [
        m for m in messages(run_folder / "out.mcap", "star/innovation") if "inside the mask mast" in m.reason_text
    ]
    assert 10 < spots == len(rejections)
    assert {message.source for message in rejections} == {"star.fore"}
    assert {message.reason for message in rejections} == {Reason.UNIDENTIFIED.value}


def test_the_attitude_stays_valid_by_the_stars_outside_the_mast(run_folder: Path) -> None:
    assert messages(run_folder / "out.mcap", "ship/attitude")[-1].status == VALID
    assert sum(m.status == VALID for m in messages(run_folder / "out.mcap", "star/fore/solution")) > 6


def test_different_masks_of_the_nodes_are_an_error(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with read_bag(run_folder / "in.mcap") as bag:
        suite = bag.attachments[SUITE_ATTACHMENT].decode()
    sections = yaml.safe_load(suite)
    assert all(
        section["ros__parameters"]["star_sensors"]["fore"]["masks"] == {"mast": MAST} for section in sections.values()
    )
    (name,) = (name for name in sections if name.endswith("star_attitude"))
    sections[name]["ros__parameters"]["star_sensors"]["fore"]["masks"]["mast"]["azimuths_deg"][0] = -25.0
    (run_folder / "suite.yaml").write_text(yaml.safe_dump(sections), encoding="utf-8")
    check_config([str(run_folder / "suite.yaml")])
    assert "parameter 'star_sensors.fore.masks'" in capsys.readouterr().out
