"""Whether the stated sigma of a source fits its innovations of the last minute."""

import math
from collections import deque

from ship_watch.picture import NisVerdict

WINDOW_NS = 60_000_000_000
"""Innovations of so long are looked at, ns."""

BAND_SIGMAS = 3.3
"""Half width of the band in which the ratio counts as stated, in its own sigmas: 99.9 % of all, both sides together."""

WIDEST_BAND = 0.5
"""A band wider than this tells nothing: fewer than 22 degrees of freedom."""


class NisWindow:
    """Accepted innovations of one source over the last minute: their normalised squares and degrees of freedom."""

    def __init__(self) -> None:
        self._entries: deque[tuple[int, float, int]] = deque()
        self._nis, self._degrees = 0.0, 0
        self._verdict: NisVerdict | None = None

    def add(self, now_ns: int, nis: float, degrees: int) -> None:
        """Take the innovation of an accepted measurement; what is not finite is left out."""
        if degrees > 0 and math.isfinite(nis):
            self._entries.append((now_ns, nis, degrees))
            self._nis += nis
            self._degrees += degrees
            self._verdict = None
        self._forget(now_ns)

    def verdict(self, now_ns: int) -> NisVerdict:
        """What the last minute says: r = √(mean NIS / degrees), within 1 ± 3.3/√(2 N) of N degrees in all as stated.

        The sum of N squares of unit normals has the mean N and the variance 2 N, and its root over √N the sigma
        1/√(2 N).
        """
        self._forget(now_ns)
        if self._verdict is None:  # it is asked for more often than something comes
            self._verdict = self._judged()
        return self._verdict

    def _judged(self) -> NisVerdict:
        degrees = self._degrees
        if degrees == 0:
            return NisVerdict(math.nan, 0, "", is_as_stated=True)
        ratio = math.sqrt(max(self._nis, 0.0) / degrees)
        band = BAND_SIGMAS / math.sqrt(2.0 * degrees)
        fits = abs(ratio - 1.0) <= band
        if not band <= WIDEST_BAND or ratio == 0.0:
            return NisVerdict(ratio, degrees, "", fits)
        return NisVerdict(ratio, degrees, f"σ {as_stated(ratio) if fits else misfit(ratio)}", fits)

    def _forget(self, now_ns: int) -> None:
        entries = self._entries
        while entries and now_ns - entries[0][0] > WINDOW_NS:
            _, nis, degrees = entries.popleft()
            self._nis -= nis
            self._degrees -= degrees
            self._verdict = None
        if not entries:
            self._nis = 0.0  # what rounding left


def as_stated(ratio: float) -> str:
    """Words for a ratio of real to stated sigma that fits: "as stated (1.01)"."""
    return f"as stated ({ratio:.2f})"


def misfit(ratio: float) -> str:
    """Words for one that does not: "optimistic by 1.6" where errors are larger than stated, "pessimistic by 2.0"."""
    factor = ratio if ratio > 1.0 else 1.0 / ratio
    # As many digits as tell it from one.
    return f"{'optimistic' if ratio > 1.0 else 'pessimistic'} by {factor:.{2 if factor < 1.05 else 1}f}"
