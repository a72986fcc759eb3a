"""Wide priors with `input: solution`: the attitude of the first seconds compared with the truth, by both nodes' cores.

The ship rolls, so that an error of the INS's clock of one sigma, 5 ms, is up to 40 arcseconds of attitude.
"""

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import FloatArray, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeOutcome
from ship_testing.solved_voyages import run_with_solutions

pytestmark = [pytest.mark.statistics, pytest.mark.xdist_group("wide_priors_by_solutions")]

SCENARIOS = Path(__file__).parents[1] / "bags" / "scenarios"
SEEDS = range(1, 12)
DURATION_S, INS_HZ = 4.0, 20.0
DEGREE = 3600.0
FALSE_SHARE = 0.3
"""Fraction of false stars among the detections without identity."""
CONSTANT_S = 1e7
"""Correlation time of an error that is constant over the voyage, s.

With the times of the reference case an error of degrees changes by a minute of arc in a second. The checks of the INS
count such a walk as noise too, so that the covariance is larger than the error.
"""


@dataclass(frozen=True)
class Prior:
    """Sigmas of the INS's error, arcseconds, and conditions of the voyage.

    All stars are correctly identified if ``has_star_identities`` is True, and the INS's error is constant if
    ``is_constant`` is True. Exposures last ``exposure_s``; if this is not 0, the first exposures begin before the INS's
    first sample.
    """

    heading: float
    tilt: float
    has_star_identities: bool
    is_constant: bool = True
    exposure_s: float = 0.0

    @property
    def scenario(self) -> Scenario:
        """Return the reference case with single stars, exposures one after another, and errors drawn by this prior."""
        whole = load_scenario(SCENARIOS / "paper_stars.yaml")
        sensors = {
            id_: replace(
                sensor,
                phase_s=phase_s,
                exposure_s=self.exposure_s,
                identified=self.has_star_identities,
                false_stars=0.0 if self.has_star_identities else sensor.most_stars * FALSE_SHARE / (1.0 - FALSE_SHARE),
            )
            for (id_, sensor), phase_s in zip(whole.star_sensors.items(), (0.033, 0.117), strict=True)
        }
        ins = replace(
            whole.ins,
            rate_hz=INS_HZ,
            heading_sigma_arcsec=self.heading,
            tilt_sigma_arcsec=self.tilt,
            heading_time_s=CONSTANT_S if self.is_constant else whole.ins.heading_time_s,
            tilt_time_s=CONSTANT_S if self.is_constant else whole.ins.tilt_time_s,
        )
        return replace(whole, duration_s=DURATION_S, ins=ins, star_sensors=sensors)


PRIORS = [
    Prior(DEGREE, 10.0, has_star_identities=False, is_constant=False),
    Prior(3.0 * DEGREE, 10.0, has_star_identities=True, is_constant=False),
    Prior(DEGREE, 10.0, has_star_identities=False),
    Prior(3.0 * DEGREE, 10.0, has_star_identities=False),
    Prior(3.0 * DEGREE, 10.0, has_star_identities=True),
    Prior(3.0 * DEGREE, 3.0 * DEGREE, has_star_identities=True),
    Prior(10.0 * DEGREE, 10.0 * DEGREE, has_star_identities=True),
]
STREAKS = [
    Prior(72.0, 10.0, has_star_identities=True, exposure_s=0.1),
    Prior(3.0 * DEGREE, 10.0, has_star_identities=False, exposure_s=0.1),
]
NOT_IDENTIFIED = [
    Prior(10.0 * DEGREE, 10.0, has_star_identities=False),
    Prior(DEGREE, DEGREE, has_star_identities=False),
]
"""Priors that are too wide to identify stars: more than 5 degrees, or more than five stars in a gate."""


@functools.cache
def run_voyage(prior: Prior, seed: int) -> tuple[SimulatedRun, list[AttitudeOutcome]]:
    run = simulate(prior.scenario, seed)
    return run, run_with_solutions(run)


def estimates(prior: Prior, seed: int) -> list[AttitudeEstimate]:
    return [estimate for outcome in run_voyage(prior, seed)[1] for estimate in outcome.estimates]


def valid_errors(prior: Prior, seed: int) -> list[tuple[FloatArray, FloatArray]]:
    """Return errors of all VALID attitudes at the times of the truth, rad, and their covariances, rad²."""
    run, _ = run_voyage(prior, seed)
    true_nd = dict(zip(run.ins.time_ns[run.truth.ins_index].tolist(), run.truth.rotation_nd, strict=True))
    return [
        (log_rotation(true_nd[one.time_ns] @ one.rotation_nd.T), one.covariance_n)
        for one in estimates(prior, seed)
        if one.status is Status.VALID and one.time_ns in true_nd
    ]


@pytest.mark.parametrize("prior", [*PRIORS, *STREAKS], ids=str)
def test_no_valid_attitude_is_beyond_five_sigma(prior: Prior) -> None:
    """Before: up to 8.9 sigma in the first 0.7 s in five of eleven seeds, with and without star identities.

    With streaks the largest error was 16 sigma.
    """
    ends = []
    for seed in SEEDS:
        found = valid_errors(prior, seed)
        ends.append(float(normalized_error_squared(*found[-1])))
        for error_n, covariance_n in found:
            assert np.all(np.abs(error_n) <= 5.0 * np.sqrt(np.diagonal(covariance_n))), seed
    if prior.is_constant:
        low, high = mean_nees_band(len(SEEDS), 3)
        assert low <= np.mean(ends) <= high


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_the_attitude_is_valid_nine_tenths_of_the_time(prior: Prior) -> None:
    """Before, 0.72 and 0.74 in two of eleven seeds with 3° of heading; with 1°, never VALID in one seed."""
    for seed in SEEDS:
        found = estimates(prior, seed)
        assert len(found) == round(DURATION_S * INS_HZ) + 1
        assert np.mean([one.status is Status.VALID for one in found]) >= 0.9, seed


@pytest.mark.parametrize("prior", [*PRIORS, *NOT_IDENTIFIED], ids=str)
def test_no_attitude_is_valid_before_two_star_measurements_agree(prior: Prior) -> None:
    """Before, the first star measurement made the attitude VALID."""
    for seed in SEEDS:
        used: set[tuple[str, int]] = set()
        for outcome in run_voyage(prior, seed)[1]:
            used |= {(one.measurement.source, one.measurement.time_ns) for one in outcome.decisions if one.accepted}
            if any(one.status is Status.VALID for one in outcome.estimates):
                assert len(used) >= 2, seed
                assert prior not in NOT_IDENTIFIED
                break
