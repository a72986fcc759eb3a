"""Import of ship logs into a bag: attitude of the INS and of references, position, gyrocompass heading and weather."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

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
from ship_bags.nmea.instrument_line import WRONG_TIME, InstrumentLine, clock_problem
from ship_bags.nmea.nmea_attitude import (
    ATTITUDE_KINDS,
    MAX_GAP_S,
    WITHOUT_TIME,
    AttitudeReader,
    LoggedAttitude,
    resample,
)
from ship_bags.nmea.nmea_log import LogReport, LogRules, read_log
from ship_bags.stamps import ns_from_stamp

IMPORT_RECORD = "import_nmea"
"""Name of the metadata record of an imported bag; the bag's attachment has this name with .yaml."""

GYRO_NAME = "gyro"
RECEIVE_TIME = "receive"


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
            lines, report = _read_required(log, kinds, order.rules)
            reports.append(report)
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
    reader.finish()
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


def _read_required(path: Path, kinds: Sequence[str], rules: LogRules) -> tuple[list[InstrumentLine], LogReport]:
    lines, report = read_log(path, rules)
    if not any(report.used[kind] for kind in kinds):
        *others, last = kinds
        raise BadInput(f"no {', '.join(others)} or {last} in {report.lines} lines", file=path)
    return lines, report


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
