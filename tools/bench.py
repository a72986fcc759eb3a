"""``make bench``: speed, as ratios of two values measured in one run, which are comparable between machines.

Each benchmark is a function in BENCHMARKS that returns rows; rows with a bound determine the exit code. Processor times
are in s. The rows are saved as JSON, from which ``python tools/bench_page.py`` writes docs/reference/performance.md.
``--only`` replaces rows in this file; rows of other benchmarks of the same day and machine remain.
Exit code 0 done; 1 a bound was not met or a process failed; 2 bad usage.
"""

import argparse
import dataclasses
import datetime
import json
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench_behind_star import behind_star_cost
from bench_black_box import black_box_cost
from bench_campaign import campaign_workers, monte_carlo_cost
from bench_filter import integrity_cost, step_cost
from bench_live import live_cost
from bench_messages import message_cost
from bench_monitor import monitor_cost
from bench_peers import peers_cost
from bench_replay import block_cost, replay_cost
from bench_rows import Row
from bench_setup import setup_cost
from bench_stars import late_star_cost, star_solution
from bench_start import import_cost, start_cost
from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_testing.trials.live_run import LiveFailure

JSON_FILE = Path(__file__).resolve().parents[1] / "out" / "bench.json"

BENCHMARKS: dict[str, Callable[[], list[Row]]] = {
    "import": import_cost,
    "start": start_cost,
    "live": live_cost,
    "behind_star": behind_star_cost,
    "step": step_cost,
    "replay": replay_cost,
    "blocks": block_cost,
    "black_box": black_box_cost,
    "messages": message_cost,
    "star_solution": star_solution,
    "late_star": late_star_cost,
    "integrity": integrity_cost,
    "peers": peers_cost,
    "monitor": monitor_cost,
    "monte_carlo": monte_carlo_cost,
    "campaign": campaign_workers,
    "setup": setup_cost,
}


def main() -> int:
    """Run the benchmarks."""
    parser = CommandParser(prog="bench", description=__doc__)
    choices = sorted(BENCHMARKS)
    parser.add_argument("--only", action="append", choices=choices, help="a benchmark, may be repeated (all)")
    parser.add_argument("--json", type=Path, default=JSON_FILE, metavar="FILE", help="the rows (out/bench.json)")
    return run_command(parser, _bench, None)


def _bench(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    done: list[dict[str, Any]] = []
    met = True
    for name, benchmark in BENCHMARKS.items():
        if options.only and name not in options.only:
            continue
        try:
            rows = benchmark()
        except LiveFailure as failure:
            print(f"bench: {name}: {failure}", file=sys.stderr)
            met = False
            continue
        for row in rows:
            print(row.line, flush=True)
            met = met and row.is_within_bound
        done += [{"benchmark": name} | dataclasses.asdict(row) for row in rows]
    circumstances = _circumstances()
    rows = _merge_rows(done, circumstances, options.json) if options.only else done
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(circumstances | {"rows": rows}, indent=1) + "\n", encoding="utf-8")
    return EXIT_DONE if met else EXIT_BOUND_NOT_MET


def _merge_rows(new_rows: list[dict[str, Any]], circumstances: dict[str, Any], file: Path) -> list[dict[str, Any]]:
    """Return new rows, and the other benchmarks' rows in a file, in the order of BENCHMARKS.

    Rows in the file are kept only if its day, machine and versions are those of the new rows.
    """
    kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {"rows": []}
    if any(kept.get(name) != circumstances[name] for name in circumstances if name != "load"):
        return new_rows
    measured = {row["benchmark"] for row in new_rows}
    rows = new_rows + [row for row in kept["rows"] if row["benchmark"] not in measured]
    return sorted(rows, key=lambda row: list(BENCHMARKS).index(row["benchmark"]))


def _circumstances() -> dict[str, Any]:
    """Return date, machine and versions of the measurement, on which times in seconds depend."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "processor": models[0] if models else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "load": round(os.getloadavg()[2], 1),
    }


if __name__ == "__main__":
    sys.exit(main())
