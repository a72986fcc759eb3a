"""Simulated bags of the theodolite replayed through the nodes: faults are named, and no wrong output is VALID."""

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import ns_from_stamp
from ship_geometry.rotations import ARCSEC
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.evaluation.sources import Truth
from ship_replay.evaluation.statistics import reason_name
from ship_replay.offline.replay import ADAPTERS, replay
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario import Fault, FusedAttitude, Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
from ship_testing.theodolite_scenes import bag_scenario, replace_nested
from ship_watch.orientations import POINTING

ROOT = Path(__file__).parents[1]

START_S, END_S = 6.0, 10.0
IMAGE, ENCODER, BASELINE = "theodolite/beacons", "theodolite/encoder", "beacon/a/baseline"
VALID = 0


def with_fault(topic: str, kind: str, **changes: float) -> Scenario:
    fault = Fault(topic=topic, kind=kind, start_s=START_S, end_s=END_S, **changes)
    return bag_scenario(duration_s=14.0, faults={"fault": fault})


def with_windows(name: str) -> Scenario:
    scenario = bag_scenario(duration_s=14.0)
    a = replace_nested(scenario.beacons["a"], **{f"rtk__{name}": {"x": Outage(START_S, END_S)}})
    return dataclasses.replace(scenario, beacons={**scenario.beacons, "a": a})


def replay_scenario(scenario: Scenario, folder: Path, seed: int = 1) -> tuple[Path, dict[str, dict[str, int]]]:
    """Return the replayed bag, and the rejections and notes by topic and reason."""
    write_bag(scenario, seed, folder / "in.mcap", b"")
    summary = replay(folder / "in.mcap", folder / "out.mcap", ADAPTERS)
    assert summary.problems == []
    topics = {*summary.rejected, *summary.accepted_with_note}
    return folder / "out.mcap", {t: summary.rejected.get(t, {}) | summary.accepted_with_note.get(t, {}) for t in topics}


def worst_valid_sigmas(path: Path) -> float:
    """Return the largest error of a VALID pointing, in standard deviations of its channel."""
    truth, worst = Truth(POINTING), 0.0
    with read_bag(path) as bag:
        for record in bag.records({POINTING.truth_topic}):
            truth.add(record.decode())
        for record in bag.records({POINTING.topic}):
            message = record.decode()
            truth_nm = truth.rotation_at_stamp(ns_from_stamp(message.header.stamp))
            if message.status == VALID and truth_nm is not None:
                angles = POINTING.angles_of(message)
                sigma_arcsec = np.sqrt(np.diag(message.covariance.reshape(3, 3))) / ARCSEC
                errors = POINTING.errors_arcsec(angles, truth_nm) / (POINTING.scale(angles) * sigma_arcsec)
                worst = max(worst, float(np.abs(errors).max()))
    return worst


def reasons(path: Path) -> set[str]:
    """Return the names of all reasons in theodolite/innovation but NONE."""
    with read_bag(path) as bag:
        found = Counter(reason_name(record.decode()) for record in bag.records({"theodolite/innovation"}))
    return set(found) - {"none"}


CASES = {
    "lights swapped": (with_fault(IMAGE, "swap"), IMAGE, "light_conflict"),
    "an unknown light": (with_fault(IMAGE, "wrong_id"), IMAGE, "unknown_sensor"),
    "another drone's baseline": (with_fault(BASELINE, "wrong_id"), BASELINE, "unknown_sensor"),
    "a baseline stamped 1 s late": (with_fault(BASELINE, "stamp_late", delay_s=1.0), BASELINE, "future"),
    "FLOAT": (with_windows("float_times"), BASELINE, "not_fixed"),
    "no solution": (with_windows("no_solution_times"), BASELINE, "not_fixed"),
    "no baselines": (with_windows("outages"), IMAGE, "gap"),
    "encoder stuck": (with_fault(ENCODER, "freeze"), ENCODER, "stuck"),
    "encoder in degrees": (with_fault(ENCODER, "angles_in_degrees"), ENCODER, "units"),
    "encoder not a number": (with_fault(ENCODER, "nan"), ENCODER, "non_finite"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_fault_has_its_reason_and_no_wrong_pointing_is_valid(case, tmp_path):
    scenario, topic, reason = CASES[case]
    path, rejected = replay_scenario(scenario, tmp_path)
    assert rejected[topic][reason] > 5
    assert reason in reasons(path)
    # The limit is for the largest error of 700 pointings with three correlated channels.
    assert worst_valid_sigmas(path) < 4.5


@pytest.mark.parametrize("scenario", [with_fault(IMAGE, "hide"), with_fault(BASELINE, "delay", delay_s=1.0)])
def test_a_hidden_light_and_late_baselines_cause_no_rejection(scenario, tmp_path):
    path, rejected = replay_scenario(scenario, tmp_path)
    # Exposures wait for their baselines; the last baselines never arrive.
    assert set(rejected.get(IMAGE, {})) <= {"gap", "revised"}
    assert worst_valid_sigmas(path) < 4.5
    assert evaluate(path).quantities()["pointing.invalid"] == 0


def test_stars_ins_and_lights_in_one_replay(tmp_path):
    paper = load_scenario(ROOT / "bags" / "scenarios" / "paper.yaml")
    scenario = bag_scenario(
        duration_s=20.0,
        ins=dataclasses.replace(paper.ins, rate_hz=50.0),
        star_sensors=paper.star_sensors,
        fused_attitude=FusedAttitude(),
    )
    path, rejected = replay_scenario(scenario, tmp_path)
    assert rejected == {}
    values = evaluate(path, skip_s=5.0).quantities()
    assert values["fused.heading.rms_arcsec"] < 15.0
    assert values["pointing.two_lights.samples"] == values["pointing.samples"] == 151
    # 99.9 % of chi square with three degrees of freedom, for errors that hardly change in fifteen seconds.
    assert values["pointing.nees_mean"] < 16.3
    assert values["pointing.elevation.rms_arcsec"] < 15.0
    with read_bag(path) as bag:
        errors = [record.decode() for record in bag.records({POINTING.error_topic})]
    assert len(errors) >= 19
    # The first attitude of the ship comes with its second INS sample or later.
    filled = [error for error in errors if np.isfinite(error.error_elevation)]
    assert len(filled) >= len(errors) - 1
    assert abs(filled[-1].error_elevation) < 4.5 * filled[-1].sigma_elevation
