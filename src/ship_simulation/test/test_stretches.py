"""A voyage in stretches equals the whole voyage, to the last byte of its bag."""

import dataclasses
from pathlib import Path

import pytest

from ship_bags.message_store import RosbagsFactory, serialize
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate, simulate_stretches
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario_file import load_scenario

SCENARIOS = Path(__file__).resolve().parents[3] / "bags" / "scenarios"

FAULTS = {
    "again": Fault("gnss/fix", "duplicate", 1.0, 9.0),
    "crossed": Fault("star/bow/horizon_attitude", "conflict", 1.5, 6.5),
    "flooded": Fault("theodolite/encoder", "flood", 3.2, 5.0, times=3, spread_s=0.5),
    "held": Fault("beacon/a/imu", "freeze", 1.0, 5.0),
    "late": Fault("ins/imu", "delay", 1.0, 4.5, delay_s=3.0),
    "lost": Fault("beacon/b/baseline", "drop", 0.0, 1e6),
    "shuffled": Fault("reference/gyro/imu", "reorder", 0.0, 9.0, delay_s=2.5),
}


def scenario_with_everything(**changes):
    """Return a scenario with all devices, late and unordered messages, false stars, wrong identities and clouds."""
    found = load_scenario(SCENARIOS / "everything.yaml")
    stars = dict(found.star_sensors)
    stars["bow"] = dataclasses.replace(stars["bow"], jitter_s=1.3)
    stars["starboard"] = dataclasses.replace(
        stars["starboard"], false_stars=1.5, swapped_probability=0.4, exposure_s=0.05, jitter_s=0.5
    )
    stars["port"] = dataclasses.replace(stars["port"], outages={"clouds": Outage(0.0, 8.5)})
    ins = dataclasses.replace(found.ins, jitter_s=0.1, rate_bias_sigma_arcsec_per_s=1.0)
    fused = dataclasses.replace(found.fused_attitude, written=True, jitter_s=0.02)
    changes = {"duration_s": 11.3, "star_sensors": stars, "ins": ins, "fused_attitude": fused} | changes
    return dataclasses.replace(found, **changes)


def logged_messages(runs):
    return [(topic, serialize(message), log_ns) for topic, message, log_ns in generate_messages(runs, RosbagsFactory())]


@pytest.mark.parametrize("length_s", [2, 4, 6])
@pytest.mark.parametrize("faults", [{}, FAULTS], ids=["clean", "faults"])
def test_messages_do_not_depend_on_the_stretches(length_s, faults):
    scenario = scenario_with_everything(faults=faults)
    expected = logged_messages([simulate(scenario, 3)])
    assert [entry[2] for entry in expected] == sorted(entry[2] for entry in expected)
    assert logged_messages(simulate_stretches(scenario, 3, length_s)) == expected


def test_messages_of_a_sea_do_not_depend_on_the_stretches():
    scenario = dataclasses.replace(load_scenario(SCENARIOS / "sea_state_5.yaml"), duration_s=9.0)
    assert logged_messages(simulate_stretches(scenario, 3, 2)) == logged_messages([simulate(scenario, 3)])


def test_targets_and_stars_on_the_mount_do_not_depend_on_the_stretches():
    scenario = load_scenario(SCENARIOS / "theodolite_night.yaml")
    telescope = dataclasses.replace(scenario.telescopes["night"], jitter_s=1.3)
    scenario = dataclasses.replace(scenario, duration_s=7.0, telescopes={"night": telescope})
    assert logged_messages(simulate_stretches(scenario, 3, 2)) == logged_messages([simulate(scenario, 3)])


def test_a_rare_sample_is_the_last_of_the_truth_wherever_it_is():
    ins = dataclasses.replace(scenario_with_everything().ins, rate_hz=0.3)
    scenario = scenario_with_everything(ins=ins)
    assert logged_messages(simulate_stretches(scenario, 3, 2)) == logged_messages([simulate(scenario, 3)])


def test_a_stretch_contains_only_its_samples():
    sizes = [run.ins.time_ns.size for run in simulate_stretches(scenario_with_everything(), 3, 4)]
    assert sizes == [200, 200, 166]
