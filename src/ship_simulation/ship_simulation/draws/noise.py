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


class GaussMarkov:
    """First-order Gauss–Markov processes in their steady state, each sampled exactly.

    Args:
        rng: source of the noise.
        period_s: time from sample to sample.
        sigma: steady standard deviation of each process, shape (n,).
        time_s: correlation time of each process, shape (n,).
    """

    def __init__(self, rng: np.random.Generator, period_s: float, sigma: FloatArray, time_s: FloatArray) -> None:
        self._rng = rng
        self._sigma = sigma
        self._decay = np.exp(-period_s / np.asarray(time_s, dtype=float))
        # 1 - decay² without cancellation.
        self._innovation = np.sqrt(-np.expm1(-2.0 * period_s / np.asarray(time_s, dtype=float)))
        self._begun = False
        self._carried = np.zeros((len(sigma), 1))

    def take(self, count: int) -> FloatArray:
        """The next samples, shape (count, n)."""
        noise = self._rng.standard_normal((count, len(self._sigma)))
        noise[0 if self._begun else 1 :] *= self._innovation
        samples = np.empty_like(noise)
        if count:
            self._begun = True
            for i, decay in enumerate(self._decay):
                samples[:, i], self._carried[i] = lfilter([1.0], [1.0, -decay], noise[:, i], zi=self._carried[i])
        return samples * self._sigma


class SlowError:
    """Gauss–Markov processes with one correlation time, whose values can be asked at any moment.

    The processes are drawn on a grid far finer than the correlation time, up to the latest moment asked for. Between
    the grid's moments they are straight.

    Args:
        rng: source of the noise.
        duration_s: the processes reach from zero to here.
        sigma: steady standard deviation of each process, shape (n,).
        time_s: correlation time.
    """

    def __init__(self, rng: np.random.Generator, duration_s: float, sigma: FloatArray, time_s: float) -> None:
        self._period_s = min(_LONGEST_STEP_S, time_s / _LEAST_STEPS)
        self._count = int(np.ceil(duration_s / self._period_s)) + 1
        self._process = GaussMarkov(rng, self._period_s, sigma, np.full(len(sigma), time_s))
        self._first = 0
        self._values = self._process.take(1)

    def at(self, t_s: FloatArray) -> FloatArray:
        """The processes at moments, shape (k, n).

        Raises:
            ValueError: a moment lies before what was forgotten.
        """
        if np.size(t_s):
            self._reach(float(np.max(t_s)))
        moments_s = self._period_s * np.arange(self._first, self._first + len(self._values))
        if self._first and np.any(t_s < moments_s[0]):
            raise ValueError(f"the slow error before {moments_s[0]:.1f} s is forgotten")
        return np.stack([np.interp(t_s, moments_s, column) for column in self._values.T], axis=-1)

    def forget(self, before_s: float) -> None:
        """No moment before this is asked for any more."""
        first = min(int(before_s / self._period_s), self._first + len(self._values) - 1)
        if first > self._first:
            self._values, self._first = self._values[first - self._first :].copy(), first

    def _reach(self, t_s: float) -> None:
        wanted = min(int(t_s / self._period_s) + 2, self._count)
        more = wanted - (self._first + len(self._values))
        if more > 0:
            self._values = np.concatenate([self._values, self._process.take(more)])


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


def truth_index(time_ns: np.ndarray, start_ns: int, ends: bool = True) -> np.ndarray:
    """The first sample in each tenth of a second, and the last of all where the samples end here, shape (m,)."""
    return _first_in_each(round(SECOND_NS / TRUTH_RATE_HZ), time_ns, start_ns, ends)


def once_a_second(time_ns: np.ndarray, start_ns: int, ends: bool = True) -> np.ndarray:
    """The first sample in each second, and the last of all where the samples end here, shape (m,)."""
    return _first_in_each(SECOND_NS, time_ns, start_ns, ends)


def _first_in_each(period_ns: int, time_ns: np.ndarray, start_ns: int, ends: bool) -> np.ndarray:
    first = np.flatnonzero(np.diff((time_ns - start_ns) // period_ns, prepend=-1))
    return np.union1d(first, time_ns.size - 1) if ends else first


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
