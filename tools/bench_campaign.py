"""Cost of a campaign with two workers relative to one worker, and of a Monte Carlo test of a filter's consistency."""

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench_rows import WITH_INTEGRITY, Row, alternate, own_cpu_s
from ship_simulation.scenario.scenario_file import load_scenario
from ship_studies.campaign.items import campaign_items, run_item
from ship_studies.campaign.workers import run_in_processes
from ship_testing.trials.monte_carlo import final_error

SCENARIOS = Path(__file__).resolve().parents[1] / "bags" / "scenarios"
ROUNDS = 3
MOST_WORKERS_RATIO = 1.0 / 1.8
"""Maximum ratio of the times with two workers and with one worker, on two otherwise idle processors."""

MONTE_CARLO_RUNS, MONTE_CARLO_RUN_S, MONTE_CARLO_INS_HZ = 200, 600.0, 20.0
"""Number, length and INS rate of runs with two star sensors; each run has another seed, as in the campaigns."""

RUNS_MEASURED = 4
MOST_MONTE_CARLO_S = 60.0 * WITH_INTEGRITY
"""Maximum time of all runs on two processors, including simulation, s."""


def campaign_workers() -> list[Row]:
    """Measure the least wall time of six voyages of ten seconds, alternately with one and with two workers."""
    with tempfile.TemporaryDirectory() as name:
        scenario = Path(name) / "voyage.yaml"
        text = (SCENARIOS / "demo.yaml").read_text(encoding="utf-8")
        scenario.write_text(text.replace("duration_s: 120.0", "duration_s: 10.0"), encoding="utf-8")
        items = campaign_items([scenario], [], range(6))
        _wall_s(items[:1], 1)  # first call, which starts the fork server
        by_one_s, by_two_s = alternate(ROUNDS, lambda: _wall_s(items, 1), lambda: _wall_s(items, 2))
    one_s, two_s = min(by_one_s), min(by_two_s)
    return [
        Row("campaign of six voyages, one worker: least wall time", one_s, "s"),
        Row("the same with two workers", two_s, "s"),
        Row("ratio: two workers / one", two_s / one_s, "x", MOST_WORKERS_RATIO, "one worker"),
    ]


def monte_carlo_cost() -> list[Row]:
    """Measure the processor time of some runs of a Monte Carlo test; extrapolate to all runs on two processors."""
    paper = load_scenario(SCENARIOS / "paper.yaml")
    ins = dataclasses.replace(paper.ins, rate_hz=MONTE_CARLO_INS_HZ)
    scenario = dataclasses.replace(paper, ins=ins, duration_s=MONTE_CARLO_RUN_S)
    final_error(dataclasses.replace(scenario, duration_s=20.0), 0)  # first call: imports modules and loads tables
    run_s = [own_cpu_s(partial(final_error, scenario, seed)) for seed in range(RUNS_MEASURED)]
    both_s = 0.5 * MONTE_CARLO_RUNS * float(np.mean(run_s))
    what = f"Monte Carlo, {MONTE_CARLO_RUNS} runs of {MONTE_CARLO_RUN_S:g} s"
    return [
        Row(f"{what}: a run, processor time: mean", float(np.mean(run_s)), "s"),
        Row(f"{what} on two processors", both_s, "s", MOST_MONTE_CARLO_S),
    ]


def _wall_s(items: Sequence[Any], workers: int) -> float:
    begin_s = time.monotonic()
    list(run_in_processes(run_item, items, workers))
    return time.monotonic() - begin_s
