"""What became of the last measurements of one source at one node: used or refused, how many in a row, how far off."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_estimation.refusals import Reason
from ship_geometry.rotations import ARCSEC

_LOOKED_AT = 5
"""So many of the last refused ones tell how a source is off."""

SHOWN_NS = 2_000_000_000
"""What is wrong is shown for at least so long after it was told last, so that people see it, ns."""

_KEPT = 24
"""Verdicts that are kept, at least: later ones may revise them."""

_IN_A_ROW_PERIODS = 1.5
"""Refusals further apart than this have messages between them that were used without a word."""

_DEGREE_FROM_ARCSEC = 3600.0


@dataclass(frozen=True)
class Disagreement:
    """The component in which a source is furthest off: words for people, and the mean of residual over sigma."""

    text: str
    sigmas: float


NO_DISAGREEMENT = Disagreement("", math.nan)


class Streak:
    """The measurements of one source at one node, in the order in which they were told.

    Of some sources (star sensors, lights) each measurement is told; of others (the INS, encoders) only those refused.

    Args:
        out_after: so many refused in a row put the source out.
        in_after: so many accepted in a row bring it in again.

    Attributes:
        is_out: so many were refused in a row, and not yet enough accepted since.
        refused: how many were refused in a row until now.
        out_since_ns: stamp of the first of those that put it out; 0 where it is in.
        refused_at_ns: arrival of the last refusal; None before the first.
        reason: of the last refusal.
        is_judged: whether accepted ones are told, too.
    """

    def __init__(self, out_after: int, in_after: int) -> None:
        self._out_after, self._in_after = out_after, in_after
        self._kept = max(_KEPT, in_after)
        self._verdicts: list[tuple[int, bool]] = []
        self._off: deque[Any] = deque(maxlen=_LOOKED_AT)
        self.is_out, self.refused, self.out_since_ns = False, 0, 0
        self.refused_at_ns: int | None = None
        self.reason = Reason.NONE
        self.is_judged = False

    def note(self, stamp_ns: int, message: Any, now_ns: int, period_ns: float) -> None:
        """Take an innovation message; ``period_ns`` is the usual time between measurements, NaN where unknown."""
        accepted, revised = bool(message.accepted), message.reason == Reason.REVISED
        self.is_judged = self.is_judged or accepted
        if not accepted:
            self.refused_at_ns = now_ns
            if not revised:
                self.reason = Reason(message.reason) if message.reason in _REASONS else Reason.NONE
            # What is excluded is learnt anew and soon looks right: only what the gate refuses tells how it is off.
            if len(message.residual) and not message.nis <= message.gate:
                self._off.append(message)
        self._insert(stamp_ns, accepted, revised, period_ns)
        self._decide()

    def note_whole(self, stamp_ns: int, is_used: bool, now_ns: int) -> None:
        """Take note of what became of an exposure of which the refusals of some stars or lights were told."""
        self.is_judged = self.is_judged or is_used
        if not is_used:
            self.refused_at_ns, self.reason = now_ns, Reason.TOO_FEW_STARS
        self._insert(stamp_ns, is_used, False, math.nan)
        self._decide()

    def used_silently(self, now_ns: int, period_ns: float, used_since: int) -> None:
        """Bring a source in of which only refusals are told: none for some periods, and as many were used since."""
        if self.is_judged or self.refused_at_ns is None:
            return
        least_ns = SHOWN_NS if math.isnan(period_ns) else max(SHOWN_NS, self._in_after * period_ns)
        if now_ns - self.refused_at_ns >= least_ns and used_since >= self._in_after:
            self._verdicts.clear()
            self._come_in()
            self.refused = 0

    @property
    def accepted_again(self) -> int:
        """How many were accepted in a row until now."""
        return self._last_in_a_row(True)

    @property
    def disagreement(self) -> Disagreement:
        """In which direction, and by how much, the last refused ones were off."""
        return disagreement(self._off) if self._off else NO_DISAGREEMENT

    def _insert(self, stamp_ns: int, accepted: bool, revised: bool, period_ns: float) -> None:
        """Put a verdict behind those that were told before, whatever its stamp: that may be what is wrong."""
        verdicts = self._verdicts
        known = next((place for place in range(len(verdicts) - 1, -1, -1) if verdicts[place][0] == stamp_ns), None)
        if known is not None:
            self._correct(known, accepted, revised)
            return
        if revised:
            return
        if accepted:
            self.refused = 0
        else:
            # NaN, an unknown period, leaves them in a row.
            apart = verdicts and stamp_ns - verdicts[-1][0] > _IN_A_ROW_PERIODS * period_ns and not self.is_judged
            self.refused = 1 if apart else self.refused + 1
            if apart:
                verdicts.clear()
        verdicts.append((stamp_ns, accepted))
        if len(verdicts) > self._kept:
            del verdicts[0]

    def _correct(self, place: int, accepted: bool, revised: bool) -> None:
        """A further word on a stamp: a measurement was used if any part of it was, unless it is judged anew."""
        verdicts = self._verdicts
        stamp_ns, known = verdicts[place]
        verdicts[place] = (stamp_ns, accepted if revised else accepted or known)
        run = self._last_in_a_row(False)
        self.refused = max(run, self.refused) if run == len(verdicts) else run

    def _decide(self) -> None:
        if self.refused >= self._out_after and not self.is_out:
            self.is_out = True
            self.out_since_ns = self._verdicts[-min(self.refused, len(self._verdicts))][0]
        elif self.is_out and self.accepted_again >= self._in_after:
            self._come_in()

    def _come_in(self) -> None:
        self.is_out, self.out_since_ns = False, 0
        self._off.clear()

    def _last_in_a_row(self, accepted: bool) -> int:
        run = 0
        for _, verdict in reversed(self._verdicts):
            if verdict is not accepted:
                break
            run += 1
        return run


_REASONS = {int(reason) for reason in Reason}


def disagreement(messages: "deque[Any]") -> Disagreement:
    """The component in which measurements are furthest off in their sigmas, in the mean over all of them.

    The last word of a component's name is its axis, what stands before it a star or a light. Parts that are all off
    alike are one turn of the device: then the mean over them is told. Otherwise the one part that is furthest off is.

    Args:
        messages: innovations with residuals, rad, and their sigmas.
    """
    parts: dict[str, list[tuple[float, float]]] = {}
    for message in messages:
        for name, residual, sigma in zip(message.components, message.residual, message.sigma, strict=False):
            if math.isfinite(residual) and sigma > 0.0:
                parts.setdefault(name, []).append((float(residual), float(residual / sigma)))
    axes: dict[str, list[tuple[float, float]]] = {}
    for name, values in parts.items():
        axes.setdefault(name.rpartition(" ")[2], []).extend(values)
    best = max(((name, *np.mean(values, axis=0)) for name, values in axes.items()), key=_far, default=None)
    worst = max(((name, *np.mean(values, axis=0)) for name, values in parts.items()), key=_far, default=None)
    if best is None or worst is None:
        return NO_DISAGREEMENT
    name, residual, sigmas = best if _far(best) >= max(1.0, 0.3 * _far(worst)) else worst
    return Disagreement(f"{name} {angle_text(residual)}", float(sigmas))


def angle_text(angle: float) -> str:
    """A signed angle, rad, for people: seconds of arc, or degrees from one degree on."""
    arcsec = angle / ARCSEC
    size = abs(arcsec)
    text = f"{size / _DEGREE_FROM_ARCSEC:.1f}°" if size >= _DEGREE_FROM_ARCSEC else f"{size:.0f}″"
    return f"{'−' if arcsec < 0.0 else '+'}{text}"


def _far(entry: tuple[str, float, float]) -> float:
    return abs(entry[2])
