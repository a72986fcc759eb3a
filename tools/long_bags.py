"""`simulate` and `replay` over voyages of increasing length: constant memory, and processor time per hour.

Each runs in a separate process. Exit code 0 within the bounds; 1 the memory is above its bound, or an hour of a long
voyage costs more than one of the shortest; 2 bad usage.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command

SCENARIO = Path(__file__).resolve().parents[1] / "bags" / "scenarios" / "paper.yaml"
MOST_MB, MOST_OF_SHORTEST = 250.0, 1.05

_MEASURED = """
import re, time
print(time.process_time() - begin_s, re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""
_SIMULATE = f"""
import dataclasses, sys, time
from pathlib import Path
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
begin_s, scenario = time.process_time(), Path(sys.argv[1])
voyage = dataclasses.replace(load_scenario(scenario), duration_s=float(sys.argv[3]))
write_bag(voyage, 1, Path(sys.argv[2]), scenario.read_bytes())
{_MEASURED}"""
_REPLAY = f"""
import sys, time
from pathlib import Path
from ship_replay.commands.replay import ADAPTERS
from ship_replay.offline.replay import replay
begin_s = time.process_time()
replay(Path(sys.argv[1]), Path(sys.argv[2]), ADAPTERS)
{_MEASURED}"""


class Cost(NamedTuple):
    """Processor time, s, and peak memory, MB, of a process."""

    cpu_s: float
    memory_mb: float


def main() -> int:
    """Run both programs and check their costs."""
    parser = CommandParser(prog="long_bags", description=__doc__, epilog="the scenario: bags/scenarios/paper.yaml")
    parser.add_argument(
        "--hours", type=float, nargs="+", default=[1.0, 10.0], metavar="H", help="lengths of the voyages, h (1 10)"
    )
    parser.add_argument("--folder", type=Path, help="folder of the bags, 80 MB an hour (a temporary one)")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    costs: dict[str, dict[float, Cost]] = {"simulate": {}, "replay": {}}
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        bag, out = Path(name) / "voyage.mcap", Path(name) / "replayed.mcap"
        for hours in sorted(options.hours):
            costs["simulate"][hours] = _cost(_SIMULATE, SCENARIO, bag, 3600.0 * hours)
            costs["replay"][hours] = _cost(_REPLAY, bag, out)
    table = Table(title="one process each")
    for column in ("", "voyage (h)", "processor time (s/h)", "memory (MB)"):
        table.add_column(column, justify="right")
    within = True
    for what, by_hours in costs.items():
        shortest = next(cost.cpu_s / hours for hours, cost in by_hours.items())
        for hours, cost in by_hours.items():
            table.add_row(what, f"{hours:g}", f"{cost.cpu_s / hours:.2f}", f"{cost.memory_mb:.0f}")
            within &= cost.memory_mb <= MOST_MB and cost.cpu_s / hours <= MOST_OF_SHORTEST * shortest
    Console(width=80).print(table)
    return EXIT_DONE if within else EXIT_BOUND_NOT_MET


def _cost(program: str, *arguments: object) -> Cost:
    command = [sys.executable, "-c", program, *map(str, arguments)]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    cpu_s, memory_kb = map(float, output.split())
    return Cost(cpu_s, memory_kb / 1024.0)


if __name__ == "__main__":
    sys.exit(main())
