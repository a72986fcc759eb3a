"""Reader of ship logs; a line has an ISO 8601 receive time, a space and a sentence (OpenRVDAS style)."""

import re
from collections.abc import Iterator, Set
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.nmea.instrument_line import InstrumentLine, LineReport, datetime_ns
from ship_bags.nmea.lines import INCOMPLETE, ParsedText, parse_line
from ship_bags.nmea.sentences import NotOfInterest, Unusable
from ship_bags.nmea.talkers import TalkerComparison
from ship_bags.stamps import END_OF_TIME_NS, NS_PER_S

_DAY_NS = 86_400 * NS_PER_S
_TIME = re.compile(
    r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(?:Z|([+-])(\d\d):?(\d\d)?)?", re.ASCII
)
"""Date and time, fraction of a second, and offset from UTC (sign, hours, minutes); a time without offset is UTC."""


@dataclass(frozen=True)
class LogRules:
    """Rules for reading the lines of logs.

    Attributes:
        needs_checksum: True to reject sentences without a checksum; otherwise complete sentences are used.
        talkers: talkers whose sentences are used; empty for all. Proprietary sentences, which have no talker, are
            always used.
    """

    needs_checksum: bool = True
    talkers: Set[str] = frozenset()


@dataclass
class LogReport(LineReport):
    """Counts of the lines of one file; ``remarks`` are further texts about the file."""

    path: Path = Path()
    remarks: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Return one line for the user, and one line for each example."""
        parts = [f"used {name} {count}" for name, count in sorted(self.used.items())]
        parts += [f"{name} {count}" for name, count in sorted(self.rejected.items())]
        parts += [f"{name} {count}" for name, count in sorted(self.corrected.items())]
        parts += self.remarks
        if self.unused:
            parts.append("not of interest " + ", ".join(f"{n} {count}" for n, count in sorted(self.unused.items())))
        return "\n".join([f"{self.name}: {self.lines} lines: {'; '.join(parts)}", *self.examples])


def read_log(path: Path, rules: LogRules) -> tuple[list[InstrumentLine], LogReport]:
    """Return all usable lines of a log, in order of the file.

    Raises:
        BadInput: the file is missing, unreadable or empty, or none of its lines can be read.
    """
    report, talkers = LogReport(path.name, path=path), TalkerComparison()
    lines = list(_lines(path, rules, report))
    for line in lines:
        talkers.add(line)
    report.remarks += [f"{text}: choose one with --talker" for text in talkers.texts()]
    if report.lines == 0:
        raise BadInput("the file is empty: expected lines 'RECEIVE_TIME SENTENCE'", file=path)
    if not lines and report.rejected[INCOMPLETE]:
        advice = (
            "--checksum optional also uses complete sentences without a checksum"
            if rules.needs_checksum
            else "no sentence is complete"
        )
        raise BadInput(f"no line could be read: {report.examples[0]}: {advice}", file=path)
    if not lines and not report.unused:
        raise BadInput(f"no line could be read: {report.examples[0]}: expected 'RECEIVE_TIME SENTENCE'", file=path)
    return lines, report


def _lines(path: Path, rules: LogRules, report: LogReport) -> Iterator[InstrumentLine]:
    try:
        with open(path, "rb") as file:
            for number, line in enumerate(file, start=1):
                if content := line.strip():
                    report.lines += 1
                    yield from _parse(number, content, rules, report)
    except OSError as problem:
        raise BadInput(f"cannot be read: {problem.strerror}", file=path) from problem


def _parse(number: int, content: bytes, rules: LogRules, report: LogReport) -> Iterator[InstrumentLine]:
    """Yield the sentences in a line of the file, usually one."""
    time_text, _, sentences = content.partition(b" ")
    receive_ns = _receive_ns(time_text.decode("ascii", errors="replace"))
    if receive_ns is None or sentences.lstrip()[:1] in (b"+", b"-"):  # an offset after a space
        report.reject("no receive time", number, content.decode("ascii", errors="backslashreplace"))
        return
    for parsed in parse_line(sentences, rules.needs_checksum):
        line = _line(number, receive_ns, parsed, rules, report)
        if line is not None:
            report.used[line.kind] += 1
            yield line


def _line(
    number: int, receive_ns: int, parsed: ParsedText, rules: LogRules, report: LogReport
) -> InstrumentLine | None:
    result = parsed.result
    if rules.talkers and parsed.talker and parsed.talker not in rules.talkers:
        report.unused[f"talker {parsed.talker}"] += 1
    elif isinstance(result, NotOfInterest):
        report.unused[result.name] += 1
    elif isinstance(result, Unusable):
        report.reject(result.detail or result.reason, number, parsed.text)
    else:
        return InstrumentLine(number, receive_ns, result.kind, result.content, parsed.talker)
    return None


def _receive_ns(text: str) -> int | None:
    """Return a time text as POSIX time, ns; None if the text is invalid or the time out of range."""
    match = _TIME.fullmatch(text)
    if match is None:
        return None
    base, fraction, sign, hours, minutes = match.groups()
    try:
        offset = timedelta(hours=int(hours or 0), minutes=int(minutes or 0)) * (-1 if sign == "-" else 1)
        moment = datetime.fromisoformat(base).replace(tzinfo=timezone(offset))
        time_ns = datetime_ns(moment) + int((fraction or "0").ljust(9, "0"))
    except ValueError:
        return None
    # The time in a sentence may belong to the day before or after the receive time: the stamps of both must be valid.
    return time_ns if _DAY_NS <= time_ns < END_OF_TIME_NS - 2 * _DAY_NS else None
