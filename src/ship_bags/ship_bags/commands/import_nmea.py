"""``import_nmea``: ship logs → bag with attitudes of the INS and of references, position, gyro heading and weather.

A line of a log has an ISO 8601 receive time, a space and a sentence (OpenRVDAS style).
"""

import argparse
import math
import re
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import yaml

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory
from ship_bags.nmea.instrument import (
    AIR_KINDS,
    GNSS,
    GYRO,
    HEADING_KINDS,
    INS,
    INSTRUMENT_TIME,
    REFERENCE,
    WEATHER,
    Instrument,
    InstrumentRole,
    TimedMessage,
    imu_message,
)
from ship_bags.nmea.instrument_lines import (
    INCOMPLETE,
    OPTIONAL,
    REQUIRED,
    WRONG_TIME,
    InstrumentLine,
    LineReport,
    ParsedText,
    TalkerComparison,
    clock_problem,
    datetime_ns,
    is_talker,
    parse_line,
)
from ship_bags.nmea.nmea_attitude import (
    ATTITUDE_KINDS,
    MAX_GAP_S,
    WITHOUT_TIME,
    AttitudeReader,
    LoggedAttitude,
    resample,
)
from ship_bags.nmea.sentences import NotOfInterest, Unusable
from ship_bags.output_files import add_force_option, check_file
from ship_bags.stamps import END_OF_TIME_NS, NS_PER_S, ns_from_stamp

_HIGHEST_RATE_HZ = 1000.0

IMPORT_RECORD = "import_nmea"
"""Name of the metadata record of an imported bag; the bag's attachment has this name with .yaml."""

GYRO_NAME = "gyro"
RECEIVE_TIME = "receive"

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


@dataclass(frozen=True)
class ImportRequest:
    """Inputs and options of an import.

    Attributes:
        ins: log of the attitude system for ``ins/imu`` and ``gnss/fix``; a log with positions and without any attitude
            gives ``gnss/fix`` only.
        references: name → log of another attitude system, for ``reference/<name>/imu``, never resampled.
        weather: log with MET, MDA or XDR.
        gyro: log with HDT or THS, for ``reference/gyro/imu``.
        time: source of the stamps of attitudes and fixes: :data:`INSTRUMENT_TIME` or :data:`RECEIVE_TIME`.
        resample_hz: rate of ``ins/imu``, resampled by a rotation spline; None to keep the samples of the log.
        suite: suite configuration to attach.
        rules: rules for reading the lines.
        quality_9_is_fix: as in :class:`ship_bags.nmea.instrument.InstrumentRole`.
    """

    ins: Path
    references: dict[str, Path] = field(default_factory=dict)
    weather: Path | None = None
    gyro: Path | None = None
    time: str = INSTRUMENT_TIME
    resample_hz: float | None = None
    suite: Path | None = None
    rules: LogRules = field(default_factory=LogRules)
    quality_9_is_fix: bool = False


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="import_nmea",
        example="--ins seapath.log --out voyage.mcap --resample 20",
        epilog="exit code: 0 written; 2 bad input or usage, with one line of reason; 130 interrupted",
        description="Turn ship logs (lines 'RECEIVE_TIME SENTENCE': GGA, ZDA, HDT, THS, PSXN 20 and 23, PASHR, PRDID, "
        "PTNTHPR, PSAT,HPR, ROT, MDA, XDR, MET) into a bag with ins/imu, reference/<name>/imu, gnss/fix and met/*. Log "
        "time is the receive time.",
    )
    parser.add_argument("--ins", type=Path, required=True, metavar="FILE", help="log of the system taken as the INS")
    parser.add_argument(
        "--reference",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="log of another attitude system (any number of times)",
    )
    parser.add_argument("--weather", type=Path, metavar="FILE", help="log with MET, MDA or XDR")
    parser.add_argument(
        "--gyro", type=Path, metavar="FILE", help=f"log with HDT or THS, becomes reference/{GYRO_NAME}/imu"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="BAG.mcap", help="bag to write")
    parser.add_argument(
        "--time",
        choices=(INSTRUMENT_TIME, RECEIVE_TIME),
        default=INSTRUMENT_TIME,
        help="stamp attitudes and fixes by the instrument's own time (ZDA) or by the receive time "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--talker",
        action="append",
        default=[],
        metavar="XX",
        help="use only sentences of this talker, as GP (any number of times); proprietary sentences have no talker",
    )
    parser.add_argument(
        "--checksum",
        choices=(REQUIRED, OPTIONAL),
        default=REQUIRED,
        help="optional: use sentences without a checksum if they have all fields (default: %(default)s)",
    )
    parser.add_argument(
        "--quality-9-is-fix",
        action="store_true",
        help="take a GGA of quality 9 as a fix with SBAS, as some manufacturers define it (default: no fix)",
    )
    parser.add_argument(
        "--resample", type=float, metavar="HZ", help="resample ins/imu by a rotation spline, with angular velocity [Hz]"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="suite configuration to attach to the bag")
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    check_file(options.out, options.force)
    rate_hz = options.resample
    if rate_hz is not None and not (math.isfinite(rate_hz) and 0.0 < rate_hz <= _HIGHEST_RATE_HZ):
        raise BadInput(f"--resample {rate_hz:g}: expected a rate above 0 and up to {_HIGHEST_RATE_HZ:g} Hz")
    order = ImportRequest(
        ins=options.ins,
        references=_references(options.reference),
        weather=options.weather,
        gyro=options.gyro,
        time=options.time,
        resample_hz=rate_hz,
        suite=options.config,
        rules=LogRules(options.checksum == REQUIRED, _talkers(options.talker)),
        quality_9_is_fix=options.quality_9_is_fix,
    )
    for report in import_logs(order, options.out):
        print(report.text())
    return EXIT_DONE


def import_logs(order: ImportRequest, out_path: Path) -> list[LogReport]:
    """Import the logs and write the bag.

    Returns:
        Report on the lines of each file.

    Raises:
        BadInput: a file is missing, empty or unusable for its purpose, or the bag cannot be created.
        OSError: the bag cannot be written.
    """
    factory = RosbagsFactory()
    by_instrument = order.time == INSTRUMENT_TIME
    ins_lines, report = read_log(order.ins, order.rules)
    reports = [report]
    receiver = InstrumentRole(GNSS, by_instrument, quality_9_is_fix=order.quality_9_is_fix)
    fixes = _messages(factory, receiver, INS, ins_lines, report)
    timed: list[TimedMessage] = []
    if not fixes or any(report.used[kind] for kind in ATTITUDE_KINDS):
        samples = _attitudes(ins_lines, report, by_instrument)
        if order.resample_hz is not None:
            samples = resample(samples, order.resample_hz)
            if not samples:
                raise BadInput(f"no two attitudes within {MAX_GAP_S:g} s of each other to resample", file=order.ins)
        timed += [imu_message(factory, INS, INS, sample) for sample in samples]
    else:
        report.remarks.append("the log contains no attitude: only gnss/fix is written")
        _remark_on_clock(report, [(log_ns, ns_from_stamp(message.header.stamp)) for log_ns, _, message in fixes])
    timed += fixes
    for name, path in sorted(order.references.items()):
        lines, report = read_log(path, order.rules)
        reports.append(report)
        timed += [
            imu_message(factory, REFERENCE, name, sample) for sample in _attitudes(lines, report, by_instrument)
        ]
    for becomes, name, log, kinds in (
        (GYRO, GYRO_NAME, order.gyro, HEADING_KINDS),
        (WEATHER, WEATHER, order.weather, AIR_KINDS),
    ):
        if log is not None:
            lines, report = read_log(log, order.rules)
            reports.append(report)
            if not any(report.used[kind] for kind in kinds):
                *others, last = kinds
                raise BadInput(f"no {', '.join(others)} or {last} in {report.lines} lines", file=log)
            timed += _messages(factory, InstrumentRole(becomes), name, lines, report)
    _write(order, out_path, timed, reports)
    return reports


def _messages(
    factory: MessageFactory, role: InstrumentRole, name: str, lines: list[InstrumentLine], report: LogReport
) -> list[TimedMessage]:
    instrument = Instrument(factory, role, name, report)
    return [message for line in lines for message in instrument.take(line)]


def _attitudes(lines: list[InstrumentLine], report: LogReport, by_instrument: bool) -> list[LoggedAttitude]:
    reader = AttitudeReader(by_instrument, report)
    found = [attitude for line in lines if (attitude := reader.take(line)) is not None]
    reader.reject_waiting()
    if not found and report.rejected[WRONG_TIME]:
        example = next(text for text in report.examples if WRONG_TIME in text)
        raise BadInput(f"no usable attitude: {example}; --time receive stamps by the receive time", file=report.path)
    if not found:
        expected = "PSXN,23 with ZDA, PASHR, PRDID, PTNTHPR or PSAT,HPR"
        raise BadInput(f"no usable attitude: expected {expected}; {report.text()}", file=report.path)
    if lost := report.rejected[WITHOUT_TIME]:
        report.remarks.append(f"{lost} of {lost + len(found)} attitudes have no ZDA of their own: --time receive")
    _remark_on_clock(report, [(attitude.log_time_ns, attitude.stamp_ns) for attitude in found])
    return found


def _remark_on_clock(report: LogReport, times_ns: list[tuple[int, int]]) -> None:
    """Add a remark if an instrument's clock is ahead of or behind the receive times.

    ``times_ns`` are (receive time, stamp) of messages.
    """
    delay_ns = int(np.median([receive_ns - stamp_ns for receive_ns, stamp_ns in times_ns]))
    if text := clock_problem(delay_ns, "the receive times"):
        report.remarks.append(f"{text}: use --time receive")


def _write(order: ImportRequest, out_path: Path, timed: list[TimedMessage], reports: list[LogReport]) -> None:
    marks = {
        "source": "ship logs",
        "ins": order.ins.name,
        "time": order.time,
        "resampled_hz": "no" if order.resample_hz is None else f"{order.resample_hz:g}",
        "longest_gap_s": f"{MAX_GAP_S:g}",
        **{f"reference.{name}": path.name for name, path in sorted(order.references.items())},
    }
    counts = {
        report.path.name: {
            "lines": report.lines,
            "used": dict(sorted(report.used.items())),
            "rejected": dict(sorted(report.rejected.items())),
            **({"put_right": dict(sorted(report.corrected.items()))} if report.corrected else {}),
            "not_of_interest": dict(sorted(report.unused.items())),
        }
        for report in reports
    }
    with BagWriter(out_path) as bag:
        bag.add_metadata(IMPORT_RECORD, marks)
        bag.add_attachment(f"{IMPORT_RECORD}.yaml", yaml.safe_dump({**marks, "files": counts}, sort_keys=False))
        if order.suite is not None:
            try:
                bag.add_attachment(SUITE_ATTACHMENT, order.suite.read_bytes())
            except OSError as problem:
                raise BadInput(f"cannot be read: {problem.strerror}", file=order.suite) from problem
        for log_time_ns, topic, message in sorted(timed, key=lambda entry: entry[:2]):
            bag.write(topic, message, log_time_ns)


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


def _talkers(texts: Sequence[str]) -> frozenset[str]:
    for text in texts:
        if not is_talker(text):
            raise BadInput(f"--talker {text}: expected two capital letters, as GP")
    return frozenset(texts)


def _references(texts: Sequence[str]) -> dict[str, Path]:
    references: dict[str, Path] = {}
    for text in texts:
        name, separator, path = text.partition("=")
        # The name becomes part of a topic's name.
        if not separator or not path or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise BadInput(f"--reference {text}: expected NAME=FILE with a name of letters, digits and _")
        if name in references:
            raise BadInput(f"--reference {text}: the name '{name}' is given twice")
        references[name] = Path(path)
    return references
