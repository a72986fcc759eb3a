"""INS parameters from simulated records: model selection, consistent sigmas, and undetermined parameters.

Expected values are those of the simulator; its Schuler INS is integrated by scipy's matrix exponential.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_estimation.innovations.gates import mean_nees_band
from ship_node.parameters.parameter_file import load_config
from ship_studies.ins_noise.fit import FittedModel, fit
from ship_studies.ins_noise.identify_noise_command import Identification, identify, parameter_file_text
from ship_studies.ins_noise.processes import GaussMarkovModel
from ship_studies.ins_noise.star_record import star_record
from ship_testing.noise_sessions import GaussMarkovProcess, draw_session, scenario, simulated_noise_session

pytestmark = pytest.mark.slow  # the fixtures take long

# Two-sided 99.9 % bound of a normal distribution, sigmas.
SIGMAS_99_9 = 3.29
TILT, TILT_S, HEADING, HEADING_S, WHITE = 10.0, 1800.0, 72.0, 10800.0, 3.0
PROCESS = GaussMarkovProcess(TILT, TILT_S, HEADING, HEADING_S, WHITE)
CHANGES = {"tilt": 2.0 * TILT**2 / TILT_S, "heading": 2.0 * HEADING**2 / HEADING_S}


def suite_values(fitted: FittedModel) -> dict[str, tuple[float, float]]:
    """Return name of a suite parameter → value and sigma of its logarithm."""
    return {what.name: fitted.suite_value(what) for what in fitted.model.suite_parameters}


def changes(fitted: FittedModel) -> dict[str, tuple[float, float]]:
    """Return 2 σ²/τ of tilt and heading, arcsec²/s, each with the sigma of its logarithm."""
    assert "2 σ²/τ of heading" in fitted.model.parameters[2].name
    return {axis: (fitted.values[row], fitted.log_sigmas[row]) for axis, row in (("tilt", 0), ("heading", 2))}


@pytest.fixture(scope="module")
def three_hours() -> Identification:
    return identify(simulated_noise_session(scenario(10_800.0, white_sigma_arcsec=WHITE), 1))


def test_three_hours_determine_white_noise_and_change(three_hours: Identification) -> None:
    # Required: white sigma within 10 %, 2 sigma²/tau within its own interval of 99.9 %.
    best = three_hours.best
    assert best.model.name == "gauss_markov"
    assert three_hours.model_choice.startswith("gauss_markov fits: log likelihood ")
    white, log_sigma = suite_values(best)["white_sigma_arcsec"]
    assert white == pytest.approx(WHITE, rel=0.1)
    assert log_sigma < 0.05
    for axis, (value, log_sigma) in changes(best).items():
        assert abs(np.log(value / CHANGES[axis])) < SIGMAS_99_9 * log_sigma
        assert log_sigma < 0.2


def test_three_hours_do_not_separate_sigma_and_time(three_hours: Identification) -> None:
    (tilt,) = (line for line in three_hours.warnings if line.startswith("gauss_markov, tilt: 3 h are "))
    assert "correlation times, too short to separate σ and τ" in tilt
    assert "10 % and 30 % need 200 times" in tilt
    assert tilt.endswith("only 2σ²/τ is determined")
    log_sigmas = {name: log_sigma for name, (_, log_sigma) in suite_values(three_hours.best).items()}
    assert log_sigmas["tilt_time_s"] > 0.3
    assert log_sigmas["heading_time_s"] > 0.5


def test_the_right_model_is_consistent_without_stars(three_hours: Identification) -> None:
    checks = three_hours.outages["gauss_markov"]
    assert [check.intervals for check in checks] == [1, 3, 7, 15]
    assert [check.horizon_s for check in checks] == pytest.approx([5400.0, 2700.0, 1350.0, 675.0])
    assert all(missed.is_consistent for check in checks for missed in check.parts.values())
    assert not any("are inconsistent" in line for line in three_hours.warnings)


@pytest.fixture(scope="module")
def free_ins() -> Identification:
    """An undamped INS, two hours of stars."""
    return identify(simulated_noise_session(scenario(7200.0, model="schuler"), 4))


@pytest.mark.statistics
def test_schuler_is_selected_and_gauss_markov_is_inconsistent(free_ins: Identification) -> None:
    # An independent computation had an error of 13.4″ in the outage, 2.5 times its sigma.
    found = free_ins
    assert found.best.model.name == "schuler"
    assert found.best.aic + 100.0 < found.fitted[1].aic
    start = "the most likely parameters of gauss_markov are inconsistent in an outage: tilt predicted over "
    (line,) = (line for line in found.warnings if line.startswith(start))
    assert "× its σ of" in line
    assert not any("of schuler are inconsistent" in line for line in found.warnings)
    errors = {name: value for name, (value, _) in suite_values(found.best).items()}
    assert errors["white_sigma_arcsec"] == pytest.approx(1.0, rel=0.4)


def test_schuler_is_written_with_what_it_rests_on(free_ins: Identification, tmp_path: Path) -> None:
    file = tmp_path / "noise.yaml"
    file.write_text(parameter_file_text(free_ins), encoding="utf-8")
    ins = load_config(ShipAttitudeConfig, file, "/ship_attitude").ins
    assert ins.model == "schuler"
    found = {name: value for name, (value, _) in suite_values(free_ins.best).items()}
    assert ins.schuler.velocity_sigma_m_per_s == pytest.approx(found["schuler.velocity_sigma_m_per_s"], rel=1e-3)
    assert ins.heading_sigma_arcsec == pytest.approx(found["heading_sigma_arcsec"], rel=1e-3)
    assert ins.schuler.damping_time_s == 0.0
    text = file.read_text(encoding="utf-8")
    assert "        damping_time_s: 0.0  # as configured\n" in text
    assert "# the most likely parameters of gauss_markov are inconsistent in an outage: tilt" in text


def test_two_hundred_times_determine_sigma_and_time() -> None:
    # Required: sigma within 10 %, tau within 30 %.
    slow = {"tilt_sigma_arcsec": 10.0, "tilt_time_s": 60.0, "heading_sigma_arcsec": 20.0, "heading_time_s": 60.0}
    session = simulated_noise_session(scenario(12_000.0, **slow), 1)
    found = suite_values(fit(star_record(session), GaussMarkovModel(session.config.ins)))
    for axis, sigma in (("tilt", 10.0), ("heading", 20.0)):
        assert found[f"{axis}_sigma_arcsec"][0] == pytest.approx(sigma, rel=0.1)
        assert found[f"{axis}_time_s"][0] == pytest.approx(60.0, rel=0.3)
        assert found[f"{axis}_sigma_arcsec"][1] < 0.1
        assert found[f"{axis}_time_s"][1] < 0.3


@pytest.mark.statistics
def test_stated_sigmas_hold_over_many_records() -> None:
    hour, wrong = simulated_noise_session(scenario(2400.0), 1), []
    true = np.log([CHANGES["tilt"], CHANGES["heading"], WHITE])
    for seed in range(6):
        session = draw_session(hour, seed, PROCESS)
        found = fit(star_record(session), GaussMarkovModel(session.config.ins))
        rows = [0, 2, 4]
        wrong.append((np.log(found.values[rows]) - true) / found.log_sigmas[rows])
    low, high = mean_nees_band(len(wrong), 3)
    assert low < np.mean(np.sum(np.square(wrong), axis=1)) < high


def test_without_a_latitude_schuler_is_not_tried() -> None:
    found = identify(simulated_noise_session(scenario(1200.0), 1, with_fixes=False))
    assert [fitted.model.name for fitted in found.fitted] == ["gauss_markov"]
    assert "schuler was not tried: the latitude is unknown without position fixes" in found.warnings


def test_wrong_sigmas_in_the_configuration_do_not_matter() -> None:
    of: Any = scenario(3600.0, white_sigma_arcsec=WHITE)
    found = [
        fit(star_record(session), GaussMarkovModel(session.config.ins))
        for session in (
            simulated_noise_session(of, 3),
            simulated_noise_session(
                of, 3, ins_changes={"tilt_sigma_arcsec": 5.0, "tilt_time_s": 600.0, "white_sigma_arcsec": 1.5}
            ),
        )
    ]
    np.testing.assert_allclose(found[0].log_likelihood, found[1].log_likelihood, atol=0.05)
    np.testing.assert_allclose(found[0].values[[0, 2, 4]], found[1].values[[0, 2, 4]], rtol=0.03)
