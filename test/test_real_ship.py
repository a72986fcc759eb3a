"""A real ship: two Seapath systems of cruise NBP1406, one used as INS, the other as reference.

Expected values: models.md §4, "Real case", determined by hand with a spline fit, independently of this project.
"""

from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from ship_bags.commands.import_nmea import main as import_nmea
from ship_bags.mcap.bag_reader import read_bag
from ship_estimation.innovations.gates import mean_nees_band
from ship_estimation.rejection_rules import Rejection
from ship_replay.commands.replay import main as replay
from ship_simulation.scenario.scenario_file import load_scenario
from ship_stars.attitude_samples import AirReading, SkyInput
from ship_stars.messages.surroundings_messages import position_fix
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.surroundings import Surroundings
from ship_testing.consistency import sigma_ratio_band
from ship_testing.trials.monte_carlo import final_error

ROOT = Path(__file__).parents[1]
LOGS = ROOT.parent / "shared" / "data" / "nbp1406"
CONFIG = ROOT / "examples" / "nbp1406.yaml"
SETTLING_S = 120.0
SEEDS = 12

pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason=f"the ship's records are not here: {LOGS}")


def import_ship(tmp_path: Path, time: str) -> Path:
    """Return a bag with Seapath `seap` as INS, resampled to 20 Hz, and Seapath `s330` as reference."""
    bag = tmp_path / f"{time}.mcap"
    arguments = ["--ins", str(LOGS / "NBP1406_seap-2014-08-01")]
    arguments += ["--reference", f"s330={LOGS / 'NBP1406_s330-2014-08-01'}", "--resample", "20"]
    assert import_nmea([*arguments, "--time", time, "--out", str(bag)]) == 0
    return bag


@pytest.mark.slow
@pytest.mark.parametrize(("time", "offset_s"), [("instrument", 0.012), ("receive", 0.110)])
def test_clocks_and_installation_of_two_systems_are_estimated(tmp_path: Path, time: str, offset_s: float) -> None:
    fused = tmp_path / "fused.mcap"
    assert replay([str(import_ship(tmp_path, time)), "--out", str(fused), "--config", str(CONFIG)]) == 0
    with read_bag(fused) as bag:
        alignment = [record.decode() for record in bag.records(topics=["ship/alignment"])][-1]
        innovations = [record.decode() for record in bag.records(topics=["ship/innovation"])]
    values = dict(zip(alignment.names, alignment.values, strict=True))
    assert values["reference.s330.time_offset"] == pytest.approx(offset_s, abs=0.005)
    installation_deg = np.rad2deg([values[f"reference.s330.{name}"] for name in ("roll", "pitch", "heading")])
    assert installation_deg == pytest.approx([-0.225, -0.039, -0.823], abs=0.005)

    used = [m for m in innovations if m.accepted]
    stamps_s = np.array([m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in used])
    residuals_deg = np.rad2deg([m.residual for m in used])[stamps_s > stamps_s[0] + SETTLING_S]
    roll, heading, pitch = np.std(residuals_deg, axis=0)  # about forward, up, right
    assert roll <= 0.025
    assert pitch <= 0.054
    assert heading <= 0.039


def rejection_reasons(given: Iterable[SkyInput]) -> list[Rejection | None]:
    """Return the rejections of consecutive fixes or weather readings."""
    surroundings, reasons = Surroundings(SkyConfig()), []
    for one in given:
        reasons.append(surroundings.rejection(one))
        surroundings.insert(one)
    return reasons


def test_the_position_of_a_sailing_ship_is_not_rejected(tmp_path: Path) -> None:
    with read_bag(import_ship(tmp_path, "instrument")) as bag:
        records = list(bag.records(topics=["gnss/fix"]))
    fixes = [position_fix(record.decode(), SkyConfig(), record.log_time_ns).value for record in records]
    assert rejection_reasons(fixes) == [None] * 715


def test_the_weather_is_not_rejected() -> None:
    readings: list[SkyInput] = []
    for line in (LOGS / "NBP1406_mwx1-2014-08-01").read_text().splitlines():
        when, _, sentence = line.partition(" ")
        fields = sentence.split(",")
        if fields[0] == "MET":
            time_ns = round(datetime.fromisoformat(when.replace("Z", "+00:00")).timestamp() * 1e9)
            readings.append(AirReading("temperature", time_ns, float(fields[3])))
            readings.append(AirReading("pressure", time_ns, float(fields[-1])))
    assert rejection_reasons(readings) == [None] * 2 * 1667


def test_errors_fit_their_covariance_on_recorded_motion(tmp_path: Path) -> None:
    """Each seed gives one error; the bands contain 99.9 %. ``tools/campaign.py recorded`` runs more seeds."""
    bag = import_ship(tmp_path, "instrument")
    whole = load_scenario(ROOT / "bags" / "scenarios" / "recorded.yaml", recording=bag)
    scenario = replace(whole, duration_s=60.0, ins=replace(whole.ins, rate_hz=20.0))
    results = [final_error(scenario, seed) for seed in range(SEEDS)]
    low, high = mean_nees_band(SEEDS, degrees=3)
    assert low <= np.mean([result.nees for result in results]) <= high
    low, high = sigma_ratio_band(SEEDS)
    rms = np.sqrt(np.mean([(result.angles / result.sigma) ** 2 for result in results], axis=0))
    assert np.all((low <= rms) & (rms <= high)), rms
