"""What the INS says of the ship's motion: about where the deck is, how it turned, and how well that is known."""

from dataclasses import replace

import numpy as np
import pytest

from ship_attitude_star.guards.stream_guards import StreamGuards
from ship_attitude_star.star_attitude.ins_motion import InsMotion
from ship_estimation.ins import StarInsConfig
from ship_estimation.refusals import Reason
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_testing.small_voyage import attitude

MS = 1_000_000
START_NS = 1_700_000_000_000 * MS
HEADING_DEG = 34.4


def rate_d(t_s: float) -> np.ndarray:
    return log_rotation(attitude(t_s - 1e-4, HEADING_DEG).T @ attitude(t_s + 1e-4, HEADING_DEG)) / 2e-4


def sample(time_ms: int, offset_s: float = 0.0, white_n: np.ndarray | None = None) -> AttitudeSample:
    """Stamped ``time_ms``, valid ``offset_s`` later."""
    t_s = 1e-3 * time_ms + offset_s
    noise = np.eye(3) if white_n is None else exp_rotation(white_n)
    return AttitudeSample(START_NS + time_ms * MS, noise @ attitude(t_s, HEADING_DEG), rate_d(t_s))


def motion(config: StarInsConfig, *samples: AttitudeSample) -> InsMotion:
    result = InsMotion(config, StreamGuards(config))
    for one in samples:
        assert result.add(one) is None
    return result


def test_the_deck_is_where_the_ins_has_it_and_as_uncertain_as_configured() -> None:
    config = StarInsConfig(tilt_sigma_arcsec=10.0, heading_sigma_arcsec=72.0, time_offset_sigma_s=0.0)
    prior = motion(config, *(sample(t) for t in range(0, 200, 40))).deck(START_NS + 80 * MS)
    np.testing.assert_allclose(prior.rotation_nb, attitude(0.08, HEADING_DEG), atol=1e-12)
    sigma = np.sqrt(np.diagonal(prior.covariance_n)) / ARCSEC
    # North, Up, East, with a white arcsecond.
    assert sigma == pytest.approx([10.05, 72.007, 10.05], rel=1e-4)


def test_a_time_offset_is_as_large_as_the_ship_turns_fast() -> None:
    config = StarInsConfig(tilt_sigma_arcsec=0.0, heading_sigma_arcsec=0.0, white_sigma_arcsec=0.0)
    prior = motion(config, *(sample(t) for t in range(0, 200, 40))).deck(START_NS + 80 * MS)
    rate_n = attitude(0.08, HEADING_DEG) @ rate_d(0.08)
    along_n = rate_n / np.linalg.norm(rate_n)
    expected = 0.005 * np.linalg.norm(rate_n)
    assert expected > 30 * ARCSEC
    assert np.sqrt(along_n @ prior.covariance_n @ along_n) == pytest.approx(expected, rel=1e-3)


def test_samples_are_taken_at_their_stamp_plus_the_offset() -> None:
    config = StarInsConfig(time_offset_s=0.02)
    prior = motion(config, *(sample(t, offset_s=0.02) for t in range(0, 200, 40))).deck(START_NS + 80 * MS)
    # Half way between two samples: the cubic between them is good to a tenth of an arcsecond.
    assert np.linalg.norm(log_rotation(prior.rotation_nb @ attitude(0.08, HEADING_DEG).T)) < 0.1 * ARCSEC


def test_the_turn_is_that_of_the_deck_and_its_slow_error_cancels() -> None:
    slow = exp_rotation(np.array([10.0, 200.0, -30.0]) * ARCSEC)
    samples = (AttitudeSample(s.time_ns, slow @ s.rotation_nd, s.rate_d) for s in map(sample, range(0, 400, 20)))
    turn, _ = motion(StarInsConfig(), *samples).turn(START_NS + 100 * MS, START_NS + 230 * MS)
    expected = attitude(0.1, HEADING_DEG).T @ attitude(0.23, HEADING_DEG)
    assert np.linalg.norm(log_rotation(expected)) > 500 * ARCSEC
    assert np.linalg.norm(log_rotation(turn @ expected.T)) < 0.01 * ARCSEC


def test_the_error_of_the_turn_is_what_noise_and_time_offset_make_of_it() -> None:
    config = StarInsConfig(white_sigma_arcsec=1.0, time_offset_sigma_s=0.02)
    expected = attitude(0.1, HEADING_DEG).T @ attitude(0.23, HEADING_DEG)
    rng = np.random.default_rng(5)
    total, draws = 0.0, 300
    for _ in range(draws):
        # Valid at the stamp plus an offset that nobody knows.
        offset_s = 0.02 * rng.standard_normal()
        samples = (sample(t, offset_s, ARCSEC * rng.standard_normal(3)) for t in range(80, 260, 10))
        turn, covariance_d = motion(config, *samples).turn(START_NS + 100 * MS, START_NS + 230 * MS)
        error = log_rotation(expected @ turn.T)
        total += error @ np.linalg.solve(covariance_d, error)
    # χ² with 3 degrees of freedom each, 99.9 % band.
    assert 3 - 3.3 * np.sqrt(6 / draws) < total / draws < 3 + 3.3 * np.sqrt(6 / draws)


def test_no_way_needs_no_ins() -> None:
    turn, covariance_d = motion(StarInsConfig()).turn(START_NS, START_NS)
    np.testing.assert_array_equal(turn, np.eye(3))
    np.testing.assert_array_equal(covariance_d, 0.0)


def test_where_the_ins_does_not_reach_it_says_nothing() -> None:
    some = motion(StarInsConfig(), *(sample(t) for t in range(0, 200, 40)))
    assert some.deck(START_NS + 200 * MS) is None
    assert some.turn(START_NS, START_NS + 200 * MS) is None
    assert motion(StarInsConfig()).deck(START_NS) is None


def test_a_sample_is_awaited_only_while_it_may_still_help() -> None:
    some = motion(StarInsConfig(max_gap_s=0.5), *(sample(t) for t in range(0, 200, 40)))
    waits = {time_ms: some.awaited(START_NS + time_ms * MS) for time_ms in (100, 161, 659, 660)}
    assert waits == {100: False, 161: True, 659: True, 660: False}
    assert not motion(StarInsConfig()).awaited(START_NS)


def test_the_same_stamp_again_is_told_and_the_order_does_not_matter() -> None:
    one, other = sample(40), sample(40, white_n=np.full(3, ARCSEC))
    decks = []
    for pair in ((one, other), (other, one)):
        some = InsMotion(StarInsConfig(), StreamGuards(StarInsConfig()))
        refusals = [some.add(s) for s in (sample(0), pair[0], pair[1], sample(80))]
        assert [None if r is None else r.reason for r in refusals] == [None, None, Reason.CONFLICT, None]
        decks.append(some.deck(START_NS + 40 * MS).rotation_nb)
    np.testing.assert_array_equal(decks[0], decks[1])
    assert motion(StarInsConfig(), one).add(one).reason is Reason.DUPLICATE


def test_a_late_sample_takes_its_place() -> None:
    some = motion(StarInsConfig(), sample(0), sample(80), sample(40))
    np.testing.assert_array_equal(some.deck(START_NS + 40 * MS).rotation_nb, sample(40).rotation_nd)


def test_what_is_dropped_is_needed_no_more() -> None:
    some = motion(StarInsConfig(), *(sample(t) for t in range(0, 2000, 40)))
    before = some.deck(START_NS + 500 * MS)
    some.drop_before(START_NS + 500 * MS)
    np.testing.assert_array_equal(some.deck(START_NS + 500 * MS).rotation_nb, before.rotation_nb)
    assert some.deck(START_NS + 100 * MS) is None


def jumped_motion(size_rad: float) -> InsMotion:
    """Its attitude jumps about Up at 0.8 s; five samples are refused."""
    some, step = InsMotion(StarInsConfig(), StreamGuards(StarInsConfig())), np.array([0.0, size_rad, 0.0])
    refusals = []
    for one in map(sample, range(0, 2000, 40)):
        late = one.time_ns >= START_NS + 800 * MS
        refusals.append(some.add(replace(one, rotation_nd=exp_rotation(step) @ one.rotation_nd) if late else one))
    assert [r is None for r in refusals] == [True] * 20 + [False] * 5 + [True] * 25
    return some


def test_mend_10_after_a_jump_the_ins_may_be_as_far_off_and_no_way_leads_across() -> None:
    some = jumped_motion(0.01)
    before, after = (some.deck(START_NS + time_ms * MS) for time_ms in (700, 1500))
    sigma_up = [np.sqrt(prior.covariance_n[1, 1]) for prior in (before, after)]
    assert sigma_up[0] < 0.001
    assert sigma_up[1] == pytest.approx(0.01, rel=0.02)
    assert some.deck(START_NS + 900 * MS) is None
    assert some.turn(START_NS + 700 * MS, START_NS + 1500 * MS) is None
    assert some.turn(START_NS + 1400 * MS, START_NS + 1500 * MS) is not None


def test_mend_06_rates_that_are_none_leave_the_track() -> None:
    some = InsMotion(StarInsConfig(), StreamGuards(StarInsConfig()))
    for one in map(sample, range(0, 1000, 40)):
        assert some.add(replace(one, rate_d=np.zeros(3))) is None
    turn, _ = some.turn(START_NS + 20 * MS, START_NS + 500 * MS)
    expected = attitude(0.02, HEADING_DEG).T @ attitude(0.5, HEADING_DEG)
    assert np.linalg.norm(log_rotation(turn @ expected.T)) < 2.0 * ARCSEC
