"""The track of attitudes: order of arrival, changes by later samples, gaps, noise, propagation of a sample."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack, InterpolatedAttitude

SECOND_NS = 1_000_000_000
STEP_NS = 100_000_000
MAX_GAP_NS = 450_000_000


def ship_rotation(time_s: float) -> np.ndarray:
    """A ship that turns by 3°/s in a seaway of 10° roll (8 s) and 5° pitch (6 s): the axes do not commute."""
    heading = np.deg2rad(20.0 + 3.0 * time_s)
    pitch = np.deg2rad(5.0) * np.sin(2 * np.pi * time_s / 6.0)
    roll = np.deg2rad(10.0) * np.sin(2 * np.pi * time_s / 8.0 + 0.3)
    return rotation_from_angles(heading, pitch, roll)


def ship_rate(time_s: float) -> np.ndarray:
    """Return the angular velocity in the deck frame, by differences over ± 0.1 ms, to 1e-10 rad/s."""
    turn = ship_rotation(time_s - 1e-4).T @ ship_rotation(time_s + 1e-4)
    return Rotation.from_matrix(turn).as_rotvec() / 2e-4


def sample_at(time_ns: int, with_rate: bool) -> AttitudeSample:
    time_s = time_ns / SECOND_NS
    return AttitudeSample(time_ns, ship_rotation(time_s), ship_rate(time_s) if with_rate else None)


def track_of(samples: list[AttitudeSample]) -> AttitudeTrack:
    track = AttitudeTrack(MAX_GAP_NS)
    for sample in samples:
        track.insert(sample)
    return track


def regular(count: int, with_rate: bool, first_ns: int = 0) -> list[AttitudeSample]:
    return [sample_at(first_ns + k * STEP_NS, with_rate) for k in range(count)]


def irregular(seed: int, count: int = 24) -> list[AttitudeSample]:
    """Return samples with uneven stamps and up to four gaps too long to bridge; none, about half or all have rates."""
    rng = np.random.default_rng(seed)
    steps_ns = rng.integers(10_000_000, 300_000_000, count)
    steps_ns[rng.choice(count, 4, replace=False)] = 600_000_000
    rates = rng.uniform(size=count) < rng.choice([0.0, 0.5, 1.0])
    return [sample_at(int(t), bool(with_rate)) for t, with_rate in zip(np.cumsum(steps_ns), rates, strict=True)]


def times_around(samples: list[AttitudeSample], seed: int, count: int = 150) -> list[int]:
    """Return random times around the samples, and each sample's own stamp, ns."""
    first, last = min(s.time_ns for s in samples), max(s.time_ns for s in samples)
    rng = np.random.default_rng(seed)
    random = rng.integers(first - 2 * STEP_NS, last + 2 * STEP_NS, count).tolist()
    return sorted(random + [s.time_ns for s in samples])


def identical(first: InterpolatedAttitude | None, second: InterpolatedAttitude | None) -> bool:
    """Return True if the attitudes are equal to the last bit."""
    if first is None or second is None:
        return first is second
    return (
        np.array_equal(first.rotation_nd, second.rotation_nd)
        and np.array_equal(first.rate_d, second.rate_d)
        and first.noise_gain == second.noise_gain
        and np.array_equal(first.error_covariance_d, second.error_covariance_d)
    )


def error_arcsec(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.norm(log_rotation(found.T @ true))) / ARCSEC


# -- values


@pytest.mark.parametrize(("with_rate", "bound_arcsec", "rate_bound"), [(True, 0.02, 2e-6), (False, 1.0, 3e-4)])
def test_attitude_and_rate_follow_the_ship(with_rate: bool, bound_arcsec: float, rate_bound: float) -> None:
    """Differenced rates err by step²/6 times the rate's second derivative, 0.11 rad/s³ here: 1.8e-4 rad/s."""
    track = track_of(regular(100, with_rate))
    for time_ns in range(2 * STEP_NS, 97 * STEP_NS, 17_000_001):
        found = track.at(time_ns)
        assert found is not None
        assert error_arcsec(found.rotation_nd, ship_rotation(time_ns / SECOND_NS)) < bound_arcsec
        np.testing.assert_allclose(found.rate_d, ship_rate(time_ns / SECOND_NS), rtol=0, atol=rate_bound)


def test_interpolation_agrees_with_scipys_rotation_spline() -> None:
    samples = regular(100, with_rate=True)
    spline = RotationSpline(
        [s.time_ns / SECOND_NS for s in samples], Rotation.from_matrix([s.rotation_nd for s in samples])
    )
    track = track_of(samples)
    # Not near the ends of the track, where the spline assumes a rate.
    for time_ns in range(15 * STEP_NS, 85 * STEP_NS, 17_000_001):
        found = track.at(time_ns)
        assert found is not None
        assert error_arcsec(found.rotation_nd, spline(time_ns / SECOND_NS).as_matrix()) < 0.02
        np.testing.assert_allclose(found.rate_d, spline(time_ns / SECOND_NS, 1), rtol=0, atol=5e-6)


@pytest.mark.parametrize("with_rate", [True, False])
def test_constant_rotation_is_interpolated_exactly_up_to_half_a_turn(with_rate: bool) -> None:
    """Interpolation is exact for a constant rate below half a turn per step: 170° from sample to sample here."""
    rate = np.deg2rad(1700.0) * np.array([0.6, 0.0, 0.8])
    track = AttitudeTrack(MAX_GAP_NS)
    for k in range(6):
        rotation = Rotation.from_rotvec(rate * k * 0.1).as_matrix()
        # The inner samples have rates: differences over two steps would exceed half a turn. At the ends one step is
        # used.
        track.insert(AttitudeSample(k * STEP_NS, rotation, rate if with_rate or 0 < k < 5 else None))
    for time_ns in range(0, 5 * STEP_NS, 3_333_333):
        found = track.at(time_ns)
        assert found is not None
        expected = Rotation.from_rotvec(rate * time_ns / SECOND_NS).as_matrix()
        np.testing.assert_allclose(found.rotation_nd, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.rate_d, rate, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5, 0.93])
def test_the_chord_is_scipys_slerp_whatever_the_rates(fraction: float) -> None:
    samples = regular(4, with_rate=True)
    time_ns = samples[1].time_ns + round(fraction * STEP_NS)
    found = track_of(samples).at(time_ns)
    slerp = Slerp([0, STEP_NS], Rotation.from_matrix([samples[1].rotation_nd, samples[2].rotation_nd]))
    expected = slerp(time_ns - samples[1].time_ns).as_matrix()
    assert found is not None
    assert found.chord_nd(time_ns) == pytest.approx(expected, abs=1e-15)
    # For a ship in a seaway the chord differs from the cubic, except at the samples.
    assert (error_arcsec(found.rotation_nd, expected) > 1.0) == (fraction > 0.0)


@pytest.mark.parametrize("with_rate", [True, False])
def test_samples_are_returned_unchanged(with_rate: bool) -> None:
    samples = regular(5, with_rate)
    track = track_of(samples)
    for sample in samples:
        found = track.at(sample.time_ns)
        assert found is not None
        assert found.rotation_nd is sample.rotation_nd
        assert found.noise_gain == 1.0
        assert track.get(sample.time_ns) is sample
    assert track.get(samples[2].time_ns + 1) is None


def test_attitude_and_rate_are_continuous_at_the_samples() -> None:
    for samples in (regular(6, with_rate=False), regular(6, with_rate=True)):
        track = track_of(samples)
        before, at, after = (track.at(2 * STEP_NS + shift) for shift in (-1, 0, 1))
        assert before is not None
        assert at is not None
        assert after is not None
        np.testing.assert_allclose([before.rate_d, after.rate_d], [at.rate_d] * 2, rtol=0, atol=1e-8)
        assert error_arcsec(before.rotation_nd, at.rotation_nd) < 1e-3
        assert error_arcsec(at.rotation_nd, after.rotation_nd) < 1e-3


# -- nothing to interpolate


def test_outside_the_track_there_is_no_attitude() -> None:
    assert AttitudeTrack(MAX_GAP_NS).at(0) is None
    assert AttitudeTrack(MAX_GAP_NS).newest is None
    track = track_of(regular(3, with_rate=True))
    assert track.at(-1) is None
    assert track.at(2 * STEP_NS + 1) is None
    assert len(track) == 3


def test_gap_is_not_bridged_neither_by_attitude_nor_by_differences() -> None:
    before, after = regular(4, with_rate=False), regular(4, with_rate=False, first_ns=3 * STEP_NS + MAX_GAP_NS + 1)
    track = track_of(before + after)
    assert track.at(3 * STEP_NS + MAX_GAP_NS // 2) is None
    # Each side is independent of the other.
    assert identical(track.at(2 * STEP_NS + 1), track_of(before).at(2 * STEP_NS + 1))
    last_ns = after[1].time_ns - 1
    assert identical(track.at(last_ns), track_of(after).at(last_ns))


def test_gap_of_exactly_the_limit_is_bridged() -> None:
    track = track_of([sample_at(0, True), sample_at(MAX_GAP_NS, True)])
    assert track.at(MAX_GAP_NS // 2) is not None


def test_lone_sample_between_gaps_stands_still() -> None:
    track = track_of([sample_at(k * SECOND_NS, False) for k in range(3)])
    found = track.at(SECOND_NS)
    assert found is not None
    np.testing.assert_array_equal(found.rate_d, 0.0)


# -- order of arrival


@pytest.mark.parametrize("seed", range(20))
def test_any_order_of_arrival_gives_the_same_track_to_the_bit(seed: int) -> None:
    samples = irregular(seed)
    in_order = track_of(samples)
    shuffled = track_of([samples[k] for k in np.random.default_rng(seed).permutation(len(samples))])
    assert all(identical(in_order.at(t), shuffled.at(t)) for t in times_around(samples, seed))
    for ahead_s in (-0.02, 0.0, 0.02):
        assert identical(in_order.propagate_newest(ahead_s), shuffled.propagate_newest(ahead_s))


@pytest.mark.parametrize("seed", range(20))
def test_insert_returns_the_stamp_after_which_attitudes_change(seed: int) -> None:
    """Nothing has changed at or before the returned stamp; None means that no final value has changed."""
    samples = irregular(seed)
    rng = np.random.default_rng(seed)
    times = times_around(samples, seed, 50)
    track = AttitudeTrack(MAX_GAP_NS)
    for k in rng.permutation(len(samples)):
        before = {t: track.at(t) for t in times}
        covered = {t for t in times if track.is_final_at(t)}
        changed_after_ns = track.insert(samples[k])
        kept = [t for t in times if (t in covered if changed_after_ns is None else t <= changed_after_ns)]
        assert all(identical(before[t], track.at(t)) for t in kept)


def test_late_sample_at_the_very_front_changes_its_own_time() -> None:
    samples = regular(4, with_rate=True)
    track = track_of(samples[1:])
    assert track.at(0) is None
    changed_after_ns = track.insert(samples[0])
    assert track.at(0) is not None
    assert changed_after_ns is not None
    assert changed_after_ns < 0


@pytest.mark.parametrize("index", [0, 1, 3, 5])
@pytest.mark.parametrize("with_rate", [True, False])
def test_replaced_sample_counts_as_if_it_had_come_first(index: int, with_rate: bool) -> None:
    samples = regular(6, with_rate)
    other = replace(samples[index], rotation_nd=ship_rotation(40.0))
    track = track_of(samples)
    changed_after_ns = track.insert(other)
    expected = track_of([*samples[:index], other, *samples[index + 1 :]])
    assert len(track) == 6
    assert track.get(other.time_ns) is other
    assert all(identical(track.at(t), expected.at(t)) for t in times_around(samples, 1))
    assert changed_after_ns is not None
    assert changed_after_ns < other.time_ns


# -- what later samples may still change


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_final_values_do_not_change_when_samples_arrive_in_order(seed: int) -> None:
    samples = irregular(seed)
    complete, growing = track_of(samples), AttitudeTrack(MAX_GAP_NS)
    times = times_around(samples, seed, 50)
    for sample in samples:
        growing.insert(sample)
        for t in (t for t in times if growing.is_final_at(t)):
            assert identical(growing.at(t), complete.at(t))


def test_values_are_final_up_to_the_newest_sample_with_rates_and_the_one_before_without() -> None:
    with_rates, without = track_of(regular(4, with_rate=True)), track_of(regular(4, with_rate=False))
    assert with_rates.is_final_at(3 * STEP_NS)
    assert not with_rates.is_final_at(3 * STEP_NS + 1)
    assert without.is_final_at(2 * STEP_NS)
    assert not without.is_final_at(2 * STEP_NS + 1)
    # A value that is not final is changed by the next sample.
    early = without.at(2 * STEP_NS + STEP_NS // 2)
    without.insert(sample_at(4 * STEP_NS, False))
    assert not identical(early, without.at(2 * STEP_NS + STEP_NS // 2))
    assert not AttitudeTrack(MAX_GAP_NS).is_final_at(0)


@pytest.mark.parametrize("seed", range(8))
def test_drop_before_keeps_all_that_is_needed_and_no_more(seed: int) -> None:
    samples = irregular(seed, 12)
    times = times_around(samples, seed, 30)
    newest_ns = samples[-1].time_ns
    for oldest_ns in times:
        full, trimmed = track_of(samples), track_of(samples)
        trimmed.drop_before(oldest_ns)
        assert all(identical(full.at(t), trimmed.at(t)) for t in times if t >= oldest_ns)
        assert identical(full.propagate_newest(0.01), trimmed.propagate_newest(0.01))
        recent = max(8, sum(s.time_ns >= newest_ns - SECOND_NS for s in samples))
        assert len(trimmed) <= max(3 + sum(s.time_ns > oldest_ns for s in samples), recent)
        # The track grows as before.
        for track in (full, trimmed):
            track.insert(sample_at(newest_ns + STEP_NS, False))
        assert identical(full.at(newest_ns + STEP_NS // 2), trimmed.at(newest_ns + STEP_NS // 2))


# -- noise of the samples


def gain_by_response(samples: list[AttitudeSample], time_ns: int) -> float:
    """Return the sum of the squared responses of the interpolated attitude to a small rotation of each sample.

    All samples have the same attitude, so that the responses are plain weights.
    """
    step = 1e-6
    nominal = track_of(samples).at(time_ns)
    assert nominal is not None
    total = 0.0
    for k, sample in enumerate(samples):
        turned = replace(sample, rotation_nd=Rotation.from_rotvec([0.0, step, 0.0]).as_matrix() @ sample.rotation_nd)
        found = track_of([*samples[:k], turned, *samples[k + 1 :]]).at(time_ns)
        assert found is not None
        total += (log_rotation(found.rotation_nd @ nominal.rotation_nd.T)[1] / step) ** 2
    return total


@pytest.mark.parametrize("seed", range(6))
def test_noise_gain_is_the_sum_of_squared_weights_also_at_edges_gaps_and_uneven_stamps(seed: int) -> None:
    rotation = ship_rotation(1.0)
    samples = [
        AttitudeSample(s.time_ns, rotation, None if s.rate_d is None else np.zeros(3)) for s in irregular(seed, 8)
    ]
    track = track_of(samples)
    for time_ns in times_around(samples, seed, 20):
        found = track.at(time_ns)
        if found is not None:
            assert found.noise_gain == pytest.approx(gain_by_response(samples, time_ns), rel=1e-4)


@pytest.mark.parametrize("with_rate", [True, False])
@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.8])
def test_noise_gain_is_the_variance_of_noisy_tracks(with_rate: bool, fraction: float) -> None:
    sigma, draws = 10.0 * ARCSEC, 1000
    samples = regular(6, with_rate)
    time_ns = 2 * STEP_NS + round(fraction * STEP_NS)
    nominal = track_of(samples).at(time_ns)
    assert nominal is not None
    noise = Rotation.from_rotvec(sigma * np.random.default_rng(1).standard_normal((draws * 6, 3)))
    turns = noise.as_matrix().reshape(draws, 6, 3, 3)
    errors = np.empty((draws, 3))
    for draw in range(draws):
        noisy = [replace(s, rotation_nd=turns[draw, k] @ s.rotation_nd) for k, s in enumerate(samples)]
        found = track_of(noisy).at(time_ns)
        assert found is not None
        errors[draw] = log_rotation(found.rotation_nd @ nominal.rotation_nd.T)
    # Four standard errors of a variance from three axes of all draws.
    assert np.mean(errors**2) / sigma**2 == pytest.approx(nominal.noise_gain, rel=4 * (2 / (3 * draws)) ** 0.5)


# -- the newest sample, propagated by a clock offset


@pytest.mark.slow
@pytest.mark.parametrize("ahead_s", [-0.02, -0.005, 0.0, 0.005, 0.02])
def test_newest_sample_propagated_by_measured_rates(ahead_s: float) -> None:
    """The propagation is of second order: its error comes from the third derivative, 0.1 rad/s³ in this seaway."""
    for count in range(20, 60):
        track = track_of(regular(count, with_rate=True))
        time_s = (count - 1) * 0.1
        moved = track.propagate_newest(ahead_s)
        error = error_arcsec(moved.rotation_nd, ship_rotation(time_s + ahead_s)) * ARCSEC
        # The acceleration is that of the last interval: half a step (0.05 s) old.
        assert error <= 0.1 * (ahead_s**2 * 0.05 / 2 + abs(ahead_s) ** 3 / 6) * 1.5 + 1e-15
        np.testing.assert_allclose(moved.rate_d, ship_rate(time_s + ahead_s), rtol=0, atol=0.01 * abs(ahead_s) + 1e-9)
        assert moved.noise_gain == 1.0


def test_newest_sample_propagated_forth_and_back_is_not_the_same_attitude() -> None:
    track = track_of(regular(20, with_rate=True))
    turn = log_rotation(track.propagate_newest(-0.005).rotation_nd.T @ track.propagate_newest(0.005).rotation_nd)
    np.testing.assert_allclose(turn, 0.01 * ship_rate(1.9), rtol=0, atol=1e-7)


@pytest.mark.parametrize("ahead_s", [-0.04, -0.005, 0.0, 0.005, 0.04])
def test_newest_sample_propagated_by_differences(ahead_s: float) -> None:
    samples = regular(20, with_rate=False)
    moved = track_of(samples).propagate_newest(ahead_s)
    # Three samples give a propagation of second order; the third derivative is below 0.15 rad/s³.
    error = error_arcsec(moved.rotation_nd, ship_rotation(1.9 + ahead_s)) * ARCSEC
    assert error <= 0.15 / 6.0 * abs(ahead_s) * (ahead_s + 0.1) * (ahead_s + 0.2) + 1e-15
    still = [AttitudeSample(s.time_ns, np.eye(3)) for s in samples]
    responses = []
    for k in (-3, -2, -1):
        turned = list(still)
        turned[k] = replace(still[k], rotation_nd=Rotation.from_rotvec([1e-6, 0.0, 0.0]).as_matrix())
        responses.append(log_rotation(track_of(turned).propagate_newest(ahead_s).rotation_nd)[0] / 1e-6)
    assert moved.noise_gain == pytest.approx(np.sum(np.square(responses)), rel=1e-6)


def test_single_sample_is_propagated_by_its_rate_or_not_at_all() -> None:
    with_rate = track_of([sample_at(0, True)]).propagate_newest(0.01)
    np.testing.assert_allclose(
        log_rotation(ship_rotation(0.0).T @ with_rate.rotation_nd), 0.01 * ship_rate(0.0), atol=1e-15
    )
    without = track_of([sample_at(0, False)]).propagate_newest(0.01)
    np.testing.assert_array_equal(without.rotation_nd, ship_rotation(0.0))
    assert without.noise_gain == 1.0
