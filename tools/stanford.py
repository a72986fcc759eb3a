"""Errors against protection levels in the reference case, over many voyages: draws the figure of the docs.

A voyage that is in the folder already is not made again. Exits 1 where an error was above its level.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from ship_bags.command_line import CommandParser, run_command
from ship_replay.commands.replay import ADAPTERS
from ship_replay.commands.stanford import main as draw
from ship_replay.offline.replay import replay
from ship_replay.trials.fault_voyage import make_bag

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "bags" / "scenarios" / "paper.yaml"
FIGURE = ROOT / "docs" / "figures" / "stanford.png"
_LENGTH_S = 600.0
_FIRST_SEED = 101


def main() -> int:
    """Make the voyages and draw them."""
    parser = CommandParser(prog="stanford", description=__doc__.splitlines()[0], epilog=__doc__.splitlines()[2])
    parser.add_argument("--voyages", type=int, default=17, help="of ten minutes; 17 are a million epochs (17)")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "stanford", help="folder of the voyages")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="to draw (stanford.png in docs)")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    seeds = range(_FIRST_SEED, _FIRST_SEED + options.voyages)
    with ProcessPoolExecutor(options.processes) as pool:
        paths = list(pool.map(_voyage, [options.out] * len(seeds), seeds))
    return draw([*map(str, paths), "--figure", str(options.figure), "--force"])


def _voyage(folder: Path, seed: int) -> Path:
    """The outputs of one voyage, with the truth."""
    path = folder / f"out_{seed}.mcap"
    if not path.exists():
        replay(make_bag(SCENARIO, _LENGTH_S, seed, folder / f"in_{seed}.mcap"), path, ADAPTERS)
    return path


if __name__ == "__main__":
    sys.exit(main())
