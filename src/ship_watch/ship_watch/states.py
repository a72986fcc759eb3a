"""SAFE, CAUTION or UNSAFE: how far an angle may be relied on, and why not, in a few words.

The words are those of IMO MSC.1/Circ.1575. An angle is SAFE where its output is VALID and fresh, its 95 % accuracy is
within the ship's limit and the protection levels are met. CAUTION: the accuracy is known and not over three times the
limit, but integrity is unavailable, the output is COASTING or DEGRADED, or the accuracy is over its limit. All else is
UNSAFE: every comparison is written so that NaN fails it.
"""

import math
import re
from dataclasses import dataclass

from ship_estimation.outcome import Status
from ship_estimation.protection import IntegrityState
from ship_watch.picture import Safety, SourceStanding

BRIEF_NS = 1_000_000_000
"""An accuracy that was below its limit for less time than this was over it all the while, ns."""

OVER_THE_LIMIT = "over the limit"
"""Reason of a CAUTION where only the accuracy is to blame, and no source."""


@dataclass(frozen=True)
class Protection:
    """What an Integrity message says of one angle.

    Attributes:
        state: of the whole message; None where none was told or the last is too old.
        level: protection level, rad; NaN where there is none.
        alert_limit: rad; NaN where none is configured.
    """

    state: IntegrityState | None
    level: float = math.nan
    alert_limit: float = math.nan


@dataclass(frozen=True)
class AngleClaim:
    """What an output claims of one angle at one moment, and what speaks against it.

    Attributes:
        topic: of the output.
        is_heard: whether it ever came.
        is_old: whether it has not come for too long.
        value: the angle, rad.
        accuracy_95: 1.96 sigma, rad.
        limit: the ship's limit of that, rad.
        unsafe_factor: over so many times the limit the angle is UNSAFE.
        status: of the output; None where its number is unknown.
        hint: why it is not better, as the output itself lets know: "no stars for 31 s", "1 light".
        is_lessened: whether the hint alone makes it a CAUTION: one of two lights.
        protection: what the integrity says.
        guilty: the source that is out by a fault of its own; None where none is known.
        behind: that a node which the angle rests on cannot keep up with its inputs; empty where all can.
    """

    topic: str
    is_heard: bool
    is_old: bool
    value: float
    accuracy_95: float
    limit: float
    unsafe_factor: float
    status: Status | None
    hint: str
    is_lessened: bool
    protection: Protection
    guilty: SourceStanding | None
    behind: str = ""


def judged(claim: AngleClaim) -> tuple[Safety, str]:
    """The word of an angle, and why it is not SAFE."""
    word, reason = _judged(claim)
    return word, (claim.behind or reason) if word else ""


def _judged(claim: AngleClaim) -> tuple[Safety, str]:
    if not claim.is_heard:
        return Safety.UNSAFE, f"waiting for {claim.topic}"
    guilty = _guilty(claim.guilty)
    if claim.is_old:
        return Safety.UNSAFE, guilty or f"{claim.topic} silent"
    if claim.status is None or claim.status is Status.INVALID or not math.isfinite(claim.value):
        return Safety.UNSAFE, guilty or "invalid"
    if not claim.accuracy_95 <= claim.unsafe_factor * claim.limit:
        over = f"over {claim.unsafe_factor:g} × the limit"
        return Safety.UNSAFE, guilty or over if math.isfinite(claim.accuracy_95) else "accuracy unknown"
    state, protection = claim.protection.state, claim.protection
    if state is IntegrityState.EXCEEDED and not _is_within(protection):
        return Safety.UNSAFE, guilty or "protection level over its alert limit"
    if claim.status is not Status.VALID:
        return Safety.CAUTION, guilty or claim.hint or claim.status.name.lower()
    if not claim.accuracy_95 <= claim.limit:
        return Safety.CAUTION, guilty or OVER_THE_LIMIT
    if state is None:
        return Safety.CAUTION, "integrity not told"
    if state is IntegrityState.UNAVAILABLE or not math.isfinite(protection.level):
        return Safety.CAUTION, guilty or claim.hint or "nothing checks it"
    return (Safety.CAUTION, guilty or claim.hint) if claim.is_lessened else (Safety.SAFE, "")


def _is_within(protection: Protection) -> bool:
    """Whether the level of this angle itself is within its limit, or has none while others have."""
    return protection.level <= protection.alert_limit or math.isnan(protection.alert_limit)


def _guilty(source: SourceStanding | None) -> str:
    """Few words for a source that is out; how many were refused is told where sources are listed."""
    return "" if source is None else f"{source.name} {_RUN.sub('refused', source.reason)}"


_RUN = re.compile(r"\d+ refused in a row")


class HeldWord:
    """The word of one angle as it is shown: worse at once, better after some time.

    Attributes:
        word: as shown last; None before the first.
        reason: why.
        since_ns: since when it stands, by the caller's time.
    """

    def __init__(self, better_after_s: float) -> None:
        self._hold_ns = round(better_after_s * 1e9)
        self._last: dict[Safety, tuple[int, str]] = {}
        self.word: Safety | None = None
        self.reason = ""
        self.since_ns = 0

    def note(self, word: Safety, reason: str, now_ns: int) -> bool:
        """Take the word of now; the answer is whether the shown one changed."""
        for level in (Safety.CAUTION, Safety.UNSAFE):
            if word >= level:
                self._last[level] = now_ns, reason
        shown, self.reason = self.shown(word, reason, now_ns)
        changed = shown is not self.word
        if changed:
            self.word, self.since_ns = shown, now_ns
        return changed

    def shown(self, word: Safety, reason: str, now_ns: int) -> tuple[Safety, str]:
        """What is shown where the word of now is this: the worst of the last seconds."""
        for level in (Safety.UNSAFE, Safety.CAUTION):
            if word >= level:
                return word, reason
            if level in self._last and now_ns - self._last[level][0] < self._hold_ns:
                return level, self._last[level][1]
        return Safety.SAFE, ""


class TimeOver:
    """For how long an accuracy has been over its limit, moments below it not counted as an end."""

    def __init__(self) -> None:
        self._first_ns = self._last_ns = -BRIEF_NS

    def note(self, claim: AngleClaim, now_ns: int) -> None:
        """Take what is claimed now."""
        if not claim.accuracy_95 <= claim.limit:
            if now_ns - self._last_ns >= BRIEF_NS:
                self._first_ns = now_ns
            self._last_ns = now_ns

    def lasted_s(self, now_ns: int) -> float:
        """Time between its first moment over the limit and its last, s; 0 where it has been below for a second."""
        return (self._last_ns - self._first_ns) * 1e-9 if now_ns - self._last_ns < BRIEF_NS else 0.0
