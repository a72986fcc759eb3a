"""Common parts of all simulated devices: random streams, correlated errors, arrival times, exposures of moving points.

The centroid of a point that moves during the exposure is the mean of the point's path. The error of this centroid is
larger along the path than across. This module shares nothing with the estimators, and computes the mean as a
Gauss–Legendre sum over the true motion.
"""

import math
import zlib
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.motion_scenario import Outage

_MAX_STEP_S = 0.1
_MIN_STEPS = 50
"""Minimum number of grid steps per correlation time: the variance halfway between grid points is then 1 % too small."""

TRUTH_RATE_HZ = 10.0
"""Rate of the truth in a simulated bag, Hz."""

_MIN_NODES, _NODES_PER_SECOND = 7, 5.0
"""Number of quadrature nodes of an exposure: minimum, and additional nodes per second."""


def random_stream(seed: int, component: str) -> np.random.Generator:
    """Return the generator of one component; its numbers do not depend on the other components of a run."""
    key = zlib.crc32(component.encode())
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(key,))))


class GaussMarkov:
    """Stationary first-order Gauss–Markov processes, each sampled exactly.

    Args:
        rng: source of the noise.
        period_s: time between samples.
        sigma: stationary standard deviation of each process, shape (n,).
        time_s: correlation time of each process, shape (n,).
    """

    def __init__(self, rng: np.random.Generator, period_s: float, sigma: FloatArray, time_s: FloatArray) -> None:
        self._rng = rng
        self._sigma = sigma
        self._decay = np.exp(-period_s / np.asarray(time_s, dtype=float))
        # 1 - decay² without cancellation.
        self._innovation = np.sqrt(-np.expm1(-2.0 * period_s / np.asarray(time_s, dtype=float)))
        self._is_initialised = False
        self._filter_state = np.zeros((len(sigma), 1))

    def take(self, count: int) -> FloatArray:
        """Return the next samples, shape (count, n)."""
        noise = self._rng.standard_normal((count, len(self._sigma)))
        noise[0 if self._is_initialised else 1 :] *= self._innovation
        samples = np.empty_like(noise)
        if count:
            self._is_initialised = True
            for i, decay in enumerate(self._decay):
                samples[:, i], self._filter_state[i] = lfilter(
                    [1.0], [1.0, -decay], noise[:, i], zi=self._filter_state[i]
                )
        return samples * self._sigma


class CorrelatedError:
    """Gauss–Markov processes with one correlation time, which can be evaluated at any time.

    The processes are drawn on a grid much finer than the correlation time, up to the latest requested time, and
    interpolated linearly.

    Args:
        rng: source of the noise.
        duration_s: end of the time span of the processes, which begins at zero.
        sigma: stationary standard deviation of each process, shape (n,).
        time_s: correlation time.
    """

    def __init__(self, rng: np.random.Generator, duration_s: float, sigma: FloatArray, time_s: float) -> None:
        self._period_s = min(_MAX_STEP_S, time_s / _MIN_STEPS)
        self._count = int(np.ceil(duration_s / self._period_s)) + 1
        self._process = GaussMarkov(rng, self._period_s, sigma, np.full(len(sigma), time_s))
        self._first = 0
        self._values = self._process.take(1)

    def values_at(self, t_s: FloatArray) -> FloatArray:
        """Return the processes at times, shape (k, n).

        Raises:
            ValueError: a time is in the dropped part.
        """
        if np.size(t_s):
            self._extend_to(float(np.max(t_s)))
        moments_s = self._period_s * np.arange(self._first, self._first + len(self._values))
        if self._first and np.any(t_s < moments_s[0]):
            raise ValueError(f"the correlated error before {moments_s[0]:.1f} s has been dropped")
        return np.stack([np.interp(t_s, moments_s, column) for column in self._values.T], axis=-1)

    def drop_before(self, before_s: float) -> None:
        """Drop the part before a time; earlier times may not be requested any more."""
        first = min(int(before_s / self._period_s), self._first + len(self._values) - 1)
        if first > self._first:
            self._values, self._first = self._values[first - self._first :].copy(), first

    def _extend_to(self, t_s: float) -> None:
        wanted = min(int(t_s / self._period_s) + 2, self._count)
        more = wanted - (self._first + len(self._values))
        if more > 0:
            self._values = np.concatenate([self._values, self._process.take(more)])


def arrival_times(stamp_ns: np.ndarray, latency_s: float, jitter_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return log times of samples: stamp + latency + a delay uniform in [0, jitter), ns, shape (n,)."""
    delay_s = latency_s + jitter_s * rng.random(stamp_ns.size)
    return stamp_ns + np.rint(delay_s * SECOND_NS).astype(np.int64)


def is_outside(since_start_s: FloatArray, outages: dict[str, Outage]) -> np.ndarray:
    """True for each time (seconds after the start) outside all outages, shape (n,)."""
    keep = np.ones(since_start_s.size, dtype=bool)
    for outage in outages.values():
        keep &= (since_start_s < outage.start_s) | (since_start_s >= outage.end_s)
    return keep


def truth_indices(time_ns: np.ndarray, start_ns: int, ends: bool = True) -> np.ndarray:
    """Return indices of the first sample in each tenth of a second, and of the last sample if ``ends``, shape (m,)."""
    return _first_in_each(round(SECOND_NS / TRUTH_RATE_HZ), time_ns, start_ns, ends)


def first_in_each_second(time_ns: np.ndarray, start_ns: int, ends: bool = True) -> np.ndarray:
    """Return indices of the first sample in each second, and of the last sample if ``ends``, shape (m,)."""
    return _first_in_each(SECOND_NS, time_ns, start_ns, ends)


def _first_in_each(period_ns: int, time_ns: np.ndarray, start_ns: int, ends: bool) -> np.ndarray:
    first = np.flatnonzero(np.diff((time_ns - start_ns) // period_ns, prepend=-1))
    return np.union1d(first, time_ns.size - 1) if ends else first


@dataclass(frozen=True)
class ExposureTimes:
    """Quadrature nodes of an exposure.

    Attributes:
        since_middle_s: times after the middle, shape (m,).
        weight: weights, shape (m,); their sum is 1.
    """

    since_middle_s: FloatArray
    weight: FloatArray


def exposure_times(exposure_s: float) -> ExposureTimes:
    """Return the quadrature nodes of an exposure; an exposure of length 0 has its middle only."""
    if exposure_s == 0.0:
        return ExposureTimes(np.zeros(1), np.ones(1))
    count = _MIN_NODES + math.ceil(_NODES_PER_SECOND * exposure_s)
    place, weight = np.polynomial.legendre.leggauss(count)
    return ExposureTimes(0.5 * exposure_s * place, 0.5 * weight)


def centroids(times: ExposureTimes, path: FloatArray, psf_sigma: float, sigma: float, noise: FloatArray) -> FloatArray:
    """Return centroids of points that move during an exposure, with their errors, shape (..., 2).

    Args:
        times: quadrature nodes of the exposure.
        path: positions of the points at these times, shape (m, ..., 2).
        psf_sigma: standard deviation of the image of a point at rest, each axis.
        sigma: error of the centroid of an image at rest, each axis.
        noise: standard normal numbers, shape (..., 2).
    """
    mean = np.tensordot(times.weight, path, axes=1)
    if len(times.weight) > 1:
        off = (path - mean) / psf_sigma
        spread = np.einsum("m,m...i,m...j->...ij", times.weight, off, off)
        # Root of the light's covariance in units of the image of a point at rest.
        value, vector = np.linalg.eigh(np.eye(2) + np.where(np.isfinite(spread), spread, 0.0))
        noise = ((vector * np.sqrt(value)[..., None, :]) @ np.swapaxes(vector, -1, -2) @ noise[..., None])[..., 0]
    centroid: FloatArray = mean + sigma * noise
    return centroid
