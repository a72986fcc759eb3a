"""Two interleaved streams are detected; a healthy stream counts as one, also after a second stream has ended."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.health.duplicate_publishers import WINDOW, InterleavedStreams
from ship_testing.ins_streams import CALM, STORM, SWELL, stream

LEAST = 40.0 * ARCSEC


def stream_distances(samples: list[AttitudeSample]) -> list[float]:
    """Return the detected distance of two streams after each sample, 0 for one stream."""
    streams, distances = InterleavedStreams(LEAST), []
    for sample in samples:
        streams.add(sample.time_ns, sample.rotation_nd.ravel())
        distances.append(streams.distance)
    return distances


def with_another(samples: list[AttitudeSample], off_deg: float, every: int = 2) -> list[AttitudeSample]:
    """Return the samples with every ``every``-th sample from another INS, ``off_deg`` off in yaw."""
    other_d = exp_rotation([0.0, np.deg2rad(off_deg), 0.0])
    return [
        sample if n % every else replace(sample, rotation_nd=sample.rotation_nd @ other_d)
        for n, sample in enumerate(samples)
    ]


@pytest.mark.parametrize("amplitude_deg", [CALM, SWELL])
@pytest.mark.parametrize(
    ("rate_hz", "off_deg", "every"), [(200.0, 0.1, 2), (200.0, 1.0, 5), (40.0, 0.3, 2), (20.0, 1.0, 3)]
)
def test_two_streams_are_detected_within_two_windows(
    rate_hz: float, off_deg: float, every: int, amplitude_deg: Any
) -> None:
    samples = with_another(stream(20.0, rate_hz, amplitude_deg), off_deg, every)
    distances = np.array(stream_distances(samples))
    assert np.all(distances[2 * WINDOW :] > 0.0)
    np.testing.assert_allclose(np.rad2deg(distances[2 * WINDOW :]) / np.sqrt(2.0), off_deg, rtol=0.2)


def test_two_streams_are_one_again_after_two_windows_of_one() -> None:
    samples = stream(30.0, 100.0)
    distances = np.array(stream_distances(with_another(samples[:1000], 0.5) + samples[1000:]))
    assert distances[999] > 0.0
    assert np.all(distances[1000 + 150 :] == 0.0)


HEALTHY: dict[str, dict[str, Any]] = {
    "in swell": {"rate_hz": 100.0},
    "in a storm": {"rate_hz": 20.0, "amplitude_deg": STORM},
    "0.1° at 50 Hz": {"rate_hz": 50.0, "amplitude_deg": CALM, "printed_deg": 0.1},
    "0.01° at 10 Hz": {"rate_hz": 10.0, "amplitude_deg": CALM, "printed_deg": 0.01},
    "0.1° at rest": {"rate_hz": 20.0, "amplitude_deg": (0.0, 0.0, 0.0), "printed_deg": 0.1, "white_arcsec": 200.0},
    "noise": {"rate_hz": 50.0, "white_arcsec": 100.0},
    "2 Hz": {"rate_hz": 2.0},
}


@pytest.mark.parametrize("name", HEALTHY)
def test_a_healthy_stream_is_one(name: str) -> None:
    assert not any(stream_distances(stream(600.0, **HEALTHY[name])))


def test_values_sent_twice_or_stamped_in_pairs_are_one_stream() -> None:
    samples = stream(120.0, 100.0, SWELL)
    twice = [replace(samples[n - n % 2], time_ns=sample.time_ns) for n, sample in enumerate(samples)]
    assert not any(stream_distances(twice))
    pairs = [replace(sample, time_ns=samples[n | 1].time_ns - n % 2) for n, sample in enumerate(samples[:-1])]
    assert not any(stream_distances(pairs))


def test_jitter_of_stamps_is_one_stream() -> None:
    rng = np.random.default_rng(3)
    samples = stream(300.0, 20.0, SWELL)
    assert not any(stream_distances([replace(s, time_ns=s.time_ns + int(rng.uniform(0.0, 12e6))) for s in samples]))


def test_nan_is_one_stream() -> None:
    samples = with_another(stream(10.0, 100.0), 0.5)
    assert not any(stream_distances([replace(sample, rotation_nd=np.nan * sample.rotation_nd) for sample in samples]))


@pytest.mark.parametrize("block", [1, 10, 333])
def test_block_gives_the_result_of_its_samples_one_by_one(block: int) -> None:
    samples = stream(4.0, 100.0) + [
        replace(s, time_ns=s.time_ns + 4_000_000_000) for s in with_another(stream(2.0, 100.0), 0.5)
    ]
    times, values = np.array([s.time_ns for s in samples]), np.array([s.rotation_nd.ravel() for s in samples])
    single = stream_distances(samples)
    streams, start = InterleavedStreams(LEAST), 0
    while start < len(samples):
        some = slice(start, start + block)
        count = streams.count_before_change(times[some], values[some])
        assert streams.add_all(times[some][:count], values[some][:count]) == count
        start += count
        assert streams.distance == single[start - 1] if start else True
        assert len({value > 0.0 for value in single[start - count : start]}) <= 1
        if count < len(times[some]):
            assert streams.add(int(times[start]), values[start])
            assert streams.distance == single[start]
            start += 1
