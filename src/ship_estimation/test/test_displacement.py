"""Displacement of a source: noise and drift, permanent displacements and returns.

The expected numbers are those of the simulated rotations; the rate of false steps is compared with the binomial
distribution (scipy).
"""

import numpy as np
import pytest
from scipy.stats import binom

from ship_estimation.recovery.displacement import TOGETHER, Displacement, Displacements, MemoryResidual
from ship_geometry.rotations import ARCSEC

SIGMA = np.array([100.0, 3.0, 3.0]) * ARCSEC / np.sqrt(5.0)
"""Noise of a star sensor's mean over one second at 5 Hz, rad: about the line of sight, and across."""
NOISE = np.diag(SIGMA**2)
HEADING_DRIFT = 2.0 * (72.0 * ARCSEC) ** 2 / 10800.0
"""Growth of the variance of the INS heading, a Gauss-Markov process with 72″ and 10 800 s; rad²/s."""
DRIFT = np.diag([1e-14, HEADING_DRIFT, 1e-14])
EXPECTED = (2.0 * ARCSEC) ** 2 * np.eye(3)


def displaced_each_second(turns: np.ndarray, seed: int, drifts: bool = True) -> list[bool]:
    """Return True for each second after which a source is displaced, for its rotations about Up, rad."""
    rng, source, drift, found = np.random.default_rng(seed), Displacement(), 0.0, []
    variance = EXPECTED.copy()
    for turn in turns:
        drift += rng.normal(0.0, np.sqrt(HEADING_DRIFT)) if drifts else 0.0
        variance = variance + DRIFT
        residual = rng.normal(0.0, SIGMA) + np.array([0.0, turn + drift, 0.0])
        source.add(MemoryResidual(residual, NOISE, variance, DRIFT))
        source.end_second()
        found.append(source.is_displaced)
    return found


def turn_between(arcsec: float, from_s: int, until_s: int, length_s: int) -> np.ndarray:
    """Return the rotation in each second, rad."""
    seconds = np.arange(length_s)
    return arcsec * ARCSEC * ((seconds >= from_s) & (seconds < until_s))


def test_noise_and_drift_are_no_step() -> None:
    """Each second is a false step with a probability of 5.7e-7: at most one in five hours, at 99.9 %."""
    hours = 5
    displaced = sum(any(displaced_each_second(np.zeros(3600), seed)) for seed in range(hours))
    assert displaced <= binom.ppf(0.999, hours * 3600, 5.733e-7)


@pytest.mark.parametrize("arcsec", [20.0, 60.0, 120.0, -3600.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_permanent_displacement_never_ends(arcsec: float, seed: int) -> None:
    """The INS heading drifts by a similar amount within this hour: the sigma of the simulated drift is then 59″."""
    found = displaced_each_second(turn_between(arcsec, 20, 4000, 3600), seed)
    assert not any(found[:20])
    assert all(found[22:])


@pytest.mark.parametrize("minutes", [1, 15, 60])
@pytest.mark.parametrize("arcsec", [20.0, 60.0, 3600.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_displacement_ends_when_the_source_moves_back(minutes: int, arcsec: float, seed: int) -> None:
    end_s = 20 + 60 * minutes
    found = displaced_each_second(turn_between(arcsec, 20, end_s, end_s + 60), seed)
    assert all(found[22:end_s])
    assert not any(found[end_s + 6 :])


@pytest.mark.parametrize("part", [0.5, 0.7])
def test_displacement_does_not_end_with_a_partial_return(part: float) -> None:
    """A return by 0.7 of 120″ leaves 36″.

    A return by 0.7 of 60″ would leave 18″, which noise may explain.
    """
    turns = turn_between(120.0, 20, 100, 300) + turn_between(120.0 * (1.0 - part), 100, 300, 300)
    assert all(displaced_each_second(turns, 1)[22:])


def test_two_displacements_end_when_both_have_ended() -> None:
    found = displaced_each_second(turn_between(60.0, 20, 200, 300) + turn_between(90.0, 60, 120, 300), 1)
    assert all(found[22:200])
    assert not any(found[206:])


def test_a_step_within_a_second_is_measured_whole() -> None:
    """The displacement begins and ends between two measurements of a second: neither part is lost."""
    turns = turn_between(30.0, 20, 100, 160) + turn_between(12.0, 19, 20, 160) + turn_between(18.0, 100, 101, 160)
    found = displaced_each_second(turns, 4)
    assert all(found[22:99])
    assert not any(found[107:])


def test_jump_shown_by_the_ins_itself_is_no_displacement() -> None:
    source, jump = Displacement(), np.array([0.0, 100.0 * ARCSEC, 0.0])
    for second in range(60):
        source.add(MemoryResidual(jump * (second >= 30), NOISE, EXPECTED, DRIFT))
        if second == 30:
            source.inflate(np.outer(jump, jump))
        source.end_second()
    assert not source.is_displaced


def test_ins_jump_as_large_as_a_displacement_resets_it() -> None:
    """The INS rotated by 100″, undetected, and its rates show the rotation back: the stars have not moved."""
    source, turned = Displacement(), np.array([0.0, 100.0 * ARCSEC, 0.0])
    for second in range(60):
        source.add(MemoryResidual(turned * (20 <= second < 40), NOISE, EXPECTED, DRIFT))
        if second == 40:
            assert source.is_displaced
            source.inflate(np.outer(turned, turned))
        source.end_second()
    assert not source.is_displaced


@pytest.mark.parametrize("begins", [20, 38])
def test_a_jump_within_a_second_leaves_no_displacement(begins: int) -> None:
    """Frozen encoders move again: one measurement of that second is from before the jump."""
    source, turned = Displacement(), np.array([0.0, 3600.0 * ARCSEC, 0.0])
    for second in range(60):
        if second == 40:
            source.add(MemoryResidual(turned, NOISE, EXPECTED, DRIFT))
        source.add(MemoryResidual(turned * (begins <= second < 40), NOISE, EXPECTED, DRIFT))
        if second == 40:
            source.inflate(4.0 * np.outer(turned, turned) + ARCSEC**2 * np.eye(3))
        source.end_second()
    assert not source.is_displaced


def test_nan_residual_hides_no_step() -> None:
    source = Displacement()
    for second in range(30):
        turn = np.full(3, np.nan) if second == 10 else np.array([0.0, 60.0 * ARCSEC * (second >= 20), 0.0])
        source.add(MemoryResidual(turn, NOISE, EXPECTED, DRIFT))
        source.end_second()
        assert source.is_displaced == (second >= 20)


FORE, STARBOARD = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
"""Lines of sight of two level star sensors, North and East: each sensor observes a rotation about the other's line."""


def displacements_of_turned_sensors(fore_n: np.ndarray, starboard_n: np.ndarray, seed: int) -> Displacements:
    """Return the displacements of two star sensors that are rotated at 20 s, rotation vectors, rad."""
    rng, found = np.random.default_rng(seed), Displacements()
    for second in range(40):
        for name, sight_n, turn_n in (("star.fore", FORE, fore_n), ("star.starboard", STARBOARD, starboard_n)):
            noise = SIGMA[1] ** 2 * np.eye(3) + (SIGMA[0] ** 2 - SIGMA[1] ** 2) * np.outer(sight_n, sight_n)
            turn = turn_n * (second >= 20) + rng.multivariate_normal(np.zeros(3), noise)
            found.add(name, MemoryResidual(turn, noise, EXPECTED, DRIFT))
        found.end_second()
    return found


@pytest.mark.parametrize("seed", range(20))
def test_common_rotation_that_one_sensor_cannot_observe_is_common(seed: int) -> None:
    """The rotation is 20″ about the line of sight of star.fore, whose noise about this axis is 45″ in a second."""
    assert set(displacements_of_turned_sensors(20.0 * ARCSEC * FORE, 20.0 * ARCSEC * FORE, seed).displaced) == {
        TOGETHER
    }


@pytest.mark.parametrize("seed", range(20))
def test_source_that_moves_by_itself_is_isolated(seed: int) -> None:
    up = np.array([0.0, 60.0 * ARCSEC, 0.0])
    found = displacements_of_turned_sensors(up, 0.0 * up, seed)
    assert set(found.displaced) == {"star.fore"}
    assert not found.is_undecided_by_memory


@pytest.mark.parametrize("seed", range(20))
def test_poorly_observed_rotation_ends_with_the_common_one(seed: int) -> None:
    """The rotation is 20″ about East, the line of sight of star.starboard.

    This sensor starts to measure during the rotation, and can hardly observe the rotation.
    """
    rng, found, turn_n = np.random.default_rng(seed), Displacements(), np.array([0.0, 0.0, 20.0 * ARCSEC])
    for second in range(140):
        for name, sight_n, from_s in (("star.fore", FORE, 0), ("star.starboard", STARBOARD, 60)):
            noise = SIGMA[1] ** 2 * np.eye(3) + (SIGMA[0] ** 2 - SIGMA[1] ** 2) * np.outer(sight_n, sight_n)
            turn = turn_n * (20 <= second < 100) + rng.multivariate_normal(np.zeros(3), noise)
            if second >= from_s:
                found.add(name, MemoryResidual(turn, noise, EXPECTED, DRIFT))
        found.end_second()
        if 22 <= second < 100:
            assert TOGETHER in found.displaced
    assert not found.displaced


def test_steps_in_every_second_for_half_an_hour_leave_a_covariance() -> None:
    """A source that sends two attitudes alternately: each step inflates the displacement again."""
    rng, source = np.random.default_rng(5), Displacement()
    noise = NOISE + (500.0 * ARCSEC) ** 2 * np.outer(np.ones(3), np.ones(3))
    for second in range(1800):
        turn = np.array([0.0, 3600.0 * ARCSEC * (second % 2), 60.0 * ARCSEC * (second % 3)])
        source.add(MemoryResidual(turn + rng.multivariate_normal(np.zeros(3), noise), noise, EXPECTED, DRIFT))
        source.end_second()
    values = np.linalg.eigvalsh(source._covariance)
    np.testing.assert_allclose(source._covariance, source._covariance.T, atol=1e-6 * values[-1])
    assert values[0] >= -1e-6 * values[-1]
    assert source.is_displaced


def test_displacement_in_the_first_measurements_ends() -> None:
    """The stored state has a sigma of 20° after frozen encoders: a fault of the first measurements ends."""
    source, vague = Displacement(), np.deg2rad(20.0) ** 2 * np.eye(3)
    for second in range(30):
        source.add(MemoryResidual(np.array([0.0, 10000.0 * ARCSEC * (second < 4), 0.0]), NOISE, vague, DRIFT))
        source.end_second()
    assert not source.is_displaced
