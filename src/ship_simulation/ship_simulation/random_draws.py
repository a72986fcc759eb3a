"""Random draws of all simulated devices: random streams, correlated errors, arrival times, exposures, stretches.

A voyage is divided into stretches, so that memory does not grow with its length. The drawn numbers depend only on the
seed, not on the division: random streams and correlated errors continue from the previous stretch.

The centroid of a point that moves during the exposure is the mean of the point's path. The error of this centroid is
larger along the path than across. This module shares nothing with the estimators, and computes the mean as a
Gauss–Legendre sum over the true motion.
"""

import functools
import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast

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

STRETCH_S = 20
"""Length of a stretch when a bag is written, s. A stretch has some thousand samples, enough for full speed."""

_HISTORY_S = 10.0
"""Longest time before a stretch for which a correlated error is requested; exposures and offsets are shorter."""

_NORMALS_PER_BATCH = 4096


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


@dataclass(frozen=True)
class Stretch:
    """A part of a voyage, with the samples whose error-free stamps lie from ``begin_s`` up to ``end_s``.

    Attributes:
        start_ns: start of the voyage.
        duration_s: duration of the voyage; a sample at its end belongs to the voyage.
        begin_s: begin of the stretch after the start, in whole seconds.
        end_s: end of the stretch; infinite for the last one.
    """

    start_ns: int
    duration_s: float
    begin_s: float = 0.0
    end_s: float = math.inf

    @property
    def is_last(self) -> bool:
        """True for the last stretch of the voyage."""
        return math.isinf(self.end_s)

    @property
    def end_ns(self) -> float:
        """End of the stretch, ns; infinite for the last one."""
        return self.end_s if self.is_last else self.start_ns + round(self.end_s * SECOND_NS)

    def count(self, rate_hz: float, phase_s: float) -> int:
        """Return the number of regular samples from ``phase_s`` after the start to the end of the voyage."""
        # Due to the margin, the last sample of a duration of whole periods is included in spite of rounding.
        return max(int(np.floor((self.duration_s - phase_s) * rate_hz + 1e-6)) + 1, 0)

    def stamps(self, rate_hz: float, phase_s: float) -> np.ndarray:
        """Return the stamps of the regular samples in the stretch, ns, shape (n,)."""
        numbers, offsets_ns = self._samples(rate_hz, phase_s)
        return self.start_ns + offsets_ns[numbers < self.count(rate_hz, phase_s)]

    def contains_last(self, rate_hz: float, phase_s: float) -> bool:
        """True if the last regular sample of the voyage is in the stretch."""
        numbers, _ = self._samples(rate_hz, phase_s)
        return self.count(rate_hz, phase_s) - 1 in numbers

    def _samples(self, rate_hz: float, phase_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers and times after the start, ns, of the regular samples in the stretch."""
        last = self.count(rate_hz, phase_s)
        # One more at each end, because times are rounded to nanoseconds.
        first = max(math.floor((self.begin_s - phase_s) * rate_hz) - 1, 0)
        if math.isfinite(self.end_s):
            last = min(last, math.ceil((self.end_s - phase_s) * rate_hz) + 1)
        numbers = np.arange(first, max(last, first))
        offsets_ns = np.rint((phase_s + numbers / rate_hz) * SECOND_NS).astype(np.int64)
        inside = (offsets_ns >= self.begin_s * SECOND_NS) & (offsets_ns < self.end_s * SECOND_NS)
        return numbers[inside], offsets_ns[inside]


def split_voyage(start_ns: int, duration_s: float, length_s: int) -> Iterator[Stretch]:
    """Divide a voyage into stretches of ``length_s``; the last stretch contains the remainder."""
    last = max(math.ceil(duration_s / length_s) - 1, 0)
    for number in range(last + 1):
        begin_s = float(number * length_s)
        yield Stretch(start_ns, duration_s, begin_s, begin_s + length_s if number < last else math.inf)


class PersistentDraw(Protocol):
    """A drawn quantity that continues through a voyage."""

    def drop_before(self, before_s: float) -> None:
        """Drop the part before a time; earlier times may not be requested any more."""


PersistentDrawT = TypeVar("PersistentDrawT", bound=PersistentDraw)


class Draws:
    """The random parts of one voyage that continue from stretch to stretch.

    Args:
        seed: seed of the voyage.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._streams: dict[tuple[str, int], np.random.Generator] = {}
        self._processes: dict[str, GaussMarkov] = {}
        self._persistent_draws: dict[str, PersistentDraw] = {}

    def stream(self, component: str, after: int = 0) -> np.random.Generator:
        """Return a component's random stream, the same object at each call with the same ``after``.

        At the first call, the stream is advanced by ``after`` standard normal numbers.
        """
        generator = self._streams.get((component, after))
        if generator is None:
            generator = self._streams[component, after] = random_stream(self.seed, component)
            for begin in range(0, after, _NORMALS_PER_BATCH):
                generator.standard_normal(min(_NORMALS_PER_BATCH, after - begin))
        return generator

    def gauss_markov(
        self, component: str, count: int, period_s: float, sigma: FloatArray, time_s: FloatArray
    ) -> FloatArray:
        """Return the next ``count`` samples of a component's processes (:class:`GaussMarkov`), shape (count, n)."""
        if component not in self._processes:
            self._processes[component] = GaussMarkov(random_stream(self.seed, component), period_s, sigma, time_s)
        return self._processes[component].take(count)

    def correlated_error(self, component: str, duration_s: float, sigma: FloatArray, time_s: float) -> CorrelatedError:
        """Return a component's correlated error, the same object at each call."""
        make = functools.partial(CorrelatedError, duration_s=duration_s, sigma=sigma, time_s=time_s)
        return self.persistent_draw(component, make)

    def persistent_draw(
        self, component: str, make: Callable[[np.random.Generator], PersistentDrawT]
    ) -> PersistentDrawT:
        """Return a component's draw with a random stream of its own, the same object at each call."""
        if component not in self._persistent_draws:
            self._persistent_draws[component] = make(random_stream(self.seed, component))
        return cast(PersistentDrawT, self._persistent_draws[component])

    def begin_stretch(self, stretch: Stretch) -> None:
        """Drop the parts of all draws that neither this stretch nor a later stretch needs."""
        for draw in self._persistent_draws.values():
            draw.drop_before(stretch.begin_s - _HISTORY_S)
