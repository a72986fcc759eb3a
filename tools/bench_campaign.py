"""A campaign by two workers over the same by one."""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench_rows import Row, by_turns
from ship_replay.campaign.items import items_of
from ship_replay.campaign.one_item import make
from ship_replay.campaign.processes import in_processes

SCENARIO = Path(__file__).resolve().parents[1] / "bags" / "scenarios" / "demo.yaml"
ROUNDS = 3
MOST_WORKERS_RATIO = 1.0 / 1.8
"""On two processors that have nothing else to do."""


def campaign_workers() -> list[Row]:
    """Wall time of six voyages of ten seconds, by turns; the least of several, as what else runs only adds."""
    with tempfile.TemporaryDirectory() as name:
        scenario = Path(name) / "voyage.yaml"
        text = SCENARIO.read_text(encoding="utf-8")
        scenario.write_text(text.replace("duration_s: 120.0", "duration_s: 10.0"), encoding="utf-8")
        items = items_of([scenario], [], range(6))
        _wall_s(items[:1], 1)  # starts the server of processes
        by_one_s, by_two_s = by_turns(ROUNDS, lambda: _wall_s(items, 1), lambda: _wall_s(items, 2))
    one_s, two_s = min(by_one_s), min(by_two_s)
    return [
        Row("campaign of six voyages, one worker: least wall time", one_s, "s"),
        Row("the same with two workers", two_s, "s"),
        Row("ratio: two workers / one", two_s / one_s, "x", MOST_WORKERS_RATIO, "one worker"),
    ]


def _wall_s(items: Sequence[Any], workers: int) -> float:
    begin_s = time.monotonic()
    list(in_processes(make, items, workers))
    return time.monotonic() - begin_s
