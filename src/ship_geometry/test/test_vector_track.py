"""Interpolation of vectors: exact for constant acceleration, the short way round for angles, any order of arrival."""

import itertools

import numpy as np
import pytest

from ship_geometry.tracks.sample_track import VectorSample, VectorTrack

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
GAP_NS = SECOND_NS


def at_s(time_s: float) -> int:
    return START_NS + round(time_s * SECOND_NS)


def track_of(times_s, function, period=np.inf) -> VectorTrack:
    track = VectorTrack(GAP_NS, period)
    for time_s in times_s:
        track.insert(VectorSample(at_s(time_s), np.asarray(function(time_s), dtype=float)))
    return track


def accelerated_vector(time_s: float) -> np.ndarray:
    """A drone that speeds up: differences over equal steps give the rates of a parabola exactly."""
    return np.array([3.0, -2.0, 1.0]) + np.array([10.0, 0.0, -4.0]) * time_s + np.array([1.5, -0.5, 2.0]) * time_s**2


def test_constant_acceleration_is_interpolated_exactly() -> None:
    track = track_of(np.arange(0.0, 1.05, 0.2), accelerated_vector)
    for time_s in (0.2, 0.27, 0.5, 0.7999):
        found = track.at(at_s(time_s))
        assert found is not None
        # Stamps are whole nanoseconds.
        assert found.vector == pytest.approx(accelerated_vector(time_s), abs=1e-7)


def test_at_a_stamp_it_is_the_sample_itself() -> None:
    found = track_of([0.0, 0.2, 0.4], accelerated_vector).at(at_s(0.2))
    assert found is not None
    assert found.vector.tolist() == accelerated_vector(0.2).tolist()
    assert found.noise_gain == 1.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_angles_go_the_short_way_round(way: float) -> None:
    def angles(time_s: float) -> list[float]:
        return [(way * 0.3 * (time_s - 0.5)) % (2.0 * np.pi), 0.2 * time_s]

    track = track_of(np.arange(0.0, 1.05, 0.1), angles, 2.0 * np.pi)
    for time_s in (0.43, 0.47, 0.5, 0.55, 0.61):
        found = track.at(at_s(time_s))
        assert found is not None
        off = found.vector - np.array(angles(time_s))
        assert off - 2.0 * np.pi * np.round(off / (2.0 * np.pi)) == pytest.approx([0.0, 0.0], abs=1e-8)


def test_outside_and_across_a_gap_there_is_nothing() -> None:
    track = track_of([0.0, 0.2, 1.3, 1.5], accelerated_vector)
    assert track.at(at_s(-0.1)) is None
    assert track.at(at_s(0.7)) is None
    assert track.at(at_s(1.6)) is None
    assert track.at(at_s(1.4)) is not None


def test_value_is_final_with_the_neighbour_after_the_interval() -> None:
    track = track_of([0.0, 0.2], accelerated_vector)
    assert not track.is_final_at(at_s(0.1))
    before = track.at(at_s(0.1))
    track.insert(VectorSample(at_s(0.4), accelerated_vector(0.4)))
    assert track.is_final_at(at_s(0.1))
    covered = track.at(at_s(0.1))
    track.insert(VectorSample(at_s(0.6), accelerated_vector(0.6)))
    after = track.at(at_s(0.1))
    assert before.vector.tolist() != covered.vector.tolist() == after.vector.tolist()


def test_any_order_of_arrival_gives_the_same() -> None:
    times_s = [0.0, 0.2, 0.4, 0.6]
    found = set()
    for order in itertools.permutations(times_s):
        result = track_of(order, accelerated_vector).at(at_s(0.31))
        assert result is not None
        found.add((result.vector.tobytes(), result.noise_gain))
    assert len(found) == 1


@pytest.mark.statistics
@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.9])
def test_the_noise_gain_is_the_variance_of_drawn_noise(fraction: float) -> None:
    rng = np.random.default_rng(3)
    draws = rng.standard_normal((4, 20_000))
    track = VectorTrack(GAP_NS)
    for index in range(4):
        track.insert(VectorSample(at_s(0.2 * index), draws[index]))
    found = track.at(at_s(0.2 + 0.2 * fraction))
    assert found is not None
    # Five standard errors of a variance.
    assert np.var(found.vector) == pytest.approx(found.noise_gain, rel=5 * (2 / 20_000) ** 0.5)
