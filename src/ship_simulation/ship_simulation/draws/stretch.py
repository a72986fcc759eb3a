"""Division of a voyage into stretches, and random draws that continue from stretch to stretch.

Due to the stretches, memory does not grow with the length of the voyage. The drawn numbers do not depend on the
division: random streams and correlated errors continue from the previous stretch, and constant draws depend only on the
seed.
"""

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.draws.noise import CorrelatedError, GaussMarkov, random_stream

STRETCH_S = 20
"""Length of a stretch when a bag is written, s. A stretch has some thousand samples, enough for full speed."""

_HISTORY_S = 10.0
"""Longest time before a stretch for which a correlated error is requested; exposures and offsets are shorter."""

_NORMALS_PER_BATCH = 4096


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
