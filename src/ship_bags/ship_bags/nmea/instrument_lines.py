"""Lines of an instrument: parsing into sentences, receive time, corrected instrument time, counts, talkers.

A line is cut where a connection begins, ends or loses bytes, and where a logger stops. Therefore a sentence counts only
if it is present from its ``$`` to its checksum; a truncated heading, ``$HEHDT,21``, may be the beginning of
``$HEHDT,218.0,T``. On request a sentence without a checksum is used if its kind has an end that a truncated sentence
lacks, and all its fields have their forms.

No line is dropped silently: unused and rejected lines are counted. Several instruments of one kind in one stream are
detected by their talkers, and their values are compared, because two receivers or compasses would be mixed on one
topic.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np

from ship_bags.nmea.sentences import NotOfInterest, Sentence, Unusable, number, read_sentence
from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import FloatArray

_NUMBER = r"[+-]?\d+(\.\d+)?"
_TIME = r"\d{6}(\.\d+)?"
_DIGIT, _HEAVE = r"\d", r"[+-]?\d+\.\d{2,}"
_SIGMA = f"({_NUMBER})?"

_FORMS: dict[str, tuple[str, ...]] = {
    "HDT": (_NUMBER, "T"),
    "THS": (f"({_NUMBER})?", "[A-Z]"),
    "ZDA": (_TIME, r"\d\d", r"\d\d", r"\d{4}", r"([+-]?\d\d)?", r"(\d\d)?"),
    "GGA": (
        _TIME, r"(\d{3,4}(\.\d+)?)?", "[NS]?", r"(\d{3,5}(\.\d+)?)?", "[EW]?", _DIGIT, r"(\d+)?", f"({_NUMBER})?",
        f"({_NUMBER})?", "M?", f"({_NUMBER})?", "M?", f"({_NUMBER})?", r"(\d{4})?",
    ),
    "PSXN20": ("20", _DIGIT, _DIGIT, _DIGIT, _DIGIT),
    "PSXN23": ("23", _NUMBER, _NUMBER, _NUMBER, _HEAVE),
    "PRDID": (_NUMBER, _NUMBER, r"\d{1,3}\.\d\d"),
    "PTNTHPR": (_NUMBER, "[A-Z]", _NUMBER, "[A-Z]", _NUMBER, "[A-Z]"),
    "PSAT,HPR": ("HPR", _TIME, _NUMBER, _NUMBER, _NUMBER, "[A-Z]"),
    "ROT": (_NUMBER, "A"),
    "PASHR": (
        _TIME, _NUMBER, "T", _NUMBER, _NUMBER, f"({_NUMBER})?", _SIGMA, _SIGMA, _SIGMA, _DIGIT, _DIGIT,
    ),
}  # fmt: skip
"""Kind of a sentence → form of each field after the name; without MDA and XDR, whose last fields may be void."""

_PATTERNS = {kind: re.compile(",".join(forms), re.ASCII) for kind, forms in _FORMS.items()}


LONGEST_LINE = 512
"""Maximum length of a line, bytes; a standard sentence has 82, a proprietary sentence up to three times as many."""

TOO_LONG, NOISE, INCOMPLETE = "line too long", "binary noise", "half line or no checksum"
BINARY = "binary"

REQUIRED, OPTIONAL = "required", "optional"
"""Checksums of an instrument's sentences: required or optional."""

# In front of a sentence on an IEC 61162-450 network: the datagram's mark and a TAG block.
_FRONT = re.compile(rb"(UdPbC\x00)?(\\[^\\]*\\)*")
_PRINTABLE = re.compile(rb"[\x20-\x7e\t]*")
_CHECKSUM = re.compile(r".*\*[0-9A-Fa-f]{2}", re.DOTALL)

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

_MAX_TALKERS = 20
"""Maximum number of compared talkers per kind of sentence; further talkers count as one."""
_OTHERS = "others"
_EARTH_M_PER_DEG = 111_000.0
_SIMULTANEOUS_NS = 5_000_000_000
"""Maximum interval between two values that are compared, ns."""


@dataclass(frozen=True)
class ParsedText:
    """Text with its parsing result."""

    text: str
    result: Sentence | NotOfInterest | Unusable

    @property
    def talker(self) -> str:
        """Two letters of the talker; empty for a proprietary or broken sentence."""
        if self.result == NotOfInterest(BINARY) or (isinstance(self.result, Unusable) and not self.result.detail):
            return ""
        return self.text[1:3] if self.text.startswith("$") and not self.text.startswith("$P") else ""


def parse_line(line: bytes, needs_checksum: bool = True) -> Iterator[ParsedText]:
    """Yield the texts of a line: one sentence, or several whose line ends were lost.

    Args:
        line: bytes of the line; it may begin with the mark of a datagram and TAG blocks.
        needs_checksum: True to reject sentences without a checksum; otherwise complete sentences are used.
    """
    if len(line) > LONGEST_LINE:
        yield ParsedText(_printable(line), Unusable(TOO_LONG))
        return
    front = _FRONT.match(line)
    before, *sentences = line[front.end() if front else 0 :].strip().split(b"$")
    if not _PRINTABLE.fullmatch(before):
        yield ParsedText(_printable(before), _classify_binary(is_before_sentence=bool(sentences)))
    elif before:
        text = before.decode("ascii")
        yield ParsedText(text, _parse_without_start(text, is_cut=bool(sentences)))
    for place, body in enumerate(sentences, start=1):
        if not _PRINTABLE.fullmatch(body):
            yield ParsedText(_printable(b"$" + body), _classify_binary(is_before_sentence=place < len(sentences)))
            continue
        text = f"${body.decode('ascii').rstrip()}"
        yield ParsedText(text, _parse_text(text, needs_checksum))


def _parse_text(text: str, needs_checksum: bool) -> Sentence | NotOfInterest | Unusable:
    """Parse a text that begins with ``$``."""
    if _CHECKSUM.fullmatch(text):
        return read_sentence(text)
    if needs_checksum or "*" in text:
        return Unusable(INCOMPLETE)
    result = read_sentence(text)
    return Unusable(INCOMPLETE) if isinstance(result, Sentence) and not is_complete(result.kind, text) else result


def is_complete(kind: str, text: str) -> bool:
    """Return True if a sentence without a checksum has all fields of its kind in their forms; False for other kinds."""
    pattern = _PATTERNS.get(kind)
    return pattern is not None and bool(pattern.fullmatch(text.partition(",")[2]))


def is_talker(text: str) -> bool:
    """Return True for two capital letters or digits, the form of a talker."""
    return len(text) == 2 and text.isascii() and text.isalnum() and text.isupper()


def _classify_binary(is_before_sentence: bool) -> NotOfInterest | Unusable:
    """Classify binary data: messages of another protocol (UBX, RTCM) before a sentence, or noise."""
    return NotOfInterest(BINARY) if is_before_sentence else Unusable(NOISE)


def _parse_without_start(text: str, is_cut: bool) -> Sentence | NotOfInterest | Unusable:
    """Parse a text without ``$``: a line ``MET`` of a weather mast, AIS, or the end of a sentence."""
    if text.startswith("!"):
        return NotOfInterest(text.split(",")[0])
    return Unusable(INCOMPLETE) if is_cut or _CHECKSUM.fullmatch(text) else read_sentence(text)


def _printable(line: bytes) -> str:
    return line.decode("ascii", errors="backslashreplace")


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


class TalkerComparison:
    """Comparison of the headings or positions of the talkers in one stream."""

    def __init__(self) -> None:
        self._counts: dict[str, Counter[str]] = {}
        self._last: dict[tuple[str, str], tuple[int, FloatArray]] = {}
        self._largest: dict[str, float] = {}

    def add(self, line: InstrumentLine) -> None:
        """Add a line that is used."""
        value = _value(line)
        if value is None or not line.talker:
            return
        counts = self._counts.setdefault(line.kind, Counter())
        talker = line.talker if line.talker in counts or len(counts) < _MAX_TALKERS else _OTHERS
        counts[talker] += 1
        if len(counts) > 1:
            for other in counts.keys() - {talker}:
                self._compare(line, value, other)
        self._last[line.kind, talker] = line.receive_ns, value

    def texts(self, since_ns: int = 0) -> list[str]:
        """Return one line for each kind of sentence that several talkers have sent since a time.

        The line states the largest difference so far.
        """
        found = []
        for kind, counts in sorted(self._counts.items()):
            recent = [talker for talker in sorted(counts) if self._last[kind, talker][0] >= since_ns]
            if len(recent) > 1:
                names = ", ".join(f"{talker} {counts[talker]}" for talker in recent)
                difference = ""
                if (largest := self._largest.get(kind)) is not None:
                    difference = f", up to {f'{largest:.0f} m' if kind == 'GGA' else f'{largest:.1f}°'} apart"
                found.append(f"{kind} of several talkers ({names}){difference}")
        return found

    def _compare(self, line: InstrumentLine, value: FloatArray, other: str) -> None:
        time_ns, others = self._last.get((line.kind, other), (0, value))
        if 0 <= line.receive_ns - time_ns <= _SIMULTANEOUS_NS:
            self._largest[line.kind] = max(self._largest.get(line.kind, 0.0), _difference(line.kind, value, others))


def _value(line: InstrumentLine) -> FloatArray | None:
    """Return the heading or the position in a line, degrees; None for any other line."""
    if line.kind in ("HDT", "THS"):
        heading_deg = number(line.content.heading)
        return None if heading_deg is None else np.array([heading_deg])
    if line.kind == "GGA" and line.content.lat:
        return np.array([line.content.latitude, line.content.longitude])
    return None


def _difference(kind: str, one: FloatArray, other: FloatArray) -> float:
    """Return the distance of two positions in metres, or the angle between two headings in degrees."""
    difference_deg = (one - other + 180.0) % 360.0 - 180.0
    if kind != "GGA":
        return float(abs(difference_deg[0]))
    north_east = difference_deg * [1.0, np.cos(np.deg2rad(one[0]))]
    return float(np.linalg.norm(north_east)) * _EARTH_M_PER_DEG
