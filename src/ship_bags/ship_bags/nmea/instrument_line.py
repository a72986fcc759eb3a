"""Line of an instrument with its receive time, counts of lines, and correction of the instrument's time.

No line is dropped silently: unused and rejected lines are counted.
"""

from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from typing import Any

from ship_bags.stamps import NS_PER_S

WRONG_TIME = "instrument time"
"""Reason for rejecting a line whose time is too far from the receive time for a network delay."""

_MAX_EXAMPLES = 3
_LONGEST_DELAY_NS = 60 * NS_PER_S
"""Maximum difference of an instrument's time from the receive time, ns; no network delays a sentence by more."""
_ROLLOVER_NS = 1024 * 7 * 86_400 * NS_PER_S
"""Period of the GPS week number, 1024 weeks, ns. A receiver that misses rollovers is behind by a multiple."""
_AHEAD_NS = NS_PER_S // 20
"""Time ahead of the receive time above which an instrument's clock is reported, ns; estimators reject such stamps."""
_BEHIND_NS = 5 * NS_PER_S
"""Time behind the receive time above which an instrument's clock is reported, ns.

A slow serial line or computer delays a sentence by less.
"""
_GPS_AHEAD_NS, _SAME_NS = 18 * NS_PER_S, NS_PER_S // 2
"""GPS time minus UTC since 2017, and the tolerance within which an offset counts as equal to it, ns."""
_DAY = timedelta(days=1)
_DAY_NS = 86_400 * NS_PER_S


@dataclass(frozen=True)
class InstrumentLine:
    """Line that was parsed.

    Attributes:
        number: number of the line, from 1.
        receive_ns: receive time in the ship's network, POSIX UTC.
        kind: kind of the sentence, see :class:`ship_bags.nmea.sentences.Sentence`.
        content: content of the sentence.
        talker: two letters of the sender; empty for a proprietary sentence.
    """

    number: int
    receive_ns: int
    kind: str
    content: Any
    talker: str = ""


@dataclass
class LineReport:
    """Counts of the lines of one instrument.

    Attributes:
        name: name of the instrument or its file, for texts.
        lines: number of lines of a log that are not empty, or of texts of a live source.
        used: kind → number of lines used.
        unused: name of the sentence, or talker that is not used → number of irrelevant lines.
        rejected: reason → number of unusable lines.
        corrected: correction → number of used lines with this correction.
        examples: the first few lines of each reason, with line number.
    """

    name: str
    lines: int = 0
    used: Counter[str] = field(default_factory=Counter)
    unused: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)
    corrected: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)

    def reject(self, reason: str, line: int, text: str) -> None:
        """Count an unusable line."""
        self.rejected[reason] += 1
        if self.rejected[reason] <= _MAX_EXAMPLES:
            self.examples.append(f"{self.name}:{line}: {reason}: {text[:80]!r}")


def time_of_day_ns(time_of_day: Any, near_ns: int) -> int:
    """Return the POSIX time of a time of day (UTC) on the day that brings it nearest to ``near_ns``."""
    near = datetime.fromtimestamp(near_ns // NS_PER_S, tz=timezone.utc)
    candidates = [
        datetime.combine((near + offset * _DAY).date(), time_of_day.replace(tzinfo=timezone.utc))
        for offset in (-1, 0, 1)
    ]
    return datetime_ns(min(candidates, key=lambda moment: abs(moment - near)))


def instrument_ns(stamp_ns: int, line: InstrumentLine, report: LineReport) -> int | None:
    """Return the instrument's time of a line, corrected for whole GPS week rollovers; None if the time is wrong.

    Args:
        stamp_ns: time as stated by the instrument.
        line: the line.
        report: counts of corrections and rejections.
    """
    result_ns = corrected_ns(stamp_ns, line.receive_ns)
    if result_ns is None:
        late_ns = line.receive_ns - stamp_ns
        stated = datetime.fromtimestamp(stamp_ns // NS_PER_S, tz=timezone.utc)
        days = abs(late_ns) / _DAY_NS
        difference = f"{days:.1f} days" if days >= 1.0 else f"{abs(late_ns) / NS_PER_S:.0f} s"
        text = f"{stated:%Y-%m-%dT%H:%M:%SZ} is {difference} {'before' if late_ns > 0 else 'after'} the receive time"
        report.reject(WRONG_TIME, line.number, text)
    elif result_ns != stamp_ns:
        weeks = (result_ns - stamp_ns) // _ROLLOVER_NS * 1024
        report.corrected[f"instrument time corrected by {weeks:+d} weeks (GPS week rollover)"] += 1
    return result_ns


def corrected_ns(stamp_ns: int, receive_ns: int) -> int | None:
    """Return an instrument's time corrected for whole GPS week rollovers; None if it is far from the receive time."""
    late_ns = receive_ns - stamp_ns
    rollovers_ns = round(late_ns / _ROLLOVER_NS) * _ROLLOVER_NS
    return stamp_ns + rollovers_ns if abs(late_ns - rollovers_ns) <= _LONGEST_DELAY_NS else None


def clock_problem(delay_ns: int, other_clock: str) -> str:
    """Return a sentence if an instrument's clock is ahead of another clock or behind it; empty otherwise.

    Args:
        delay_ns: time from the instrument's time to the receive time.
        other_clock: the clock of the receive times, for the text.
    """
    if -_AHEAD_NS <= delay_ns <= _BEHIND_NS:
        return ""
    side = "ahead of" if delay_ns < 0 else "behind"
    cause = ""
    if abs(abs(delay_ns) - _GPS_AHEAD_NS) <= _SAME_NS:
        cause = " (GPS time instead of UTC)" if delay_ns < 0 else " (leap seconds subtracted twice)"
    return f"its clock is {abs(delay_ns) / NS_PER_S:.3g} s {side} {other_clock}{cause}"


def datetime_ns(moment: datetime) -> int:
    """Return the POSIX time of an aware datetime, exact to its microsecond, ns."""
    since_epoch = moment - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return ((since_epoch.days * 86_400 + since_epoch.seconds) * 1_000_000 + since_epoch.microseconds) * 1000
