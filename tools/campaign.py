"""``make campaign``: is the covariance honest over many seeds? Prints one line a scenario, exits 1 outside a band.

Bands are two-sided chi² at 99.9 %: for 200 seeds mean NEES in [2.46, 3.60], RMS/sigma in [0.84, 1.17].
"""

import argparse
import dataclasses
import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from ship_estimation.gates import mean_nees_band, sigma_ratio_band
from ship_geometry.rotations import ARCSEC
from ship_replay.trials.monte_carlo import FinalError, final_error
from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario

SCENARIOS = Path(__file__).parents[1] / "bags" / "scenarios"
LONG = ("schuler", "deflection")
"""Of hours, in which the sea tells nothing: the ship lies still, and every device speaks each ten seconds."""
NAMES = ("paper", "one_sensor", "turn", "outage", "late_shuffled", "sea_state_5", "paper_stars", *LONG)


def main() -> int:
    """Run the campaign; 0 where every scenario is in its bands."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", default=NAMES, help=f"names of {SCENARIOS.name}/*.yaml")
    parser.add_argument("--seeds", type=int, default=200, help="runs of each scenario (default 200)")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (default 2)")
    parser.add_argument("--recording", type=Path, help="bag whose motion the scenario `recorded` takes as carrier")
    parser.add_argument("--ins-rate-hz", type=float, default=20.0, help="INS samples per second (default 20)")
    parser.add_argument("--duration-s", type=float, help="length of each run (default: as the scenario says)")
    arguments = parser.parse_args()
    console = Console(width=120)
    console.print(f"error at the end of each of {arguments.seeds} runs, one a seed; heading, pitch, roll")
    console.print(_line("scenario", "sigma (arcsec)", "RMS (arcsec)", "RMS/sigma", "NEES", "refused", ""))
    honest = True
    with ProcessPoolExecutor(arguments.processes) as pool:
        for name in arguments.scenarios:
            scenario = _scenario(name, arguments.ins_rate_hz, arguments.recording, arguments.duration_s)
            runs = pool.map(final_error, repeat(scenario, arguments.seeds), range(arguments.seeds))
            results = list(track(runs, name, arguments.seeds, console=Console(stderr=True), transient=True))
            honest &= _judged(console, name, results)
    low, high = sigma_ratio_band(arguments.seeds)
    nees_low, nees_high = mean_nees_band(arguments.seeds, 3)
    console.print(f"99.9 % bands: RMS/sigma [{low:.2f}, {high:.2f}], NEES [{nees_low:.2f}, {nees_high:.2f}]")
    return 0 if honest else 1


def _scenario(name: str, ins_rate_hz: float, recording: Path | None, duration_s: float | None) -> Scenario:
    scenario = load_scenario(SCENARIOS / f"{name}.yaml", recording=recording if name == "recorded" else None)
    if name in LONG:
        return _thinned(scenario)
    ins = dataclasses.replace(scenario.ins, rate_hz=ins_rate_hz)
    return dataclasses.replace(scenario, ins=ins, duration_s=duration_s or scenario.duration_s)


def _thinned(scenario: Scenario) -> Scenario:
    """A voyage of hours without waves, with a sample of each device every ten seconds."""
    heading, pitch, roll = AngleMotion(mean_deg=5.0), AngleMotion(mean_deg=0.5), AngleMotion(mean_deg=2.0)
    sensors = {
        id_: dataclasses.replace(one, rate_hz=0.1, phase_s=0.0) for id_, one in scenario.star_sensors.items()
    }
    return dataclasses.replace(
        scenario,
        carrier=CarrierMotion(kind="sinusoids", heading=heading, pitch=pitch, roll=roll),
        ins=dataclasses.replace(scenario.ins, rate_hz=0.1, time_offset_sigma_s=0.0),
        position=dataclasses.replace(scenario.position, rate_hz=0.1),
        star_sensors=sensors,
    )


def _judged(console: Console, name: str, results: list[FinalError]) -> bool:
    """Print the line of one scenario as soon as it is there; True where it is in its bands."""
    angles = np.array([result.angles for result in results])
    sigma = np.array([result.sigma for result in results])
    ratio = np.sqrt(np.mean((angles / sigma) ** 2, axis=0))
    nees = float(np.mean([result.nees for result in results]))
    low, high = sigma_ratio_band(len(results))
    nees_low, nees_high = mean_nees_band(len(results), 3)
    honest = bool(np.all((low <= ratio) & (ratio <= high)) and nees_low <= nees <= nees_high)
    console.print(
        _line(
            name,
            _three(np.mean(sigma, axis=0) / ARCSEC),
            _three(np.sqrt(np.mean(angles**2, axis=0)) / ARCSEC),
            _three(ratio),
            f"{nees:.2f}",
            str(sum(result.refused for result in results)),
            "in band" if honest else "OUTSIDE",
        )
    )
    return honest


def _line(name: str, *columns: str) -> str:
    widths = (20, 20, 20, 6, 8, 8)
    return f"{name:16}" + "".join(f"{column:>{width}}" for column, width in zip(columns, widths, strict=True))


def _three(values: np.ndarray) -> str:
    return "  ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
