"""Creates the bags in bags/ from their scenarios: ``make bags``.

The same scenario and seed give the same bytes on the same kind of processor.
Exit code 0 done; 2 bad input or usage.
"""

import argparse
import hashlib
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag

FOLDER = Path(__file__).resolve().parents[1] / "bags"
SUMS = "SHA256SUMS"
SEEDS = {"demo": 1, "theodolite": 1}
"""Name of a bag → seed; the scenario of the bag is bags/scenarios/<bag>.yaml."""


def main() -> int:
    """Create all bags and their checksums."""
    parser = CommandParser(prog="make_bags", description="Make the bags in bags/ and their sha256 sums.")
    parser.add_argument("--out", type=Path, default=FOLDER, metavar="DIR", help="folder to write to (bags)")
    return run_command(parser, _make, None)


def _make(options: argparse.Namespace) -> int:
    lines = []
    for name, seed in SEEDS.items():
        path = options.out / f"{name}.mcap"
        scenario_path = FOLDER / "scenarios" / f"{name}.yaml"
        count = write_bag(load_scenario(scenario_path), seed, path, scenario_path.read_bytes())
        print(f"{path}: {count} messages, {path.stat().st_size / 1e6:.2f} MB, seed {seed}")
        lines.append(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n")
    (options.out / SUMS).write_text("".join(lines), encoding="utf-8")
    return EXIT_DONE


if __name__ == "__main__":
    raise SystemExit(main())
