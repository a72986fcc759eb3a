"""False matches of identities found by prediction: false detections, wide gates, single stars, and rejections."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import poisson

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.identification import find_candidates
from ship_stars.attitude_from_stars.selection import (
    MAX_FALSE_MATCHES,
    StarPrior,
    expected_false_matches,
    perpendicular_basis,
    select_stars,
)
from ship_stars.attitude_from_stars.solution import SolutionStatus, solve_with_fallback
from ship_stars.sky.sky_model import SkyModel
from ship_testing.star_sky import (
    ROTATION_ND,
    SENSORS,
    SIGMA,
    TIME_NS,
    configuration,
    exposure_of,
    ins_track,
    sky_at_anchor,
    without_identity,
)

DEGREE = 3600.0
ROTATION_DS = rotation_from_angles(*np.deg2rad([SENSORS["fore"]["azimuth_deg"], SENSORS["fore"]["elevation_deg"], 0.0]))
ROTATION_NS = ROTATION_ND @ ROTATION_DS


@pytest.fixture(scope="module")
def sky_model() -> SkyModel:
    return sky_at_anchor(configuration())


def prior_of(heading_arcsec: float, tilt_arcsec: float) -> StarPrior:
    sigma = np.array([tilt_arcsec, heading_arcsec, tilt_arcsec]) * ARCSEC
    return StarPrior(ROTATION_NS, np.diag(sigma**2))


def wide_prior(heading_arcsec: float, tilt_arcsec: float = 10.0, **changes) -> ShipAttitudeConfig:
    ins = {"heading_sigma_arcsec": heading_arcsec, "tilt_sigma_arcsec": tilt_arcsec}
    return configuration(ins=ins, **changes)


def false_exposure(sky_model: SkyModel, count: int, rng: np.random.Generator) -> StarExposure:
    """Return false detections anywhere in the field, of any magnitude."""
    directions_s = np.column_stack([np.ones(count), np.tan(np.deg2rad(rng.uniform(-5.0, 5.0, (count, 2))))])
    directions_s /= np.linalg.norm(directions_s, axis=-1, keepdims=True)
    exposure = without_identity(exposure_of(sky_model, "fore", count))
    return replace(exposure, directions_s=directions_s, magnitude=rng.uniform(2.0, 6.0, count))


@pytest.mark.parametrize("prior", [(72.0, 10.0), (DEGREE, 10.0), (3.0 * DEGREE, 10.0)], ids=str)
def test_the_number_of_false_matches_is_the_expected_one(sky_model: SkyModel, prior: tuple[float, float]) -> None:
    """Random false detections are matched; the bounds are Poisson quantiles for 1/3 and 3 times the expected number."""
    known, rng, fitting, expected = prior_of(*prior), np.random.default_rng(1), 0, 0.0
    for _ in range(60):
        # The position of the field in the sky is drawn too, because stars are not uniformly distributed.
        turn = exp_rotation(np.array([0.0, rng.uniform(0.0, 2.0 * np.pi), 0.0]))
        moved = StarPrior(turn @ known.rotation_nb, turn @ known.covariance_n @ turn.T)
        exposure, sky = false_exposure(sky_model, 4, rng), sky_model.sky_at(TIME_NS)
        found = find_candidates(exposure.directions_s, exposure.sigma, exposure.magnitude, None, moved, sky)
        fitting += int(np.count_nonzero(found.is_match))
        basis = perpendicular_basis(exposure.directions_s @ moved.rotation_nb.T)
        density = sky.bright.density(exposure.magnitude, 1.5)
        for row in range(4):
            turned = basis[row] @ np.cross(np.eye(3), moved.rotation_nb @ exposure.directions_s[row])
            gate = turned @ moved.covariance_n @ turned.T + SIGMA**2 * np.eye(2)
            expected += density[row] * np.pi * chi_square_gate(0.9999, 2) * np.sqrt(np.linalg.det(gate))
    # Near the Milky Way there are up to three times as many stars as on average.
    assert poisson.ppf(5e-4, expected / 3.0) <= fitting <= poisson.ppf(1.0 - 5e-4, 3.0 * expected)


@pytest.mark.statistics
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("prior", [(DEGREE, 10.0), (3.0 * DEGREE, 10.0), (3.0 * DEGREE, 3.0 * DEGREE)], ids=str)
def test_false_detections_alone_never_give_an_attitude(
    sky_model: SkyModel, prior: tuple[float, float], count: int
) -> None:
    """Without MAX_FALSE_MATCHES, 13 of 240 such exposures gave a VALID attitude with an error of degrees."""
    ship_filter = ShipFilter(wide_prior(*prior))
    for seed in range(60):
        exposure = false_exposure(sky_model, count, np.random.default_rng([3, seed]))
        _, decision = ship_filter.step(ship_filter.initial_state(), exposure, ins_track(), sky_model)
        assert not decision.accepted, seed
        assert decision.reason in (Reason.UNIDENTIFIED, Reason.MISIDENTIFIED)


@pytest.mark.parametrize("off_deg", [-9.0, -3.0, 0.5, 3.0, 6.0])
def test_stars_without_identity_are_identified_with_a_wide_heading(sky_model: SkyModel, off_deg: float) -> None:
    """The gate is curved: a star rotated by 3° about the vertical is 283″ off the gate's tangent."""
    ship_filter = ShipFilter(wide_prior(3.0 * DEGREE))
    exposure = exposure_of(sky_model, "fore", 8, np.random.default_rng(3))
    error_n = np.deg2rad([0.0, off_deg, 0.0])
    state, decision = ship_filter.step(
        ship_filter.initial_state(), without_identity(exposure), ins_track(error_n=error_n), sky_model
    )
    assert decision.accepted
    used = {name.rpartition(" ")[0] for name in decision.components}
    assert len(used) >= 4
    assert used <= {f"HIP {hip}" for hip in exposure.hip}
    found = state.mean[ship_filter.model.state_indices("ins.attitude")]
    assert np.linalg.norm(found - error_n) < 60.0 * ARCSEC


@pytest.mark.parametrize(
    ("heading", "tilt", "named", "used"),
    [
        (72.0, 10.0, True, True),
        (72.0, 10.0, False, True),
        (DEGREE, 10.0, True, True),
        (DEGREE, 10.0, False, False),
        (3.0 * DEGREE, 3.0 * DEGREE, True, False),
        (3.0 * DEGREE, 3.0 * DEGREE, False, False),
    ],
)
def test_a_single_star_is_accepted_if_the_prior_leaves_no_rival(
    sky_model: SkyModel, heading: float, tilt: float, named: bool, used: bool
) -> None:
    ship_filter = ShipFilter(wide_prior(heading, tilt))
    exposure = exposure_of(sky_model, "fore", 1)
    exposure = exposure if named else without_identity(exposure)
    state, decision = ship_filter.step(ship_filter.initial_state(), exposure, ins_track(), sky_model)
    assert decision.accepted == used
    if not used:
        assert decision.reason is Reason.UNIDENTIFIED
        assert not state.last_used_ns


def test_each_further_star_reduces_false_matches(sky_model: SkyModel) -> None:
    prior = prior_of(3.0 * DEGREE, 3.0 * DEGREE)
    _, stars, _ = visible_stars(exposure_of(sky_model, "fore", 6), sky_model, prior)
    basis, numbers = perpendicular_basis(stars.reference_n), []
    for count in range(1, 7):
        members = np.arange(6) < count
        numbers.append(expected_false_matches(stars, members, basis, prior.covariance_n))
    assert numbers == sorted(numbers, reverse=True)
    assert numbers[0] > 1.0 > MAX_FALSE_MATCHES > numbers[2]
    assert select_stars(stars, prior).members.all()


def test_the_solver_of_solutions_has_the_same_limit(sky_model: SkyModel) -> None:
    """Two stars with identities are verified by a prior of 3° in all axes, not by one of 30°."""
    for sigma, status in ((3.0 * DEGREE, SolutionStatus.VALID), (30.0 * DEGREE, SolutionStatus.INVALID)):
        prior = prior_of(sigma, sigma)
        _, stars, _ = visible_stars(exposure_of(sky_model, "fore", 2), sky_model, prior)
        solution, against = solve_with_fallback(stars, prior)
        assert (solution.status, against) == (status, False)
    assert solution.rejection.reason is Reason.UNIDENTIFIED


def test_successive_unidentified_exposures_inflate_the_covariance(sky_model: SkyModel) -> None:
    """INS error 6′, stated sigma 10″: no star is identified until rejections inflate the covariance."""
    ship_filter = ShipFilter(wide_prior(10.0, gate={"reopen_after": 3, "reopen_factor": 400.0}))
    state, error_n, reasons = ship_filter.initial_state(), np.deg2rad([0.0, 0.1, 0.0]), []
    runs: list[int] = []
    before: FloatArray = state.covariance
    for step in range(5):
        time_ns = TIME_NS + 200_000_000 * step
        exposure = without_identity(exposure_of(sky_model, "fore", 8, np.random.default_rng(step), time_ns))
        state, decision = ship_filter.step(state, exposure, ins_track(time_ns, error_n), sky_model)
        reasons.append(decision.reason)
        runs.append(state.consecutive_rejections["star.fore"])
        if step == 1:
            assert state.covariance.tobytes() == before.tobytes()
    assert reasons[:3] == [Reason.UNIDENTIFIED] * 3
    assert runs[:3] == [1, 2, 3]
    assert reasons[3] is Reason.NONE
    assert runs[3] == 0
