"""Ship motion from the INS: attitude of the deck, rotations, and their covariance."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ship_attitude_star.star_attitude.ins_motion import InsMotion
from ship_estimation.parameters.ship_devices import StarInsConfig
from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.star_directions import fixed_stars
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_stars.attitude_from_stars.exposure import ExposureLength, StarExposure
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.config import MountingConfig
from ship_testing.consistency import sigma_ratio_band
from ship_testing.small_voyage import attitude

MS = 1_000_000
START_NS = 1_700_000_000_000 * MS
HEADING_DEG = 34.4


def rate_d(t_s: float) -> np.ndarray:
    return log_rotation(attitude(t_s - 1e-4, HEADING_DEG).T @ attitude(t_s + 1e-4, HEADING_DEG)) / 2e-4


def sample(time_ms: int, offset_s: float = 0.0, white_n: np.ndarray | None = None) -> AttitudeSample:
    """Return an INS sample stamped ``time_ms`` and valid ``offset_s`` later."""
    t_s = 1e-3 * time_ms + offset_s
    noise = np.eye(3) if white_n is None else exp_rotation(white_n)
    return AttitudeSample(START_NS + time_ms * MS, noise @ attitude(t_s, HEADING_DEG), rate_d(t_s))


def motion(config: StarInsConfig, *samples: AttitudeSample) -> InsMotion:
    result = InsMotion(config)
    for one in samples:
        assert result.add(one) is None
    return result


def exposure_at(time_ns: int) -> StarExposure:
    """An exposure of zero length without stars: only its time matters."""
    nothing = np.zeros(0)
    positions = fixed_stars(nothing, nothing)
    return StarExposure(
        "star.fore", time_ns, nothing.astype(int), np.zeros((0, 3)), nothing, positions, nothing, nothing
    )


def turn_of(some: InsMotion, to_ms: int, from_ms: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation from one time to another, and its covariance."""
    rotations, covariance_d = some.deck_turns(START_NS + to_ms * MS, [exposure_at(START_NS + from_ms * MS)])
    return rotations[0], covariance_d[0, :, 0]


def test_deck_attitude_and_covariance_are_those_of_the_ins() -> None:
    config = StarInsConfig(tilt_sigma_arcsec=10.0, heading_sigma_arcsec=72.0, time_offset_sigma_s=0.0)
    prior = motion(config, *(sample(t) for t in range(0, 200, 40))).deck_prior(START_NS + 80 * MS)
    np.testing.assert_allclose(prior.rotation_nb, attitude(0.08, HEADING_DEG), atol=1e-12)
    sigma = np.sqrt(np.diagonal(prior.covariance_n)) / ARCSEC
    # North, Up, East; white noise of 1″ is included.
    assert sigma == pytest.approx([10.05, 72.007, 10.05], rel=1e-4)


def test_the_effect_of_a_time_offset_is_proportional_to_the_rate() -> None:
    config = StarInsConfig(tilt_sigma_arcsec=0.0, heading_sigma_arcsec=0.0, white_sigma_arcsec=0.0)
    prior = motion(config, *(sample(t) for t in range(0, 200, 40))).deck_prior(START_NS + 80 * MS)
    rate_n = attitude(0.08, HEADING_DEG) @ rate_d(0.08)
    along_n = rate_n / np.linalg.norm(rate_n)
    expected = 0.005 * np.linalg.norm(rate_n)
    assert expected > 30 * ARCSEC
    assert np.sqrt(along_n @ prior.covariance_n @ along_n) == pytest.approx(expected, rel=1e-3)


def test_samples_are_taken_at_their_stamp_plus_the_offset() -> None:
    config = StarInsConfig(time_offset_s=0.02)
    prior = motion(config, *(sample(t, offset_s=0.02) for t in range(0, 200, 40))).deck_prior(START_NS + 80 * MS)
    # Half way between two samples: the cubic between them is good to a tenth of an arcsecond.
    assert np.linalg.norm(log_rotation(prior.rotation_nb @ attitude(0.08, HEADING_DEG).T)) < 0.1 * ARCSEC


def test_the_rotation_is_that_of_the_deck_and_its_correlated_error_cancels() -> None:
    slow = exp_rotation(np.array([10.0, 200.0, -30.0]) * ARCSEC)
    samples = (AttitudeSample(s.time_ns, slow @ s.rotation_nd, s.rate_d) for s in map(sample, range(0, 400, 20)))
    turn, _ = turn_of(motion(StarInsConfig(), *samples), 100, 230)
    expected = attitude(0.1, HEADING_DEG).T @ attitude(0.23, HEADING_DEG)
    assert np.linalg.norm(log_rotation(expected)) > 500 * ARCSEC
    assert np.linalg.norm(log_rotation(turn @ expected.T)) < 0.01 * ARCSEC


def test_the_rotation_error_is_that_of_noise_and_time_offset() -> None:
    config = StarInsConfig(white_sigma_arcsec=1.0, time_offset_sigma_s=0.02)
    expected = attitude(0.1, HEADING_DEG).T @ attitude(0.23, HEADING_DEG)
    rng = np.random.default_rng(5)
    total, draws = 0.0, 300
    for _ in range(draws):
        # The samples are valid at the stamp plus an unknown offset.
        offset_s = 0.02 * rng.standard_normal()
        samples = (sample(t, offset_s, ARCSEC * rng.standard_normal(3)) for t in range(80, 260, 10))
        turn, covariance_d = turn_of(motion(config, *samples), 100, 230)
        error = log_rotation(expected @ turn.T)
        total += error @ np.linalg.solve(covariance_d, error)
    # χ² with 3 degrees of freedom each, 99.9 % band.
    assert 3 - 3.3 * np.sqrt(6 / draws) < total / draws < 3 + 3.3 * np.sqrt(6 / draws)


def test_excess_noise_counts_in_a_rotation() -> None:
    """Samples 50 ms apart have noise of 20″, but 1″ is configured; the INS check detects the excess."""
    config = StarInsConfig(white_sigma_arcsec=1.0, time_offset_sigma_s=0.0)
    expected = attitude(5.0, HEADING_DEG).T @ attitude(5.15, HEADING_DEG)
    true, draws = [sample(t) for t in range(0, 6000, 50)], 100
    squares = variances = 0.0
    for draw in range(draws):
        noise = exp_rotation(20.0 * ARCSEC * np.random.default_rng(draw).standard_normal((len(true), 3)))
        some = InsMotion(config)
        for one, turned in zip(true, noise, strict=True):
            some.add(replace(one, rotation_nd=turned @ one.rotation_nd))
        turn, covariance_d = turn_of(some, 5000, 5150)
        squares += float(np.sum(log_rotation(expected @ turn.T) ** 2))
        variances += float(np.trace(covariance_d))
    # The measured noise has its own uncertainty: sigma is a few per cent too large.
    low, high = sigma_ratio_band(3 * draws)
    assert 0.9 * low < np.sqrt(squares / variances) < high


@pytest.mark.parametrize(
    ("periods", "rates"),
    # Without measured rates, 0.3 periods are left out: the interpolation error is then a fifth of the small variance.
    # This error is estimated from the noise of the samples, so sigma is 10 % too large.
    [*itertools.product([0.0, 0.3, 1.0, 2.5, 10.0], [True]), *itertools.product([0.0, 1.0, 2.5, 10.0], [False])],
)
def test_rotations_over_short_times_have_only_the_noise_not_shared(
    periods: float, rates: bool
) -> None:
    """Rotations to one time from ``periods`` and from twice as many INS periods later, and the mean of the two."""
    period_ms, draws = 20, 400
    config = StarInsConfig(white_sigma_arcsec=1.0, time_offset_sigma_s=0.0)
    rng = np.random.default_rng(round(10.0 * periods) + 1000 * rates)
    times_ms = range(0, 30 * period_ms, period_ms)
    true = [replace(sample(t), rate_d=rate_d(1e-3 * t) if rates else None) for t in times_ms]
    shares = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    squares, variance = np.zeros(len(shares)), np.zeros(len(shares))
    for _ in range(draws):
        some = InsMotion(config)
        for one in true:
            noise = exp_rotation(ARCSEC * rng.standard_normal(3))
            some.track.insert(replace(one, rotation_nd=noise @ one.rotation_nd))
        start_ms = rng.uniform(4.0, 5.0) * period_ms
        to_ns, *from_ns = (START_NS + round((start_ms + k * periods * period_ms) * MS) for k in range(3))
        turns, covariance_d = some.deck_turns(to_ns, [exposure_at(time_ns) for time_ns in from_ns])
        to_nd, *from_nd = (attitude(1e-9 * (t - START_NS), HEADING_DEG) for t in (to_ns, *from_ns))
        errors = [log_rotation(to_nd.T @ one @ turn.T) for one, turn in zip(from_nd, turns, strict=True)]
        if periods == 0.0:
            np.testing.assert_array_equal(covariance_d, 0.0)
            np.testing.assert_allclose(errors, 0.0, atol=1e-15)
            continue
        squares += np.sum((shares @ errors) ** 2, axis=-1)
        variance += np.einsum("sj,jaka,sk->s", shares, covariance_d, shares)
    if periods > 0.0:
        low, high = sigma_ratio_band(3 * draws)
        ratio = np.sqrt(squares / variance)
        assert np.all((low < ratio) & (ratio < high)), ratio


def test_streaks_of_two_sensors_at_one_time_share_the_noise_of_their_correction() -> None:
    """The streaks are reduced with the same samples: all of the noise of the correction is common."""
    some = motion(StarInsConfig(time_offset_sigma_s=0.0), *(sample(t) for t in range(0, 2000, 40)))
    camera = StarCamera(0.06, 24e-6, 511.5, 511.5)
    streak = replace(exposure_at(START_NS + 1013 * MS), length=ExposureLength(0.2, camera, 0.8))
    middle, noise_variance, _ = some.at_middle(streak, MountingConfig(azimuth_deg=0.0, elevation_deg=45.0))
    assert noise_variance > (0.3 * ARCSEC) ** 2
    _, covariance_d = some.deck_turns(streak.time_ns, [middle, middle])
    for one, other in itertools.product(range(2), range(2)):
        np.testing.assert_allclose(covariance_d[one, :, other], noise_variance * np.eye(3), rtol=1e-12)


def test_no_rotation_needs_no_ins() -> None:
    assert motion(StarInsConfig()).is_turn_known(START_NS, START_NS)
    turn, covariance_d = turn_of(motion(StarInsConfig()), 0, 0)
    np.testing.assert_array_equal(turn, np.eye(3))
    np.testing.assert_array_equal(covariance_d, 0.0)


def test_without_ins_samples_nothing_is_known() -> None:
    some = motion(StarInsConfig(), *(sample(t) for t in range(0, 200, 40)))
    assert some.deck_prior(START_NS + 200 * MS) is None
    assert not some.is_turn_known(START_NS, START_NS + 200 * MS)
    assert motion(StarInsConfig()).deck_prior(START_NS) is None


def test_a_sample_is_awaited_only_while_it_may_still_help() -> None:
    some = motion(StarInsConfig(max_gap_s=0.5), *(sample(t) for t in range(0, 200, 40)))
    waits = {time_ms: some.is_awaited(START_NS + time_ms * MS) for time_ms in (100, 161, 659, 660)}
    assert waits == {100: False, 161: True, 659: True, 660: False}
    assert not motion(StarInsConfig()).is_awaited(START_NS)


def test_a_repeated_stamp_is_reported_and_the_order_does_not_matter() -> None:
    """An INS is not used for ten seconds after conflicting samples."""
    one, other = sample(40), sample(40, white_n=np.full(3, ARCSEC))
    decks, later_ms = [], [10_030, 10_070, 10_110]
    for pair in ((one, other), (other, one)):
        some = InsMotion(StarInsConfig())
        rejections = [some.add(s) for s in (sample(0), pair[0], pair[1], sample(80))]
        assert [None if r is None else r.reason for r in rejections] == [None, None, Reason.CONFLICT, None]
        assert some.deck_prior(START_NS + 40 * MS) is None
        assert not some.is_awaited(START_NS + 100 * MS)
        for ms in later_ms:
            assert some.add(sample(ms)) is None
        assert some.deck_prior(START_NS + 10_035 * MS) is None
        decks.append(some.deck_prior(START_NS + 10_050 * MS).rotation_nb)
    np.testing.assert_array_equal(decks[0], decks[1])
    assert motion(StarInsConfig(), one).add(one).reason is Reason.DUPLICATE


def test_a_late_sample_takes_its_place() -> None:
    some = motion(StarInsConfig(), sample(0), sample(80), sample(40))
    np.testing.assert_array_equal(some.deck_prior(START_NS + 40 * MS).rotation_nb, sample(40).rotation_nd)


def test_dropped_data_are_not_needed() -> None:
    some = motion(StarInsConfig(), *(sample(t) for t in range(0, 2000, 40)))
    before = some.deck_prior(START_NS + 500 * MS)
    some.drop_before(START_NS + 500 * MS)
    np.testing.assert_array_equal(some.deck_prior(START_NS + 500 * MS).rotation_nb, before.rotation_nb)
    assert some.deck_prior(START_NS + 100 * MS) is None


def motion_with_jump(size_rad: float) -> InsMotion:
    """Return an INS whose attitude jumps about Up at 0.8 s; five samples are rejected."""
    some, step = InsMotion(StarInsConfig()), np.array([0.0, size_rad, 0.0])
    rejections = []
    for one in map(sample, range(0, 2000, 40)):
        late = one.time_ns >= START_NS + 800 * MS
        rejections.append(some.add(replace(one, rotation_nd=exp_rotation(step) @ one.rotation_nd) if late else one))
    assert [r is None for r in rejections] == [True] * 20 + [False] * 5 + [True] * 25
    return some


def test_after_a_jump_the_covariance_holds_it_and_no_rotation_spans_it() -> None:
    some = motion_with_jump(0.01)
    before, after = (some.deck_prior(START_NS + time_ms * MS) for time_ms in (700, 1500))
    sigma_up = [np.sqrt(prior.covariance_n[1, 1]) for prior in (before, after)]
    assert sigma_up[0] < 0.001
    assert sigma_up[1] == pytest.approx(0.01, rel=0.02)
    assert some.deck_prior(START_NS + 900 * MS) is None
    assert not some.is_turn_known(START_NS + 700 * MS, START_NS + 1500 * MS)
    assert some.is_turn_known(START_NS + 1400 * MS, START_NS + 1500 * MS)


def test_faulty_rates_are_removed_from_the_track() -> None:
    some = InsMotion(StarInsConfig())
    for one in map(sample, range(0, 1000, 40)):
        assert some.add(replace(one, rate_d=np.zeros(3))) is None
    turn, _ = turn_of(some, 20, 500)
    expected = attitude(0.02, HEADING_DEG).T @ attitude(0.5, HEADING_DEG)
    assert np.linalg.norm(log_rotation(turn @ expected.T)) < 2.0 * ARCSEC
