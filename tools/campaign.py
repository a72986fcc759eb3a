"""``make campaign``: is the covariance consistent over many seeds? Prints one line a case, exits 1 outside a band.

Bands are two-sided chi² at 99.9 % for the number of seeds. The bands are mean NEES in [2.82, 3.18] and RMS/sigma in
[0.95, 1.05] for 2000 seeds, [2.46, 3.60] and [0.84, 1.17] for 200 seeds. In the last case, ``isam2``, runs of a minute
are estimated by the filter and, for comparison, by GTSAM.
"""

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path

import numpy as np
from rich.console import Console

from ship_bags.command_line import with_count
from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.rotations import ARCSEC
from ship_simulation.scenario.scenario import Scenario
from ship_testing.consistency import sigma_ratio_band
from ship_testing.trials.monte_carlo import FinalError, final_error

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT / "test") not in sys.path:
    sys.path.insert(0, str(ROOT / "test"))

# The cases and the peer are in the tests, which are no package.
from ship_testing.campaign_cases import CASES, WITHOUT_RECORDING, case_at_length, case_in_short  # noqa: E402
from ship_testing.isam2_peer import isam2_error  # noqa: E402

SEEDS = 2000
PEER = "isam2"
PEER_SEEDS = 200
"""Maximum number of runs that the peer smooths, because smoothing a run takes as long as four runs of the filter."""


def main() -> int:
    """Run the campaign; return 0 if every case is in its bands."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("cases", nargs="*", default=(*WITHOUT_RECORDING, PEER), help=", ".join((*CASES, PEER)))
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"runs of each case (default {SEEDS})")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (default 2)")
    parser.add_argument("--recording", type=Path, help="bag with the ship's motion for the case `recorded`")
    parser.add_argument("--in-short", action="store_true", help="cases as short as in tests: an hour for 2000 seeds")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.cases) - {*CASES, PEER})
    if unknown:
        parser.error(f"unknown case {', '.join(unknown)}: choose from {', '.join((*CASES, PEER))}")
    console = Console(width=120)
    console.print(f"error at the end of each of {arguments.seeds} runs, one a seed; heading, pitch, roll")
    console.print(_line("case", "sigma (arcsec)", "RMS (arcsec)", "RMS/sigma", "NEES", "rejected", ""))
    in_band = True
    with ProcessPoolExecutor(arguments.processes) as pool:
        for name in arguments.cases:
            if name == PEER:
                in_band &= _compare_with_peer(console, pool, min(arguments.seeds, PEER_SEEDS))
                continue
            recording = arguments.recording if name == "recorded" else None
            scenario = case_in_short(name, recording) if arguments.in_short else case_at_length(name, recording)
            in_band &= _print_case(console, name, _errors(pool, name, final_error, scenario, arguments.seeds))
    low, high = sigma_ratio_band(arguments.seeds)
    nees_low, nees_high = mean_nees_band(arguments.seeds, 3)
    console.print(f"99.9 % bands: RMS/sigma [{low:.2f}, {high:.2f}], NEES [{nees_low:.2f}, {nees_high:.2f}]")
    return 0 if in_band else 1


def _errors(
    pool: Executor, name: str, error: Callable[[Scenario, int], FinalError], scenario: Scenario, seeds: int
) -> list[FinalError]:
    runs = pool.map(error, repeat(scenario, seeds), range(seeds))
    return list(with_count(runs, name, seeds))


def _compare_with_peer(console: Console, pool: Executor, seeds: int) -> bool:
    """Estimate short runs by filter and GTSAM's iSAM2; return True if both are in their bands, or GTSAM is missing."""
    if find_spec("gtsam") is None:
        console.print(f"{PEER}: left out, GTSAM is not installed (pip install gtsam)")
        return True
    scenario = case_in_short("paper")
    console.print(f"{seeds} runs of {scenario.duration_s:g} s by the filter and by GTSAM's iSAM2:")
    in_band = True
    for name, error in (("paper, a minute", final_error), ("the same, iSAM2", isam2_error)):
        in_band &= _print_case(console, name, _errors(pool, name, error, scenario, seeds))
    return in_band


def _print_case(console: Console, name: str, results: list[FinalError]) -> bool:
    """Print the line of one case; return True if the case is in its bands."""
    angles = np.array([result.angles for result in results])
    sigma = np.array([result.sigma for result in results])
    ratio = np.sqrt(np.mean((angles / sigma) ** 2, axis=0))
    nees = float(np.mean([result.nees for result in results]))
    low, high = sigma_ratio_band(len(results))
    nees_low, nees_high = mean_nees_band(len(results), 3)
    in_band = bool(np.all((low <= ratio) & (ratio <= high)) and nees_low <= nees <= nees_high)
    console.print(
        _line(
            name,
            _three_values_text(np.mean(sigma, axis=0) / ARCSEC),
            _three_values_text(np.sqrt(np.mean(angles**2, axis=0)) / ARCSEC),
            _three_values_text(ratio),
            f"{nees:.2f}",
            str(sum(result.rejected_count for result in results)),
            "in band" if in_band else "OUTSIDE",
        )
    )
    return in_band


def _line(name: str, *columns: str) -> str:
    widths = (20, 20, 20, 6, 8, 8)
    return f"{name:16}" + "".join(f"{column:>{width}}" for column, width in zip(columns, widths, strict=True))


def _three_values_text(values: np.ndarray) -> str:
    return "  ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
