"""A voyage in stretches, so that its memory does not grow with its length; and what goes on from one to the next.

Whatever the stretches, the numbers are the same: each random stream and each slow error goes on where the stretch
before left it, and what is drawn once for a voyage comes from the seed alone.
"""

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_simulation.draws.noise import GaussMarkov, SlowError, random_stream

STRETCH_S = 20
"""Length of the stretches of a voyage that is written: some thousand samples, which is as fast as all at once."""

_ASKED_BACK_S = 10.0
"""Nobody asks for a slow error longer than this before a stretch: exposures and time offsets are shorter."""

_NORMALS_AT_ONCE = 4096


@dataclass(frozen=True)
class Stretch:
    """The samples of a voyage whose stamps, without any error, lie from ``begin_s`` up to ``end_s``.

    Attributes:
        start_ns: of the voyage.
        duration_s: of the voyage, its end inclusive.
        begin_s: after the start, in whole seconds.
        end_s: likewise; infinite where nothing comes after.
    """

    start_ns: int
    duration_s: float
    begin_s: float = 0.0
    end_s: float = math.inf

    @property
    def ends(self) -> bool:
        """Whether the voyage ends with it."""
        return math.isinf(self.end_s)

    @property
    def end_ns(self) -> float:
        """Its end; infinite where nothing comes after."""
        return self.end_s if self.ends else self.start_ns + round(self.end_s * SECOND_NS)

    def count(self, rate_hz: float, phase_s: float) -> int:
        """Regular samples from ``phase_s`` after the start to the end of the voyage."""
        # A hair over, so that a duration of whole periods includes its end in spite of rounding.
        return max(int(np.floor((self.duration_s - phase_s) * rate_hz + 1e-6)) + 1, 0)

    def stamps(self, rate_hz: float, phase_s: float) -> np.ndarray:
        """Stamps of the regular samples in the stretch, ns, shape (n,)."""
        numbers, offsets_ns = self._samples(rate_hz, phase_s)
        return self.start_ns + offsets_ns[numbers < self.count(rate_hz, phase_s)]

    def holds_last(self, rate_hz: float, phase_s: float) -> bool:
        """Whether the last one of these samples is in the stretch."""
        numbers, _ = self._samples(rate_hz, phase_s)
        return self.count(rate_hz, phase_s) - 1 in numbers

    def _samples(self, rate_hz: float, phase_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Numbers and moments after the start, ns, of the samples that would be in it if the voyage did not end."""
        last = self.count(rate_hz, phase_s)
        # One more at each end, for moments are rounded to nanoseconds.
        first = max(math.floor((self.begin_s - phase_s) * rate_hz) - 1, 0)
        if math.isfinite(self.end_s):
            last = min(last, math.ceil((self.end_s - phase_s) * rate_hz) + 1)
        numbers = np.arange(first, max(last, first))
        offsets_ns = np.rint((phase_s + numbers / rate_hz) * SECOND_NS).astype(np.int64)
        inside = (offsets_ns >= self.begin_s * SECOND_NS) & (offsets_ns < self.end_s * SECOND_NS)
        return numbers[inside], offsets_ns[inside]


def stretches_of(start_ns: int, duration_s: float, length_s: int) -> Iterator[Stretch]:
    """A voyage in stretches of ``length_s`` one after another; what is left at the end belongs to the last."""
    last = max(math.ceil(duration_s / length_s) - 1, 0)
    for number in range(last + 1):
        begin_s = float(number * length_s)
        yield Stretch(start_ns, duration_s, begin_s, begin_s + length_s if number < last else math.inf)


class Lasting(Protocol):
    """Something drawn that goes on through a voyage."""

    def forget(self, before_s: float) -> None:
        """No moment before this is asked for any more."""


LastingT = TypeVar("LastingT", bound=Lasting)


class Draws:
    """The random parts of one voyage that go on from stretch to stretch.

    Args:
        seed: of the voyage.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._streams: dict[tuple[str, int], np.random.Generator] = {}
        self._processes: dict[str, GaussMarkov] = {}
        self._lasting: dict[str, Lasting] = {}

    def stream(self, component: str, after: int = 0) -> np.random.Generator:
        """The random stream of a component; it begins after so many standard normal numbers of it."""
        found = self._streams.get((component, after))
        if found is None:
            found = self._streams[component, after] = random_stream(self.seed, component)
            for begin in range(0, after, _NORMALS_AT_ONCE):
                found.standard_normal(min(_NORMALS_AT_ONCE, after - begin))
        return found

    def gauss_markov(
        self, component: str, count: int, period_s: float, sigma: FloatArray, time_s: FloatArray
    ) -> FloatArray:
        """The next ``count`` samples of a component's processes (:class:`GaussMarkov`), shape (count, n)."""
        if component not in self._processes:
            self._processes[component] = GaussMarkov(random_stream(self.seed, component), period_s, sigma, time_s)
        return self._processes[component].take(count)

    def slow_error(self, component: str, duration_s: float, sigma: FloatArray, time_s: float) -> SlowError:
        """A component's slow error, the same one whenever it is asked for."""
        make = functools.partial(SlowError, duration_s=duration_s, sigma=sigma, time_s=time_s)
        return self.lasting(component, make)

    def lasting(self, component: str, make: Callable[[np.random.Generator], LastingT]) -> LastingT:
        """What a component draws with a random stream of its own, the same one whenever it is asked for."""
        if component not in self._lasting:
            self._lasting[component] = make(random_stream(self.seed, component))
        return cast(LastingT, self._lasting[component])

    def begin(self, stretch: Stretch) -> None:
        """Forget what a stretch and those after it do not ask for."""
        for lasting in self._lasting.values():
            lasting.forget(stretch.begin_s - _ASKED_BACK_S)
