"""SAFE, CAUTION or UNSAFE: how far an angle may be relied on, and why not, in a few words.

The words are those of IMO MSC.1/Circ.1575. An angle is SAFE where its output is VALID and fresh, its 95 % accuracy is
within the ship's limit and the protection levels are met. CAUTION: the accuracy is known and not over three times the
limit, but integrity is unavailable, the output is COASTING or DEGRADED, or the accuracy is over its limit. All else is
UNSAFE: every comparison is written so that NaN fails it.

A word gets worse at once. It gets better after a time without a reason for it, with hysteresis: an accuracy that was
over its limit must be below it by a margin for that time, or below it for several times as long.
"""

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

from ship_bags.stamps import NS_PER_S
from ship_estimation.outcome import Status
from ship_estimation.protection import IntegrityState
from ship_watch import words
from ship_watch.picture import Safety, SourceStanding

MARGIN = 0.1
"""Share of its limit by which an accuracy that was over it must be below it for a better word."""

WITHIN_MARGIN_TIMES = 6
"""An accuracy that stays below its limit by less than the margin has a better word after so many times the time."""

BRIEF_NS = 1_000_000_000
"""An accuracy that was below its limit for less time than this was over it all the while, ns."""

OVER_THE_LIMIT = "over the limit"
"""Reason of a CAUTION where only the accuracy is to blame, and no source."""
COUNTDOWN = "; "
"""What stands in a reason before the time at which a better word comes."""


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


def word_and_reason(claim: AngleClaim) -> tuple[Safety, str]:
    """Return the word of an angle, and the reason why it is not SAFE."""
    word, reason = _word_and_reason(claim)
    return word, (claim.behind or reason) if word else ""


def _word_and_reason(claim: AngleClaim) -> tuple[Safety, str]:
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


class AngleWord(NamedTuple):
    """Word of an angle at one time.

    Attributes:
        word: the word.
        reason: why it is not SAFE; empty where it is.
        by_accuracy: the word by its accuracy alone.
        by_margin: the word by its accuracy alone, were the limit lower by :data:`MARGIN`.
    """

    word: Safety
    reason: str
    by_accuracy: Safety = Safety.SAFE
    by_margin: Safety = Safety.SAFE


def angle_word(claim: AngleClaim) -> AngleWord:
    """Return the word of an angle, with the words by its accuracy alone."""
    return AngleWord(
        *word_and_reason(claim), *words_by_accuracy(claim.accuracy_95, claim.limit, claim.unsafe_factor)
    )


def words_by_accuracy(accuracy_95: float, limit: float, unsafe_factor: float) -> tuple[Safety, Safety]:
    """Return the word by an accuracy alone, and the word were the limit lower by :data:`MARGIN`."""
    lower = (1.0 - MARGIN) * limit
    return _accuracy_word(accuracy_95, limit, unsafe_factor), _accuracy_word(accuracy_95, lower, unsafe_factor)


def _accuracy_word(accuracy_95: float, limit: float, unsafe_factor: float) -> Safety:
    """Return the word by an accuracy alone; UNSAFE for NaN."""
    if not accuracy_95 <= unsafe_factor * limit:
        return Safety.UNSAFE
    return Safety.SAFE if accuracy_95 <= limit else Safety.CAUTION


class ShownWord(NamedTuple):
    """Word of an angle as it is shown.

    Attributes:
        word: the worst of the last seconds.
        cause: the last reason for a word as bad as this.
        better: the word that follows where nothing changes; None where the shown word is that of now.
        better_in_ns: time until then, ns.
    """

    word: Safety
    cause: str
    better: Safety | None = None
    better_in_ns: int = 0

    def reason(self, now: AngleWord, limit: float) -> str:
        """Return the reason as it is true now: that of now, and when the better word comes.

        Args:
            now: the word of the angle now.
            limit: limit of the accuracy, rad.
        """
        if self.better is None:
            return now.reason
        good = f"within {words.limit_size(limit)} again" if self.cause.startswith("over ") else "good again"
        return f"{now.reason or good}{COUNTDOWN}{self.better.name} in {-(-self.better_in_ns // NS_PER_S)} s"


class HeldWord:
    """The word of one angle as it is shown: worse at once, better after some time.

    Attributes:
        word: as shown last; None before the first.
        since_ns: since when it stands, by the caller's time.
    """

    def __init__(self, better_after_s: float) -> None:
        self._hold_ns = round(better_after_s * 1e9)
        self._held: dict[Safety, _HeldLevel] = {}
        self.word: Safety | None = None
        self.since_ns = 0

    def note(self, now: AngleWord, now_ns: int) -> bool:
        """Take the word of now; return True if the shown word changed."""
        for level in (Safety.CAUTION, Safety.UNSAFE):
            held = self._held.get(level)
            if now.word >= level:
                was_over = now.by_accuracy >= level or (held is not None and held.was_over)
                self._held[level] = _HeldLevel(now_ns, now_ns, was_over, now.reason)
            elif held is not None and now_ns >= self._end_ns(level, now, now_ns):
                del self._held[level]
            elif held is not None and now.by_margin >= level:
                self._held[level] = held._replace(near_ns=now_ns)
        shown = self.shown_word(now, now_ns).word
        changed = shown is not self.word
        if changed:
            self.word, self.since_ns = shown, now_ns
        return changed

    def shown_word(self, now: AngleWord, now_ns: int) -> ShownWord:
        """Return the word that is shown where ``now`` is the word of now: the worst of the last seconds."""
        for level in (Safety.UNSAFE, Safety.CAUTION):
            if now.word >= level:
                return ShownWord(now.word, now.reason)
            end_ns = self._end_ns(level, now, now_ns)
            if now_ns < end_ns:
                is_caution_next = level is Safety.UNSAFE and end_ns < self._end_ns(Safety.CAUTION, now, now_ns)
                better = Safety.CAUTION if is_caution_next or now.word >= Safety.CAUTION else Safety.SAFE
                return ShownWord(level, self._held[level].cause, better, end_ns - now_ns)
        return ShownWord(Safety.SAFE, "")

    def _end_ns(self, level: Safety, now: AngleWord, now_ns: int) -> int:
        """Return until when a level is held where nothing changes; now where it is not."""
        held = self._held.get(level)
        if held is None:
            return now_ns
        if not held.was_over:
            return held.last_ns + self._hold_ns
        latest_ns = held.last_ns + WITHIN_MARGIN_TIMES * self._hold_ns
        return latest_ns if now.by_margin >= level else min(held.near_ns + self._hold_ns, latest_ns)


class _HeldLevel(NamedTuple):
    """A word as bad as a level, while it is held.

    Attributes:
        last_ns: when the word was last as bad.
        near_ns: when it was last as bad, or the accuracy was not below its limit by the margin.
        was_over: whether the accuracy was over its limit in this time.
        cause: the last reason.
    """

    last_ns: int
    near_ns: int
    was_over: bool
    cause: str


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
