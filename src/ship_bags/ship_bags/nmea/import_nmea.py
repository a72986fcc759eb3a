"""Turns ship logs into a bag: one attitude system as the INS, others as references, position and weather."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory
from ship_bags.nmea.nmea_attitude import ATTITUDE_KINDS, LONGEST_GAP_S, LoggedAttitude, attitudes, resampled
from ship_bags.nmea.nmea_log import WRONG_TIME, LogLine, LogReport, instrument_ns, read_log, time_of_day_ns
from ship_bags.stamps import make_header
from ship_geometry.frames import rotation_from_angles
from ship_geometry.ros_axes import flu_from_device_vector, quaternion_from_rotation
from ship_geometry.rotations import FloatArray

IMPORT_RECORD = "import_nmea"
"""Name of the metadata record, and with .yaml of the attachment, that mark an imported bag."""

GYRO_NAME = "gyro"
INSTRUMENT_TIME = "instrument"
RECEIVE_TIME = "receive"

_Timed = tuple[int, str, Any]
"""(log time in ns, topic, message)."""

_GYRO_HEADING_SIGMA_DEG = 0.1
"""Assumed of a gyrocompass, which says nothing of its own accuracy."""

_UNKNOWN_ANGLE_VARIANCE = 1.0
"""Variance (rad²) of roll and pitch where only a heading is measured: as good as unknown."""

_RANGE_SIGMA_M = 3.0
"""Position error per unit of dilution of precision, single-point GNSS."""

_UNKNOWN = np.zeros(9)
_NOT_GIVEN = np.array([-1.0, *np.zeros(8)])

# NavSatStatus by the quality field of GGA: none, single, differential, (PPS), RTK fixed, RTK float.
_NO_FIX, _FIX, _AUGMENTED, _GROUND_AUGMENTED = -1, 0, 1, 2
_FIX_STATUS = {0: _NO_FIX, 1: _FIX, 2: _AUGMENTED, 3: _FIX, 4: _GROUND_AUGMENTED, 5: _GROUND_AUGMENTED}
_SERVICE_GPS = 1
_COVARIANCE_UNKNOWN, _COVARIANCE_APPROXIMATED = 0, 1


@dataclass(frozen=True)
class ImportOrder:
    """What to import.

    Attributes:
        ins: log of the attitude system that becomes ``ins/imu`` and ``gnss/fix``; where it has positions and no
            attitude at all, ``gnss/fix`` alone.
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
    reports, timed = [report], list[_Timed]()
    fixes = list(_fix_messages(factory, ins_lines, report, by_instrument))
    if not fixes or any(report.used[kind] for kind in ATTITUDE_KINDS):
        samples = _attitudes(ins_lines, report, by_instrument)
        if order.resample_hz is not None:
            samples = resampled(samples, order.resample_hz)
            if not samples:
                raise BadInput(f"no two attitudes within {LONGEST_GAP_S:g} s of each other to resample", file=order.ins)
        timed += _imu_messages(factory, "ins/imu", "ins", samples)
    else:
        report.remarks.append("no attitude in it: gnss/fix alone")
    timed += fixes
    for name, path in sorted(order.references.items()):
        lines, report = read_log(path)
        reports.append(report)
        timed += _imu_messages(factory, f"reference/{name}/imu", name, _attitudes(lines, report, by_instrument))
    if order.gyro is not None:
        lines, report = _read_with(order.gyro, "HDT")
        reports.append(report)
        timed += _gyro_messages(factory, f"reference/{GYRO_NAME}/imu", GYRO_NAME, lines)
    if order.weather is not None:
        lines, report = _read_with(order.weather, "MET")
        reports.append(report)
        timed += _weather_messages(factory, lines)
    _write(order, out_path, timed, reports)
    return reports


def _attitudes(lines: list[LogLine], report: LogReport, by_instrument: bool) -> list[LoggedAttitude]:
    found = attitudes(lines, report, by_instrument)
    if not found and report.rejected[WRONG_TIME]:
        example = next(text for text in report.examples if WRONG_TIME in text)
        raise BadInput(f"no usable attitude: {example}; --time receive stamps by the receive time", file=report.path)
    if not found:
        raise BadInput(f"no usable attitude: expected PSXN,23 after ZDA, or PASHR; {report.text()}", file=report.path)
    return found


def _read_with(path: Path, kind: str) -> tuple[list[LogLine], LogReport]:
    lines, report = read_log(path)
    if not report.used[kind]:
        raise BadInput(f"no {kind} in {report.lines} lines", file=path)
    return lines, report


def _write(order: ImportOrder, out_path: Path, timed: list[_Timed], reports: list[LogReport]) -> None:
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
            **({"put_right": dict(sorted(report.mended.items()))} if report.mended else {}),
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


def _imu_messages(
    factory: MessageFactory, topic: str, frame_id: str, attitudes: Sequence[LoggedAttitude]
) -> Iterator[_Timed]:
    """sensor_msgs/Imu, ENU <- FLU; covariances unknown, the rate "not given" where the log has none."""
    for attitude in attitudes:
        rate_flu, rate_covariance = np.zeros(3), _NOT_GIVEN
        if attitude.rate_d is not None:
            rate_flu, rate_covariance = flu_from_device_vector(attitude.rate_d), _UNKNOWN
        message = _imu(factory, attitude.stamp_ns, frame_id, attitude.rotation_nd, _UNKNOWN, rate_flu, rate_covariance)
        yield attitude.log_time_ns, topic, message


def _gyro_messages(factory: MessageFactory, topic: str, frame_id: str, lines: Iterable[LogLine]) -> Iterator[_Timed]:
    """A gyrocompass's HDT as sensor_msgs/Imu, level, with roll and pitch as good as unknown.

    HDT carries no time: the stamp is the receive time.
    """
    variances = [_UNKNOWN_ANGLE_VARIANCE, _UNKNOWN_ANGLE_VARIANCE, np.deg2rad(_GYRO_HEADING_SIGMA_DEG) ** 2]
    covariance = np.diag(variances).ravel()
    for line in lines:
        if line.kind == "HDT":
            rotation_nd = rotation_from_angles(*np.deg2rad([float(line.content.heading), 0.0, 0.0]))
            message = _imu(factory, line.receive_ns, frame_id, rotation_nd, covariance, np.zeros(3), _NOT_GIVEN)
            yield line.receive_ns, topic, message


def _fix_messages(
    factory: MessageFactory, lines: Iterable[LogLine], report: LogReport, by_instrument: bool
) -> Iterator[_Timed]:
    """GGA as sensor_msgs/NavSatFix; the altitude is NaN where the geoid's height is not in the sentence."""
    for line in lines:
        if line.kind != "GGA":
            continue
        gga, stamp_ns = line.content, line.receive_ns
        if by_instrument:
            told_ns = instrument_ns(time_of_day_ns(gga.timestamp, line.receive_ns), line, report)
            if told_ns is None:
                continue
            stamp_ns = told_ns
        quality = gga.gps_qual if isinstance(gga.gps_qual, int) else 0
        status = _FIX_STATUS.get(quality, _FIX)
        position = _numbers(gga.latitude, gga.longitude) if gga.lat and gga.lon and status != _NO_FIX else None
        dilution = _numbers(gga.horizontal_dil)
        heights = _numbers(gga.altitude, gga.geo_sep)
        sigma_m = _RANGE_SIGMA_M * dilution[0] if dilution else 0.0
        message = factory.make(
            "sensor_msgs/msg/NavSatFix",
            header=make_header(factory, stamp_ns, "gnss"),
            status=factory.make(
                "sensor_msgs/msg/NavSatStatus", status=status if position else _NO_FIX, service=_SERVICE_GPS
            ),
            latitude=position[0] if position else np.nan,
            longitude=position[1] if position else np.nan,
            altitude=sum(heights) if heights else np.nan,
            # The vertical is about twice as uncertain as the horizontal.
            position_covariance=np.diag([sigma_m**2, sigma_m**2, (2.0 * sigma_m) ** 2]).ravel(),
            position_covariance_type=_COVARIANCE_APPROXIMATED if dilution else _COVARIANCE_UNKNOWN,
        )
        yield line.receive_ns, "gnss/fix", message


def _weather_messages(factory: MessageFactory, lines: Iterable[LogLine]) -> Iterator[_Timed]:
    """MET as temperature (°C), humidity (0 to 1) and pressure (Pa); stamped by the receive time."""
    for line in lines:
        if line.kind == "MET":
            fields = {"header": make_header(factory, line.receive_ns, "met"), "variance": 0.0}
            for topic, kind, value in (
                ("temperature", "Temperature", {"temperature": line.content.temperature_c}),
                ("humidity", "RelativeHumidity", {"relative_humidity": line.content.humidity}),
                ("pressure", "FluidPressure", {"fluid_pressure": line.content.pressure_pa}),
            ):
                yield line.receive_ns, f"met/{topic}", factory.make(f"sensor_msgs/msg/{kind}", **fields, **value)


def _imu(
    factory: MessageFactory,
    stamp_ns: int,
    frame_id: str,
    rotation_nd: FloatArray,
    covariance_enu: FloatArray,
    rate_flu: FloatArray,
    rate_covariance: FloatArray,
) -> Any:
    x, y, z, w = (float(part) for part in quaternion_from_rotation(rotation_nd))
    forward, left, up = (float(part) for part in rate_flu)
    return factory.make(
        "sensor_msgs/msg/Imu",
        header=make_header(factory, stamp_ns, frame_id),
        orientation=factory.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        orientation_covariance=covariance_enu,
        angular_velocity=factory.make("geometry_msgs/msg/Vector3", x=forward, y=left, z=up),
        angular_velocity_covariance=rate_covariance,
        linear_acceleration=factory.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0),
        linear_acceleration_covariance=_NOT_GIVEN,
    )


def _numbers(*values: Any) -> list[float] | None:
    """The values as numbers; None where one is missing or is none."""
    try:
        return [float(value) for value in values]
    except (TypeError, ValueError):
        return None
