"""Errors and protection levels in the two reference cases, over many voyages: draws the figures of the docs.

A voyage whose file exists is not run again. Exits with 1 if an error was above its level.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_replay.commands.stanford import main as draw
from ship_replay.offline.replay import ADAPTERS, replay
from ship_testing.trials.fault_voyage import make_bag

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = ROOT / "bags" / "scenarios"
FIGURES = ROOT / "docs" / "figures"
_FIRST_SEED = 101


@dataclass(frozen=True)
class Case:
    """Voyages of one scenario.

    Attributes:
        length_s: length of each voyage, s.
        voyages: number of voyages.
        figure: name of the file to draw.
    """

    length_s: float
    voyages: int
    figure: str


CASES = {
    "paper": Case(600.0, 17, "stanford.png"),
    "theodolite_sweep": Case(300.0, 34, "stanford_pointing.png"),
}
"""Scenario → case.

The voyages contain a million epochs of the ship's attitude, with the truth at each output. The voyages also contain a
hundred thousand epochs of the pointing with lights, with the truth in the bag ten times a second.
"""


def main() -> int:
    """Run the voyages and draw the figures."""
    parser = CommandParser(prog="stanford", description=__doc__.splitlines()[0], epilog=__doc__.splitlines()[2])
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES), help="scenarios (both)")
    parser.add_argument("--voyages", type=int, help="voyages of each case (17 and 34)")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "stanford", help="folder of the voyages")
    parser.add_argument("--figures", type=Path, default=FIGURES, help="folder of the figures (docs/figures)")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    codes = [_draw_case(name, CASES[name], options) for name in options.cases]
    return next((code for code in codes if code != EXIT_DONE), EXIT_DONE)


def _draw_case(name: str, case: Case, options: argparse.Namespace) -> int:
    """Draw the figure of a case; return the exit code."""
    count = case.voyages if options.voyages is None else options.voyages
    seeds = range(_FIRST_SEED, _FIRST_SEED + count)
    folder = options.out / name
    with ProcessPoolExecutor(options.processes) as pool:
        paths = list(pool.map(_voyage, [folder] * count, [name] * count, [case.length_s] * count, seeds))
    return draw([*map(str, paths), "--figure", str(options.figures / case.figure), "--force"])


def _voyage(folder: Path, scenario: str, length_s: float, seed: int) -> Path:
    """Return the path of the outputs of one voyage, with the truth."""
    path = folder / f"out_{seed}.mcap"
    if not path.exists():
        replay(make_bag(SCENARIOS / f"{scenario}.yaml", length_s, seed, folder / f"in_{seed}.mcap"), path, ADAPTERS)
    return path


if __name__ == "__main__":
    sys.exit(main())
