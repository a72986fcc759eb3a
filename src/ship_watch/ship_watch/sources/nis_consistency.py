"""Consistency of the stated sigma of a source with its innovations of the last minute (NIS test)."""

import math
from collections import deque

from ship_watch.suite_state import NisConsistency

WINDOW_NS = 60_000_000_000
"""Length of the window of innovations, ns."""

BAND_SIGMAS = 3.3
"""Half width of the band in which the sigma is consistent, in sigmas of the ratio (two-sided probability 99.9 %)."""

MAX_BAND = 0.5
"""Largest half width of the band for which a text is given, reached with 22 degrees of freedom."""


class NisWindow:
    """Accepted innovations of one source in the last minute: sum of their NIS and of their degrees of freedom."""

    def __init__(self) -> None:
        self._entries: deque[tuple[int, float, int]] = deque()
        self._nis, self._degrees_of_freedom = 0.0, 0
        self._consistency: NisConsistency | None = None

    def add(self, now_ns: int, nis: float, degrees_of_freedom: int) -> None:
        """Add the innovation of an accepted measurement; a NIS that is not finite is ignored.

        Args:
            now_ns: caller's time, ns.
            nis: normalised innovation squared.
            degrees_of_freedom: number of residuals of the innovation.
        """
        if degrees_of_freedom > 0 and math.isfinite(nis):
            self._entries.append((now_ns, nis, degrees_of_freedom))
            self._nis += nis
            self._degrees_of_freedom += degrees_of_freedom
            self._consistency = None
        self._drop_old(now_ns)

    def consistency(self, now_ns: int) -> NisConsistency:
        """Return the consistency of the last minute.

        With N degrees of freedom, the sigma is consistent if r = √(NIS / N) is within 1 ± 3.3/√(2 N). The sum of N
        squares of unit normals has the mean N and the variance 2 N, so that r has the sigma 1/√(2 N).
        """
        self._drop_old(now_ns)
        if self._consistency is None:  # kept, because this method is called more often than innovations arrive
            self._consistency = self._compute_consistency()
        return self._consistency

    def _compute_consistency(self) -> NisConsistency:
        degrees = self._degrees_of_freedom
        if degrees == 0:
            return NisConsistency(math.nan, 0, "", is_consistent=True)
        ratio = math.sqrt(max(self._nis, 0.0) / degrees)
        band = BAND_SIGMAS / math.sqrt(2.0 * degrees)
        fits = abs(ratio - 1.0) <= band
        if not band <= MAX_BAND or ratio == 0.0:
            return NisConsistency(ratio, degrees, "", fits)
        return NisConsistency(ratio, degrees, f"σ {consistent_text(ratio) if fits else inconsistent_text(ratio)}", fits)

    def _drop_old(self, now_ns: int) -> None:
        entries = self._entries
        while entries and now_ns - entries[0][0] > WINDOW_NS:
            _, nis, degrees = entries.popleft()
            self._nis -= nis
            self._degrees_of_freedom -= degrees
            self._consistency = None
        if not entries:
            self._nis = 0.0  # remove rounding errors


def consistent_text(ratio: float) -> str:
    """Return the text of a consistent ratio of real to stated sigma: "as stated (1.01)"."""
    return f"as stated ({ratio:.2f})"


def inconsistent_text(ratio: float) -> str:
    """Return the text of an inconsistent ratio: "optimistic by 1.6" if errors exceed the stated sigma."""
    factor = ratio if ratio > 1.0 else 1.0 / ratio
    # Two decimals if the factor would be 1.0 with one decimal.
    return f"{'optimistic' if ratio > 1.0 else 'pessimistic'} by {factor:.{2 if factor < 1.05 else 1}f}"
