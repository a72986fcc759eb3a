"""A line of an instrument with the time at which it was received, what becomes of lines, and the instrument's own time.

Nothing is dropped silently: what is not used, not parsed or fails its checksum is counted.
"""

from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from typing import Any

from ship_bags.stamps import NS_PER_S

WRONG_TIME = "instrument time"
"""Why a line is rejected whose time is further from the receive time than a network can hold it."""

_FIRST_FEW = 3
_LONGEST_DELAY_NS = 60 * NS_PER_S
"""No network holds a sentence longer: an instrument's time that is further from the receive time is wrong."""
_ROLLOVER_NS = 1024 * 7 * 86_400 * NS_PER_S
"""GPS counts weeks up to 1023. A receiver that has missed a beginning anew is whole multiples of these behind."""
_AHEAD_NS = NS_PER_S // 20
"""An instrument's clock that is further ahead of the receive time is reported, as estimators refuse its stamps, ns."""
_BEHIND_NS = 5 * NS_PER_S
"""A clock that is further behind is reported; a slow line and a busy computer delay a sentence by less, ns."""
_GPS_AHEAD_NS, _SAME_NS = 18 * NS_PER_S, NS_PER_S // 2
"""GPS time less UTC since 2017; and how near an offset must be to it, ns."""
_DAY = timedelta(days=1)
_DAY_NS = 86_400 * NS_PER_S


@dataclass(frozen=True)
class InstrumentLine:
    """One line that could be parsed.

    Attributes:
        number: from 1.
        receive_ns: when the ship's network received it, POSIX UTC.
        kind: of the sentence, see :class:`ship_bags.nmea.sentences.Sentence`.
        content: of the sentence.
        talker: two letters of its sender; empty where the sentence is a maker's own.
    """

    number: int
    receive_ns: int
    kind: str
    content: Any
    talker: str = ""


@dataclass
class LineReport:
    """What became of the lines of one instrument.

    Attributes:
        name: of the instrument or its file, for people.
        used: kind → count of lines given out.
        unused: name of the sentence → count of lines with nothing of interest.
        rejected: reason → count; what it was is in ``examples``.
        mended: what was put right in lines given out → count.
        examples: the first few of each reason, with line number.
    """

    name: str
    lines: int = 0
    used: Counter[str] = field(default_factory=Counter)
    unused: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)
    mended: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)

    def reject(self, reason: str, line: int, text: str) -> None:
        """Count a line that cannot be used."""
        self.rejected[reason] += 1
        if self.rejected[reason] <= _FIRST_FEW:
            self.examples.append(f"{self.name}:{line}: {reason}: {text[:80]!r}")


def time_of_day_ns(time_of_day: Any, near_ns: int) -> int:
    """POSIX time of a time of day (UTC) on the day that brings it nearest to ``near_ns``."""
    near = datetime.fromtimestamp(near_ns // NS_PER_S, tz=timezone.utc)
    candidates = [
        datetime.combine((near + offset * _DAY).date(), time_of_day.replace(tzinfo=timezone.utc))
        for offset in (-1, 0, 1)
    ]
    return datetime_ns(min(candidates, key=lambda moment: abs(moment - near)))


def instrument_ns(stamp_ns: int, line: InstrumentLine, report: LineReport) -> int | None:
    """The instrument's time of a line, put right where it is whole GPS week rollovers off; None where it is wrong.

    Args:
        stamp_ns: as the instrument says.
        line: that says so.
        report: counts what is put right, and what is rejected.
    """
    result_ns = corrected_ns(stamp_ns, line.receive_ns)
    if result_ns is None:
        late_ns = line.receive_ns - stamp_ns
        told = datetime.fromtimestamp(stamp_ns // NS_PER_S, tz=timezone.utc)
        days = abs(late_ns) / _DAY_NS
        apart = f"{days:.1f} days" if days >= 1.0 else f"{abs(late_ns) / NS_PER_S:.0f} s"
        text = f"{told:%Y-%m-%dT%H:%M:%SZ} is {apart} {'before' if late_ns > 0 else 'after'} the receive time"
        report.reject(WRONG_TIME, line.number, text)
    elif result_ns != stamp_ns:
        weeks = (result_ns - stamp_ns) // _ROLLOVER_NS * 1024
        report.mended[f"instrument time put right by {weeks:+d} weeks (GPS week rollover)"] += 1
    return result_ns


def corrected_ns(stamp_ns: int, receive_ns: int) -> int | None:
    """Return an instrument's time without whole GPS week rollovers; None where it is far from the receive time."""
    late_ns = receive_ns - stamp_ns
    rollovers_ns = round(late_ns / _ROLLOVER_NS) * _ROLLOVER_NS
    return stamp_ns + rollovers_ns if abs(late_ns - rollovers_ns) <= _LONGEST_DELAY_NS else None


def clock_problem(delay_ns: int, other_clock: str) -> str:
    """Return a sentence on an instrument's clock that is ahead of another or behind it; empty where it is neither.

    Args:
        delay_ns: from the instrument's time to the receive time.
        other_clock: the clock of the receive times, for people.
    """
    if -_AHEAD_NS <= delay_ns <= _BEHIND_NS:
        return ""
    side = "ahead of" if delay_ns < 0 else "behind"
    is_gps = abs(abs(delay_ns) - _GPS_AHEAD_NS) <= _SAME_NS
    cause = " (GPS time for UTC, or leap seconds subtracted twice)" if is_gps else ""
    return f"its clock is {abs(delay_ns) / NS_PER_S:.3g} s {side} {other_clock}{cause}"


def datetime_ns(moment: datetime) -> int:
    """POSIX time of an aware datetime, exact to its microsecond."""
    since_epoch = moment - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return ((since_epoch.days * 86_400 + since_epoch.seconds) * 1_000_000 + since_epoch.microseconds) * 1000
