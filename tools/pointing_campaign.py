"""Campaign of the theodolite's axis: accuracy, and consistency of its covariance, over many seeds of one scenario.

The scenario is bags/scenarios/theodolite_sweep. Prints one line per time span: with lights, first half minute
without lights, end. Exits with 1 if RMS/sigma is outside its band, or if the RMS is above its bound. The bounds are 5"
with lights, 8.5" in the first half minute and 31" after ten minutes. In the same spans, the RMS must be 10, 9 and 2.4
times smaller than the RMS of INS and encoders with unmodelled axis errors.
"""

import argparse
import dataclasses
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.trials.monte_carlo import PointingErrors, pointing_errors

SCENARIO = Path(__file__).parents[1] / "bags" / "scenarios" / "theodolite_sweep.yaml"
BAND = (0.88, 1.12)
"""Band of RMS/sigma for 200 seeds."""


@dataclass(frozen=True)
class Span:
    """A time span.

    Attributes:
        name: name of the span for texts.
        start_s: begin of the span, excluded, s after the start of the run.
        end_s: end of the span, included, s after the start of the run.
        worst_arcsec: bound of the RMS.
        times_better: minimum ratio of the RMS of INS and encoders to the RMS of the estimated axis.
    """

    name: str
    start_s: float
    end_s: float
    worst_arcsec: float
    times_better: float


SPANS = (
    Span("with lights", 60.0, 300.0, 5.0, 10.0),
    Span("first 30 s without", 300.0, 330.0, 8.5, 9.0),
    Span("after ten minutes", 890.0, 900.0, 31.0, 2.4),
)


def main() -> int:
    """Run the campaign; return 0 if all bounds are met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("--seeds", type=int, default=200, help="number of runs (default 200)")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (default 2)")
    arguments = parser.parse_args()
    console = Console(width=120)
    with ProcessPoolExecutor(arguments.processes) as pool:
        runs = pool.map(_squares, repeat(_quick(load_scenario(SCENARIO))), range(arguments.seeds))
        # (seed, span, [error², sigma², error² of INS and encoders])
        squares = np.array(list(track(runs, "sweep", arguments.seeds, console=Console(stderr=True), transient=True)))
    console.print(f"error of the axis on the sky, {arguments.seeds} runs (arcsec)")
    console.print(f"{'':22}{'RMS':>8}{'sigma':>8}{'RMS/sigma':>11}{'INS+encoder':>13}{'times better':>14}")
    good = [_print_span(console, span, np.mean(squares[:, row], axis=0)) for row, span in enumerate(SPANS)]
    return 0 if all(good) else 1


def _quick(scenario: Scenario) -> Scenario:
    """Return the scenario with low rates, at which all devices still sample at the times of the exposures."""
    theodolite = dataclasses.replace(
        scenario.theodolite,
        encoder=dataclasses.replace(scenario.theodolite.encoder, rate_hz=6.0),
        telescope=dataclasses.replace(scenario.theodolite.telescope, phase_s=0.5),
    )
    beacons = {
        key: dataclasses.replace(
            beacon,
            rtk=dataclasses.replace(beacon.rtk, rate_hz=2.0),
            imu=dataclasses.replace(beacon.imu, rate_hz=2.0),
        )
        for key, beacon in scenario.beacons.items()
    }
    return dataclasses.replace(
        scenario,
        theodolite=theodolite,
        beacons=beacons,
        ins=dataclasses.replace(scenario.ins, rate_hz=2.0),
        fused_attitude=dataclasses.replace(scenario.fused_attitude, rate_hz=3.0),
    )


def _squares(scenario: Scenario, seed: int) -> FloatArray:
    """Return mean squares of one run, rad², shape (spans, 3): error, sigma, error of INS and encoders."""
    errors = pointing_errors(scenario, seed)
    return np.array([_of_span(errors, span) for span in SPANS])


def _of_span(errors: PointingErrors, span: Span) -> list[float]:
    inside = (errors.time_s > span.start_s) & (errors.time_s <= span.end_s)
    quantities = (errors.error_on_sky, errors.sigma_on_sky, errors.ins_encoder)
    return [float(np.mean(values[inside] ** 2)) for values in quantities]


def _print_span(console: Console, span: Span, means: FloatArray) -> bool:
    """Print the line of a span; return True if the bounds of the span are met."""
    rms, sigma, alone = np.sqrt(means) / ARCSEC
    ratio, better = rms / sigma, alone / rms
    good = BAND[0] <= ratio <= BAND[1] and rms <= span.worst_arcsec and better >= span.times_better
    verdict = "met" if good else "NOT MET"
    console.print(f"{span.name:22}{rms:8.2f}{sigma:8.2f}{ratio:11.3f}{alone:13.1f}{better:14.1f}   {verdict}")
    return good


if __name__ == "__main__":
    sys.exit(main())
