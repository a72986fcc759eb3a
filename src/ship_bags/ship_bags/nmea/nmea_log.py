"""Reads ship logs: one record a line, ISO-8601 receive time (UTC), a space, the device's sentence (OpenRVDAS style)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.nmea.instrument_line import InstrumentLine, LineReport, datetime_ns
from ship_bags.nmea.sentences import NotOfInterest, Unusable, read_sentence
from ship_bags.stamps import END_OF_TIME_NS, NS_PER_S

_DAY_NS = 86_400 * NS_PER_S


@dataclass
class LogReport(LineReport):
    """What became of the lines of one file; ``remarks`` hold what else is to be said of it."""

    path: Path = Path()
    remarks: list[str] = field(default_factory=list)

    def text(self) -> str:
        """One line for people, and one for each example."""
        parts = [f"used {name} {count}" for name, count in sorted(self.used.items())]
        parts += [f"{name} {count}" for name, count in sorted(self.rejected.items())]
        parts += [f"{name} {count}" for name, count in sorted(self.mended.items())]
        parts += self.remarks
        if self.unused:
            parts.append("not of interest " + ", ".join(f"{n} {count}" for n, count in sorted(self.unused.items())))
        return "\n".join([f"{self.name}: {self.lines} lines: {'; '.join(parts)}", *self.examples])


def read_log(path: Path) -> tuple[list[InstrumentLine], LogReport]:
    """All usable lines of a log, in order of the file.

    Raises:
        BadInput: the file is missing, unreadable or empty, or no line begins with a time.
    """
    report = LogReport(path.name, path=path)
    lines = list(_lines(path, report))
    if report.lines == 0:
        raise BadInput("the file is empty: expected lines 'RECEIVE_TIME SENTENCE'", file=path)
    if not lines and not report.unused:
        raise BadInput(f"no line could be read: {report.examples[0]}: expected 'RECEIVE_TIME SENTENCE'", file=path)
    return lines, report


def _lines(path: Path, report: LogReport) -> Iterator[InstrumentLine]:
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


def _parsed(number: int, text: str, report: LogReport) -> InstrumentLine | None:
    time_text, _, sentence_text = text.partition(" ")
    receive_ns = _receive_ns(time_text)
    if receive_ns is None:
        report.reject("no receive time", number, text)
        return None
    sentence = read_sentence(sentence_text)
    if isinstance(sentence, NotOfInterest):
        report.unused[sentence.name] += 1
        return None
    if isinstance(sentence, Unusable):
        report.reject(sentence.reason, number, text)
        return None
    return InstrumentLine(number, receive_ns, sentence.kind, sentence.content)


def _receive_ns(text: str) -> int | None:
    base, _, fraction = text.removesuffix("Z").partition(".")
    try:
        moment = datetime.fromisoformat(base).replace(tzinfo=timezone.utc)
        time_ns = datetime_ns(moment) + (int(fraction[:9].ljust(9, "0")) if fraction else 0)
    except ValueError:
        return None
    # The time of day in a sentence may lie on the day before or after: both must be times that a stamp can carry.
    return time_ns if _DAY_NS <= time_ns < END_OF_TIME_NS - 2 * _DAY_NS else None
