"""Two antennas aboard, from the simulator through a bag and the node's adapter to ship/attitude."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml

from ship_bags.mcap.bag_reader import read_bag
from ship_estimation.rejection_rules import Reason
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.replay import main as replay
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import main as simulate
from ship_simulation.suite_file import suite_yaml

SCENARIO: dict[str, Any] = {
    "start_utc": "2026-01-15T20:00:00Z",
    "duration_s": 30.0,
    "carrier": {
        "kind": "sinusoids",
        "heading": {"mean_deg": 5.0},
        "pitch": {"waves": {"swell": {"amplitude_deg": 1.8, "period_s": 8.0}}},
        "roll": {"waves": {"swell": {"amplitude_deg": 4.0, "period_s": 11.0}}},
    },
    "ins": {"rate_hz": 20.0},
    "ship_baseline": {
        "forward_m": 12.0,
        "right_m": 1.0,
        "rtk": {
            "rate_hz": 2.0,
            "float_times": {"masts": {"start_s": 10.0, "end_s": 15.0}},
            "no_solution_times": {"bridge": {"start_s": 20.0, "end_s": 22.0}},
        },
    },
}


def test_fixed_solutions_are_used_and_the_others_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    scenario, bag, suite, out = (tmp_path / name for name in ("ship.yaml", "ship.mcap", "suite.yaml", "out.mcap"))
    scenario.write_text(yaml.safe_dump(SCENARIO), encoding="utf-8")
    assert simulate([str(scenario), "--out", str(bag), "--seed", "3"]) == 0
    suite.write_text(suite_yaml(load_scenario(scenario)), encoding="utf-8")
    assert check_config([str(suite), str(bag)]) == 0
    assert replay([str(bag), "--config", str(suite), "--out", str(out)]) == 0
    capsys.readouterr()
    innovations, sources = [], set()
    with read_bag(out) as made:
        for record in made.records():
            if record.topic == "ship/innovation":
                innovations.append(record.decode())
            elif record.topic == "ship/attitude":
                sources |= set(record.decode().sources)
    assert {(one.source, tuple(one.components)) for one in innovations if one.accepted} == {
        ("baseline", ("baseline up", "baseline right"))
    }
    # Of 61 messages in 30 s at 2 Hz, 10 are FLOAT and 4 have no solution; the last message waits for a later INS
    # sample.
    reasons = Counter(int(one.reason) for one in innovations)
    assert reasons == {Reason.NONE: 46, Reason.NOT_FIXED: 14}
    assert sources == {"ins", "baseline"}
