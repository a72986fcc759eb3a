"""Heading error in turns of 0, 10 and 20°/s, the turntable classes of IMO MSC.116(73) and ISO 22090.

The clock of the INS is estimated: at 20°/s an unmodelled offset of 1 ms is 72″ of heading. ``pytest -s`` prints the
table of docs/explanation/filter.md.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC
from ship_simulation.scenario.motion_scenario import Turn
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.consistency import sigma_ratio_band
from ship_testing.trials.monte_carlo import final_error

SCENARIO = Path(__file__).parents[1] / "bags" / "scenarios" / "turn.yaml"
BEGIN_S, RAMP_S, END_S = 30.0, 5.0, 45.0
SEEDS = 12


def turn_scenario(rate_deg_per_s: float) -> Scenario:
    """Return the scenario ``turn``, shortened: waves for thirty seconds, then a turn to the end."""
    whole = load_scenario(SCENARIO)
    turn = Turn(BEGIN_S, rate_deg_per_s * (END_S - BEGIN_S + RAMP_S), max(rate_deg_per_s, 0.001), RAMP_S)
    ins = replace(whole.ins, rate_hz=25.0)
    return replace(whole, duration_s=END_S, ins=ins, carrier=replace(whole.carrier, turn=turn))


@pytest.mark.statistics
@pytest.mark.parametrize("rate_deg_per_s", [0.0, 10.0, 20.0])
def test_the_heading_error_fits_its_sigma_in_a_turn(rate_deg_per_s: float) -> None:
    ends = [final_error(turn_scenario(rate_deg_per_s), seed) for seed in range(SEEDS)]
    errors, sigmas = (np.array([getattr(end, name)[0] for end in ends]) / ARCSEC for name in ("angles", "sigma"))
    rms, sigma, most = np.sqrt(np.mean(errors**2)), np.sqrt(np.mean(sigmas**2)), np.max(np.abs(errors))
    print(f"\n{rate_deg_per_s:.0f}°/s: RMS {rms:.2f}″, σ {sigma:.2f}″, largest {most:.2f}″, {SEEDS} seeds")
    lowest, highest = sigma_ratio_band(SEEDS)
    assert lowest <= np.sqrt(np.mean((errors / sigmas) ** 2)) <= highest
