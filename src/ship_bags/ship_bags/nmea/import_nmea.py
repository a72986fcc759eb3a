"""Turns ship logs into a bag: one attitude system as the INS, others as references, position and weather."""

from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.nmea.nmea_attitude import LONGEST_GAP_S, LoggedAttitude, attitudes, resampled
from ship_bags.nmea.nmea_log import LogLine, LogReport, read_log
from ship_bags.nmea.nmea_messages import Timed, fix_messages, gyro_messages, imu_messages, weather_messages

IMPORT_RECORD = "import_nmea"
"""Name of the metadata record, and with .yaml of the attachment, that mark an imported bag."""

GYRO_NAME = "gyro"
INSTRUMENT_TIME = "instrument"
RECEIVE_TIME = "receive"


@dataclass(frozen=True)
class ImportOrder:
    """What to import.

    Attributes:
        ins: log of the attitude system that becomes ``ins/imu`` and ``gnss/fix``.
        references: name → log of another attitude system, ``reference/<name>/imu``, never resampled.
        weather: log with lines MET.
        gyro: log with HDT, which becomes ``reference/gyro/imu``.
        time: :data:`INSTRUMENT_TIME` or :data:`RECEIVE_TIME`: what stamps attitudes and fixes.
        resample_hz: rate of ``ins/imu`` by a rotation spline; None leaves the log's own samples.
        suite: suite configuration to attach.
    """

    ins: Path
    references: dict[str, Path] = field(default_factory=dict)
    weather: Path | None = None
    gyro: Path | None = None
    time: str = INSTRUMENT_TIME
    resample_hz: float | None = None
    suite: Path | None = None


def import_logs(order: ImportOrder, out_path: Path) -> list[LogReport]:
    """Write the bag.

    Returns:
        What became of the lines of each file.

    Raises:
        BadInput: a file is missing, empty or without what it is given for.
    """
    factory = RosbagsFactory()
    by_instrument = order.time == INSTRUMENT_TIME
    ins_lines, report = read_log(order.ins)
    reports, timed = [report], list[Timed]()
    samples = _attitudes(ins_lines, report, by_instrument)
    if order.resample_hz is not None:
        samples = resampled(samples, order.resample_hz)
        if not samples:
            raise BadInput(f"{order.ins}: no two attitudes within {LONGEST_GAP_S:g} s of each other to resample")
    timed += imu_messages(factory, "ins/imu", "ins", samples)
    timed += fix_messages(factory, ins_lines, by_instrument)
    for name, path in sorted(order.references.items()):
        lines, report = read_log(path)
        reports.append(report)
        timed += imu_messages(factory, f"reference/{name}/imu", name, _attitudes(lines, report, by_instrument))
    if order.gyro is not None:
        lines, report = _read_with(order.gyro, "HDT")
        reports.append(report)
        timed += gyro_messages(factory, f"reference/{GYRO_NAME}/imu", GYRO_NAME, lines)
    if order.weather is not None:
        lines, report = _read_with(order.weather, "MET")
        reports.append(report)
        timed += weather_messages(factory, lines)
    _write(order, out_path, timed, reports)
    return reports


def _attitudes(lines: list[LogLine], report: LogReport, by_instrument: bool) -> list[LoggedAttitude]:
    found = attitudes(lines, report, by_instrument)
    if not found:
        raise BadInput(f"{report.path}: no usable attitude: expected PSXN,23 after ZDA, or PASHR; {report.text()}")
    return found


def _read_with(path: Path, kind: str) -> tuple[list[LogLine], LogReport]:
    lines, report = read_log(path)
    if not report.used[kind]:
        raise BadInput(f"{path}: no {kind} in {report.lines} lines")
    return lines, report


def _write(order: ImportOrder, out_path: Path, timed: list[Timed], reports: list[LogReport]) -> None:
    marks = {
        "source": "ship logs",
        "ins": order.ins.name,
        "time": order.time,
        "resampled_hz": "no" if order.resample_hz is None else f"{order.resample_hz:g}",
        "longest_gap_s": f"{LONGEST_GAP_S:g}",
        **{f"reference.{name}": path.name for name, path in sorted(order.references.items())},
    }
    counts = {
        report.path.name: {
            "lines": report.lines,
            "used": dict(sorted(report.used.items())),
            "rejected": dict(sorted(report.rejected.items())),
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
                raise BadInput(f"{order.suite}: cannot be read: {problem.strerror}") from problem
        for log_time_ns, topic, message in sorted(timed, key=lambda entry: entry[:2]):
            bag.write(topic, message, log_time_ns)
