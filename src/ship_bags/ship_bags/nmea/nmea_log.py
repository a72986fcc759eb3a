"""Reads ship logs: one record a line, ISO-8601 receive time (UTC), a space, the device's sentence (OpenRVDAS style).

Sentences are parsed by pynmea2; the mast weather line ``MET`` is not NMEA and read here. Nothing is dropped
silently: what is not used, not parsed or fails its checksum is counted.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pynmea2

from ship_bags.errors import BadInput
from ship_bags.stamps import END_OF_TIME_NS, NS_PER_S

_FIRST_FEW = 3
_LONGEST_DELAY_NS = 60 * NS_PER_S
"""No network holds a sentence longer: an instrument's time that is further from the receive time is wrong."""
_ROLLOVER_NS = 1024 * 7 * 86_400 * NS_PER_S
"""GPS counts weeks up to 1023. A receiver that has missed a beginning anew is whole multiples of these behind."""
WRONG_TIME = "instrument time"
"""Why a line is rejected whose time is further from the receive time than a network can hold it."""
_DAY = timedelta(days=1)
_DAY_NS = 86_400 * NS_PER_S

# Fields of the line MET of the station mwx1.
_MET_TEMPERATURE, _MET_HUMIDITY, _MET_PRESSURE = 3, 4, -1
_MET_LEAST_FIELDS = 6


@dataclass(frozen=True)
class LogLine:
    """One line that could be parsed.

    Attributes:
        number: from 1.
        receive_ns: when the ship's network received it, POSIX UTC.
        kind: ``ZDA``, ``GGA``, ``HDT``, ``PSXN20``, ``PSXN23``, ``PASHR`` or ``MET``.
        content: the sentence of pynmea2, or :class:`MetReading`.
    """

    number: int
    receive_ns: int
    kind: str
    content: Any


@dataclass(frozen=True)
class MetReading:
    """What a line MET says of the air at the mast: temperature in °C, relative humidity from 0 to 1, pressure in Pa."""

    temperature_c: float
    humidity: float
    pressure_pa: float


@dataclass
class LogReport:
    """What became of the lines of one file.

    Attributes:
        used: kind → count of lines given out.
        unused: name of the sentence → count of lines with nothing of interest.
        rejected: reason → count; what it was is in ``examples``.
        mended: what was put right in lines given out → count.
        remarks: what else is to be said of the file.
        examples: the first few of each reason, with line number.
    """

    path: Path
    lines: int = 0
    used: Counter[str] = field(default_factory=Counter)
    unused: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)
    mended: Counter[str] = field(default_factory=Counter)
    remarks: list[str] = field(default_factory=list)
    examples: list[str] = field(default_factory=list)

    def reject(self, reason: str, line: int, text: str) -> None:
        """Count a line that cannot be used."""
        self.rejected[reason] += 1
        if self.rejected[reason] <= _FIRST_FEW:
            self.examples.append(f"{self.path.name}:{line}: {reason}: {text[:80]!r}")

    def text(self) -> str:
        """One line for people, and one for each example."""
        parts = [f"used {name} {count}" for name, count in sorted(self.used.items())]
        parts += [f"{name} {count}" for name, count in sorted(self.rejected.items())]
        parts += [f"{name} {count}" for name, count in sorted(self.mended.items())]
        parts += self.remarks
        if self.unused:
            parts.append("not of interest " + ", ".join(f"{n} {count}" for n, count in sorted(self.unused.items())))
        return "\n".join([f"{self.path.name}: {self.lines} lines: {'; '.join(parts)}", *self.examples])


def read_log(path: Path) -> tuple[list[LogLine], LogReport]:
    """All usable lines of a log, in order of the file.

    Raises:
        BadInput: the file is missing, unreadable or empty, or no line begins with a time.
    """
    report = LogReport(path)
    lines = list(_lines(path, report))
    if report.lines == 0:
        raise BadInput("the file is empty: expected lines 'RECEIVE_TIME SENTENCE'", file=path)
    if not lines and not report.unused:
        raise BadInput(f"no line could be read: {report.examples[0]}: expected 'RECEIVE_TIME SENTENCE'", file=path)
    return lines, report


def time_of_day_ns(time_of_day: Any, near_ns: int) -> int:
    """POSIX time of a time of day (UTC) on the day that brings it nearest to ``near_ns``."""
    near = datetime.fromtimestamp(near_ns // NS_PER_S, tz=timezone.utc)
    candidates = [
        datetime.combine((near + offset * _DAY).date(), time_of_day.replace(tzinfo=timezone.utc))
        for offset in (-1, 0, 1)
    ]
    return datetime_ns(min(candidates, key=lambda moment: abs(moment - near)))


def instrument_ns(stamp_ns: int, line: LogLine, report: LogReport) -> int | None:
    """The instrument's time of a line, put right where it is whole GPS week rollovers off; None where it is wrong.

    Args:
        stamp_ns: as the instrument says.
        line: that says so.
        report: counts what is put right, and what is rejected.
    """
    late_ns = line.receive_ns - stamp_ns
    rollovers = round(late_ns / _ROLLOVER_NS)
    if abs(late_ns - rollovers * _ROLLOVER_NS) > _LONGEST_DELAY_NS:
        told = datetime.fromtimestamp(stamp_ns // NS_PER_S, tz=timezone.utc)
        days = abs(late_ns) / _DAY_NS
        apart = f"{days:.1f} days" if days >= 1.0 else f"{abs(late_ns) / NS_PER_S:.0f} s"
        text = f"{told:%Y-%m-%dT%H:%M:%SZ} is {apart} {'before' if late_ns > 0 else 'after'} the receive time"
        report.reject(WRONG_TIME, line.number, text)
        return None
    if rollovers:
        report.mended[f"instrument time put right by {1024 * rollovers:+d} weeks (GPS week rollover)"] += 1
    return stamp_ns + rollovers * _ROLLOVER_NS


def datetime_ns(moment: datetime) -> int:
    """POSIX time of an aware datetime, exact to its microsecond."""
    since_epoch = moment - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return ((since_epoch.days * 86_400 + since_epoch.seconds) * 1_000_000 + since_epoch.microseconds) * 1000


def _lines(path: Path, report: LogReport) -> Iterator[LogLine]:
    try:
        with open(path, encoding="ascii", errors="backslashreplace") as file:
            for number, line in enumerate(file, start=1):
                text = line.strip()
                if text:
                    report.lines += 1
                    parsed = _parsed(number, text, report)
                    if parsed is not None:
                        report.used[parsed.kind] += 1
                        yield parsed
    except OSError as problem:
        raise BadInput(f"cannot be read: {problem.strerror}", file=path) from problem


def _parsed(number: int, text: str, report: LogReport) -> LogLine | None:
    time_text, _, sentence = text.partition(" ")
    receive_ns = _receive_ns(time_text)
    if receive_ns is None:
        report.reject("no receive time", number, text)
        return None
    name = sentence.split(",")[0]
    if name == "MET":
        reading = _met_reading(sentence)
        if reading is None:
            report.reject("unparsed", number, text)
            return None
        return LogLine(number, receive_ns, "MET", reading)
    if not name.startswith("$"):
        known_shape = name.isalpha() and name.isupper() and "," in sentence
        report.unused.update([name] if known_shape else [])
        if not known_shape:
            report.reject("unparsed", number, text)
        return None
    try:
        content = pynmea2.parse(sentence)
    except pynmea2.ChecksumError:
        report.reject("checksum failed", number, text)
        return None
    except Exception:
        # Over sentences that are cut short pynmea2 raises IndexError and others, which it does not declare.
        report.reject("unparsed", number, text)
        return None
    return _of_interest(number, receive_ns, text, content, report)


def _of_interest(number: int, receive_ns: int, text: str, content: Any, report: LogReport) -> LogLine | None:
    """The line if its sentence is one of those used, complete, and its fields are numbers; otherwise None."""
    kind = type(content).__name__
    needed = {
        "ZDA": ("timestamp", "day", "month", "year"),
        "GGA": ("timestamp",),
        "HDT": ("heading",),
        "SXN20": ("head_qual", "rp_qual"),
        "SXN23": ("roll", "pitch", "head"),
        "ASHRATT": ("timestamp", "true_heading", "roll", "pitch"),
    }.get(kind)
    if needed is None:
        _, sentence = text.split(" ", 1)
        name = sentence.split(",")[0].lstrip("$")
        # The sentences PSXN are told apart by a number behind the name, which pynmea2 puts into the name of its class.
        report.unused[name + kind.removeprefix("SXN") if "SXN" in kind else name] += 1
        return None
    # Where a field is no number pynmea2 gives its text.
    is_whole = all(not isinstance(getattr(content, name), (str, type(None))) for name in needed)
    if kind == "ZDA" and is_whole and not 1970 < content.year < 2038:
        report.reject("no year of ours", number, text)
        return None
    if not is_whole or (kind == "GGA" and not _has_readable_position(content)):
        report.reject("unparsed", number, text)
        return None
    names = {"SXN20": "PSXN20", "SXN23": "PSXN23", "ASHRATT": "PASHR"}
    return LogLine(number, receive_ns, names.get(kind, kind), content)


def _has_readable_position(gga: Any) -> bool:
    """Whether latitude and longitude are numbers, or not given."""
    try:
        return not (gga.lat and gga.lon) or abs(gga.latitude) + abs(gga.longitude) >= 0.0
    except ValueError:
        return False


def _receive_ns(text: str) -> int | None:
    base, _, fraction = text.removesuffix("Z").partition(".")
    try:
        moment = datetime.fromisoformat(base).replace(tzinfo=timezone.utc)
        time_ns = datetime_ns(moment) + (int(fraction[:9].ljust(9, "0")) if fraction else 0)
    except ValueError:
        return None
    # The time of day in a sentence may lie on the day before or after: both must be times that a stamp can carry.
    return time_ns if _DAY_NS <= time_ns < END_OF_TIME_NS - 2 * _DAY_NS else None


def _met_reading(sentence: str) -> MetReading | None:
    fields = sentence.split(",")
    if len(fields) < _MET_LEAST_FIELDS:
        return None
    try:
        return MetReading(
            temperature_c=float(fields[_MET_TEMPERATURE]),
            humidity=float(fields[_MET_HUMIDITY]) / 100.0,
            pressure_pa=float(fields[_MET_PRESSURE]) * 100.0,
        )
    except ValueError:
        return None
