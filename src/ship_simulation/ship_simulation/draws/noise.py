"""What all simulated devices share: random streams, slow errors, the moments of samples, exposures of what moves.

A point that moves while it is exposed has the mean of its way as centroid, and a worse centroid along it. Nothing here
is the estimators' own: the mean is a Gauss–Legendre sum over the true motion.
"""

import math
import zlib
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_simulation.scenario.motion_scenario import Outage

_LONGEST_STEP_S = 0.1
_LEAST_STEPS = 50
"""In a correlation time: halfway between two moments of the grid the variance is then too small by 1 %."""

TRUTH_RATE_HZ = 10.0
"""How often a simulated bag tells the truth."""

_FEWEST_NODES, _NODES_PER_SECOND = 7, 5.0
"""Of the sum over an exposure."""


def random_stream(seed: int, component: str) -> np.random.Generator:
    """The generator of one component. It gives the same numbers whatever other components a run has."""
    key = zlib.crc32(component.encode())
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(key,))))


def gauss_markov(
    rng: np.random.Generator, count: int, period_s: float, sigma: FloatArray, time_s: FloatArray
) -> FloatArray:
    """First-order Gauss–Markov processes in their steady state, each sampled exactly, shape (count, n).

    Args:
        rng: source of the noise.
        count: number of samples.
        period_s: time from sample to sample.
        sigma: steady standard deviation of each process, shape (n,).
        time_s: correlation time of each process, shape (n,).
    """
    decay = np.exp(-period_s / np.asarray(time_s, dtype=float))
    # 1 - decay² without cancellation.
    innovation = np.sqrt(-np.expm1(-2.0 * period_s / np.asarray(time_s, dtype=float)))
    noise = rng.standard_normal((count, len(sigma)))
    noise[1:] *= innovation
    samples = [lfilter([1.0], [1.0, -decay[i]], noise[:, i]) for i in range(len(sigma))]
    return np.stack(samples, axis=-1) * sigma


class SlowError:
    """Gauss–Markov processes with one correlation time, whose values can be asked at any moment.

    The processes are drawn on a grid far finer than the correlation time. Between the grid's moments they are straight.

    Args:
        rng: source of the noise.
        duration_s: the processes reach from zero to here.
        sigma: steady standard deviation of each process, shape (n,).
        time_s: correlation time.
    """

    def __init__(self, rng: np.random.Generator, duration_s: float, sigma: FloatArray, time_s: float) -> None:
        period_s = min(_LONGEST_STEP_S, time_s / _LEAST_STEPS)
        count = int(np.ceil(duration_s / period_s)) + 1
        self._moments_s = period_s * np.arange(count)
        self._values = gauss_markov(rng, count, period_s, sigma, np.full(len(sigma), time_s))

    def at(self, t_s: FloatArray) -> FloatArray:
        """The processes at moments, shape (k, n)."""
        return np.stack([np.interp(t_s, self._moments_s, column) for column in self._values.T], axis=-1)


def stamps(start_ns: int, rate_hz: float, phase_s: float, duration_s: float) -> np.ndarray:
    """Stamps of regular samples from ``start + phase`` to ``start + duration`` inclusive, ns, shape (n,)."""
    # A hair over, so that a duration of whole periods includes its end in spite of rounding.
    count = int(np.floor((duration_s - phase_s) * rate_hz + 1e-6)) + 1
    offsets_ns = np.rint((phase_s + np.arange(max(count, 0)) / rate_hz) * SECOND_NS)
    return start_ns + offsets_ns.astype(np.int64)


def arrival_times(stamp_ns: np.ndarray, latency_s: float, jitter_s: float, rng: np.random.Generator) -> np.ndarray:
    """Log times of samples: stamp + latency + a delay uniform in [0, jitter), ns, shape (n,)."""
    delay_s = latency_s + jitter_s * rng.random(stamp_ns.size)
    return stamp_ns + np.rint(delay_s * SECOND_NS).astype(np.int64)


def outside(since_start_s: FloatArray, outages: dict[str, Outage]) -> np.ndarray:
    """Whether each moment (seconds after the start) lies outside of all outages, shape (n,)."""
    keep = np.ones(since_start_s.size, dtype=bool)
    for outage in outages.values():
        keep &= (since_start_s < outage.start_s) | (since_start_s >= outage.end_s)
    return keep


def truth_index(time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    """The first sample in each tenth of a second, and the last of all, shape (m,)."""
    return _first_in_each(round(SECOND_NS / TRUTH_RATE_HZ), time_ns, start_ns)


def once_a_second(time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    """The first sample in each second, and the last of all, shape (m,)."""
    return _first_in_each(SECOND_NS, time_ns, start_ns)


def _first_in_each(period_ns: int, time_ns: np.ndarray, start_ns: int) -> np.ndarray:
    first = np.flatnonzero(np.diff((time_ns - start_ns) // period_ns, prepend=-1))
    return np.union1d(first, time_ns.size - 1)


@dataclass(frozen=True)
class ExposureTimes:
    """Moments of an exposure and their shares in its image.

    Attributes:
        since_middle_s: shape (m,).
        share: shape (m,); their sum is 1.
    """

    since_middle_s: FloatArray
    share: FloatArray


def exposure_times(exposure_s: float) -> ExposureTimes:
    """The moments by which an exposure is summed; an exposure of length 0 has its middle alone."""
    if exposure_s == 0.0:
        return ExposureTimes(np.zeros(1), np.ones(1))
    count = _FEWEST_NODES + math.ceil(_NODES_PER_SECOND * exposure_s)
    place, weight = np.polynomial.legendre.leggauss(count)
    return ExposureTimes(0.5 * exposure_s * place, 0.5 * weight)


def centroids(times: ExposureTimes, way: FloatArray, psf_sigma: float, sigma: float, noise: FloatArray) -> FloatArray:
    """Centroids of points that move during an exposure, with their errors, shape (..., 2).

    Args:
        times: of the exposure.
        way: where the points were at these times, shape (m, ..., 2).
        psf_sigma: spread of the image of a point at rest, each axis.
        sigma: error of the centroid of an image at rest, each axis.
        noise: standard normal numbers, shape (..., 2).
    """
    mean = np.tensordot(times.share, way, axes=1)
    if len(times.share) > 1:
        off = (way - mean) / psf_sigma
        spread = np.einsum("m,m...i,m...j->...ij", times.share, off, off)
        # The root whose square is what the light is spread by, in images of a point at rest.
        value, vector = np.linalg.eigh(np.eye(2) + np.where(np.isfinite(spread), spread, 0.0))
        noise = ((vector * np.sqrt(value)[..., None, :]) @ np.swapaxes(vector, -1, -2) @ noise[..., None])[..., 0]
    centroid: FloatArray = mean + sigma * noise
    return centroid
