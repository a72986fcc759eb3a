"""Conversion of an instrument's lines, from a log or a live source, to messages.

Attitude systems and gyrocompasses give sensor_msgs/Imu, receivers NavSatFix, weather stations temperature, humidity and
pressure.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.nmea.instrument_lines import InstrumentLine, LineReport, instrument_ns, time_of_day_ns
from ship_bags.nmea.nmea_attitude import AttitudeReader, LoggedAttitude
from ship_bags.nmea.sentences import AUTONOMOUS, MetReading, number
from ship_bags.stamps import NS_PER_S, make_header
from ship_geometry.frames import (
    angles_from_rotation,
    flu_from_device_vector,
    quaternion_from_rotation,
    rotation_from_angles,
)
from ship_geometry.rotations import FloatArray

INS, REFERENCE, GYRO, GNSS, WEATHER = "ins", "reference", "gyro", "gnss", "weather"
"""Kinds of output of an instrument's lines."""

INSTRUMENT_TIME = "instrument"
FIX_TOPIC = "gnss/fix"
MET_TOPICS = {
    "met/temperature": "sensor_msgs/msg/Temperature",
    "met/humidity": "sensor_msgs/msg/RelativeHumidity",
    "met/pressure": "sensor_msgs/msg/FluidPressure",
}
IMU_TYPE, FIX_TYPE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"

HEADING_KINDS = ("HDT", "THS")
AIR_KINDS = ("MET", "MDA", "XDR")

TimedMessage = tuple[int, str, Any]
"""(log time in ns, topic, message)."""

_THS_PRECEDENCE_NS = 3 * NS_PER_S
"""Time after a THS for which HDT sentences of the same instrument are ignored, ns."""

_GYRO_HEADING_SIGMA_DEG = 0.1
"""Standard deviation assumed for a gyrocompass, which states no accuracy, degrees."""

_UNKNOWN_ANGLE_VARIANCE = 1.0
"""Variance of roll and pitch if only a heading is measured, rad²: practically unknown."""

_UNKNOWN_RATE_VARIANCE = 1.0
"""Variance of the roll and pitch rates if only the rate of turn is given, rad²/s²."""
_TURN_SIGMA_DEG_PER_MIN, _S_PER_MIN = 0.5, 60.0
"""Standard deviation assumed for ROT, °/min: the error that IMO resolution A.526(13) allows at small rates of turn."""

_RANGE_SIGMA_M = 3.0
"""Position error per unit of dilution of precision for single-point GNSS, m."""

_UNKNOWN = np.zeros(9)
_NOT_GIVEN = np.array([-1.0, *np.zeros(8)])

_NO_FIX, _FIX, _AUGMENTED, _GROUND_AUGMENTED = -1, 0, 1, 2
_FIX_STATUS = {1: _FIX, 2: _AUGMENTED, 3: _FIX, 4: _GROUND_AUGMENTED, 5: _GROUND_AUGMENTED}
"""Quality in GGA → NavSatStatus: single, differential, PPS, RTK fixed, RTK float. Any other quality is not a fix: 6 is
dead reckoning, 7 manual input, 8 simulated."""
_MAKERS_SBAS_QUALITY = 9
"""Quality that some makers use for a fix with SBAS; the standard does not define it."""
_SERVICE_GPS = 1
_COVARIANCE_UNKNOWN, _COVARIANCE_APPROXIMATED = 0, 1

_TRANSDUCERS = {
    ("C", "C"): ("temperature_c", 1.0),
    ("H", "P"): ("humidity", 0.01),
    ("P", "B"): ("pressure_pa", 1e5),
    ("P", "P"): ("pressure_pa", 1.0),
    ("P", "H"): ("pressure_pa", 100.0),
}
"""Type and unit of an XDR transducer → field of a reading, and factor from the unit. The units °C, per cent, bar and
pascal are of the standard; pressure unit H is the hectopascal of Vaisala."""

_MAX_TRANSDUCERS, _MAX_NAMED = 100, 5


@dataclass(frozen=True)
class InstrumentRole:
    """Use of an instrument's lines.

    Attributes:
        becomes: kind of output: :data:`INS`, :data:`REFERENCE`, :data:`GYRO`, :data:`GNSS` or :data:`WEATHER`.
        by_instrument: True to stamp attitudes and fixes by the instrument's time, False by the receive time.
        transducers: names of the XDR transducers that are used; empty to use the only transducer of each kind.
        has_fix: True if the positions of an INS are used, too.
        quality_9_is_fix: True if a GGA of quality 9 is a fix with SBAS, False if it is not a fix.
    """

    becomes: str
    by_instrument: bool = True
    transducers: frozenset[str] = frozenset()
    has_fix: bool = True
    quality_9_is_fix: bool = False

    def topics(self, name: str) -> dict[str, str]:
        """Return topic → type of all outputs of an instrument of that name, the main topic first."""
        if self.becomes == WEATHER:
            return MET_TOPICS
        fix = {FIX_TOPIC: FIX_TYPE}
        if self.becomes == GNSS:
            return fix
        return {imu_topic(self.becomes, name): IMU_TYPE, **(fix if self.becomes == INS and self.has_fix else {})}


class Instrument:
    """Conversion of the lines of one instrument to messages.

    Args:
        factory: makes the messages.
        role: use of the lines.
        name: name of the instrument; part of the topic of a reference or gyrocompass.
        report: counts of unusable lines.
    """

    def __init__(self, factory: MessageFactory, role: InstrumentRole, name: str, report: LineReport) -> None:
        self._factory = factory
        self._role = role
        self._name = name
        self._report = report
        self._attitudes = AttitudeReader(role.by_instrument, report)
        self._ths_ns: int | None = None
        self._turn: InstrumentLine | None = None
        self._transducers: dict[str, set[str]] = {}

    def take(self, line: InstrumentLine) -> Iterator[TimedMessage]:
        """Yield the messages of the next line."""
        becomes = self._role.becomes
        if becomes in (INS, REFERENCE) and (attitude := self._attitudes.take(line)) is not None:
            yield imu_message(self._factory, becomes, self._name, attitude)
        if becomes == GNSS or (becomes == INS and self._role.has_fix):
            yield from self._fix(line)
        if becomes == GYRO:
            yield from self._heading(line)
        if becomes == WEATHER:
            yield from self._weather(line)

    def _heading(self, line: InstrumentLine) -> Iterator[TimedMessage]:
        """Yield a gyrocompass's heading as a level sensor_msgs/Imu with practically unknown roll and pitch.

        HDT and THS have no time, so the stamp is the receive time. If an instrument sends both, THS takes precedence
        until a timeout of some seconds, because only THS states that a heading is invalid.
        """
        if line.kind == "ROT":
            self._turn = line
            return
        if line.kind == "THS":
            self._ths_ns = line.receive_ns
            if line.content.mode != AUTONOMOUS:
                self._report.reject(f"THS not in mode {AUTONOMOUS}", line.number, str(line.content))
                return
        elif line.kind != "HDT" or (self._ths_ns is not None and line.receive_ns - self._ths_ns <= _THS_PRECEDENCE_NS):
            return
        variances = [_UNKNOWN_ANGLE_VARIANCE, _UNKNOWN_ANGLE_VARIANCE, np.deg2rad(_GYRO_HEADING_SIGMA_DEG) ** 2]
        rotation_nd = rotation_from_angles(*np.deg2rad([float(line.content.heading), 0.0, 0.0]))
        covariance = np.diag(variances).ravel()
        rate_flu, rate_covariance = self._turn_rate(line.receive_ns)
        message = _imu(
            self._factory, line.receive_ns, self._name, rotation_nd, covariance, rate_flu, rate_covariance
        )
        yield line.receive_ns, imu_topic(GYRO, self._name), message

    def _turn_rate(self, receive_ns: int) -> tuple[FloatArray, FloatArray]:
        """Return angular velocity (forward, left, up) and covariance from a ROT of the last second.

        Without such a ROT the angular velocity is zero, and the covariance means "not given".
        """
        if self._turn is None or not 0 <= receive_ns - self._turn.receive_ns <= NS_PER_S:
            return np.zeros(3), _NOT_GIVEN
        rate = np.deg2rad(self._turn.content.rate_of_turn) / _S_PER_MIN
        sigma = np.deg2rad(_TURN_SIGMA_DEG_PER_MIN) / _S_PER_MIN
        variances = [_UNKNOWN_RATE_VARIANCE, _UNKNOWN_RATE_VARIANCE, sigma**2]
        return np.array([0.0, 0.0, -rate]), np.diag(variances).ravel()

    def _fix(self, line: InstrumentLine) -> Iterator[TimedMessage]:
        """Yield GGA as sensor_msgs/NavSatFix; the altitude is NaN if the sentence lacks altitude or geoid height."""
        if line.kind != "GGA":
            return
        gga, stamp_ns = line.content, line.receive_ns
        if self._role.by_instrument:
            instrument_time_ns = instrument_ns(time_of_day_ns(gga.timestamp, line.receive_ns), line, self._report)
            if instrument_time_ns is None:
                return
            stamp_ns = instrument_time_ns
        status = _FIX_STATUS.get(gga.gps_qual, _NO_FIX)
        if gga.gps_qual == _MAKERS_SBAS_QUALITY and self._role.quality_9_is_fix:
            status = _AUGMENTED
        position = _numbers(gga.latitude, gga.longitude) if gga.lat and status != _NO_FIX else None
        dilution = _numbers(gga.horizontal_dil)
        heights = _numbers(gga.altitude, gga.geo_sep)
        sigma_m = _RANGE_SIGMA_M * dilution[0] if dilution else 0.0
        message = self._factory.make(
            FIX_TYPE,
            header=make_header(self._factory, stamp_ns, "gnss"),
            status=self._factory.make(
                "sensor_msgs/msg/NavSatStatus", status=status if position else _NO_FIX, service=_SERVICE_GPS
            ),
            latitude=position[0] if position else np.nan,
            longitude=position[1] if position else np.nan,
            altitude=sum(heights) if heights else np.nan,
            # The vertical is about twice as uncertain as the horizontal.
            position_covariance=np.diag([sigma_m**2, sigma_m**2, (2.0 * sigma_m) ** 2]).ravel(),
            position_covariance_type=_COVARIANCE_APPROXIMATED if dilution else _COVARIANCE_UNKNOWN,
        )
        yield line.receive_ns, FIX_TOPIC, message

    def _weather(self, line: InstrumentLine) -> Iterator[TimedMessage]:
        """Yield the available temperature (°C), humidity (0 to 1) and pressure (Pa), stamped by the receive time."""
        if line.kind not in AIR_KINDS:
            return
        reading = self._transducer_reading(line) if line.kind == "XDR" else line.content
        fields = {"header": make_header(self._factory, line.receive_ns, "met"), "variance": 0.0}
        for (topic, type_name), (name, value) in zip(
            MET_TOPICS.items(),
            (
                ("temperature", reading.temperature_c),
                ("relative_humidity", reading.humidity),
                ("fluid_pressure", reading.pressure_pa),
            ),
            strict=True,
        ):
            if value is not None:
                yield line.receive_ns, topic, self._factory.make(type_name, **fields, **{name: value})

    def _transducer_reading(self, line: InstrumentLine) -> MetReading:
        """Return the air data of an XDR: of the named transducers, or of the only transducer of each kind."""
        readings: dict[str, list[float]] = {}
        for index in range(line.content.num_transducers):
            transducer = line.content.get_transducer(index)
            value = number(transducer.value)
            field, factor = _TRANSDUCERS.get((transducer.type, transducer.units), ("", 0.0))
            if not field or value is None or (self._role.transducers and transducer.id not in self._role.transducers):
                continue
            readings.setdefault(field, []).append(value * factor)
            names = self._transducers.setdefault(field, set())
            if len(names) < _MAX_TRANSDUCERS:
                names.add(transducer.id)
        for field in [field for field, values in readings.items() if len(values) + len(self._transducers[field]) > 2]:
            several = ", ".join(sorted(self._transducers[field])[:_MAX_NAMED])
            text = f"{field.partition('_')[0]} of {several}: name the transducer of the air in transducers"
            self._report.reject("several transducers", line.number, text)
            del readings[field]
        return MetReading(**{field: values[0] for field, values in readings.items()})


def imu_topic(becomes: str, name: str) -> str:
    """Return the topic of an attitude system."""
    return "ins/imu" if becomes == INS else f"reference/{name}/imu"


def imu_message(factory: MessageFactory, becomes: str, name: str, attitude: LoggedAttitude) -> TimedMessage:
    """Return a sensor_msgs/Imu (orientation: ENU from FLU) with its log time and topic.

    The covariance of the orientation is unknown unless an INS states it. The rate is "not given" unless the attitude is
    resampled; the covariance of a resampled rate is unknown.
    """
    rate_flu, rate_covariance = np.zeros(3), _NOT_GIVEN
    if attitude.rate_d is not None:
        rate_flu, rate_covariance = flu_from_device_vector(attitude.rate_d), _UNKNOWN
    frame_id = INS if becomes == INS else name
    # The message of a reference has no covariance, so that its configured sigma is used as its noise.
    covariance = _UNKNOWN
    if becomes == INS and attitude.sigmas is not None:
        covariance = _covariance_enu(attitude.rotation_nd, attitude.sigmas)
    message = _imu(factory, attitude.stamp_ns, frame_id, attitude.rotation_nd, covariance, rate_flu, rate_covariance)
    return attitude.log_time_ns, imu_topic(becomes, name), message


def _covariance_enu(rotation_nd: FloatArray, sigmas: FloatArray) -> FloatArray:
    """Return the covariance of a rotation about east, north, up from independent errors of roll, pitch and heading."""
    heading, _, _ = angles_from_rotation(rotation_nd)
    sine, cosine = np.sin(heading), np.cos(heading)
    enu_from_level = np.array([[sine, -cosine, 0.0], [cosine, sine, 0.0], [0.0, 0.0, 1.0]])
    covariance: FloatArray = enu_from_level @ np.diag(sigmas**2) @ enu_from_level.T
    return covariance.ravel()


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
        IMU_TYPE,
        header=make_header(factory, stamp_ns, frame_id),
        orientation=factory.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        orientation_covariance=covariance_enu,
        angular_velocity=factory.make("geometry_msgs/msg/Vector3", x=forward, y=left, z=up),
        angular_velocity_covariance=rate_covariance,
        linear_acceleration=factory.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0),
        linear_acceleration_covariance=_NOT_GIVEN,
    )


def _numbers(*values: Any) -> list[float] | None:
    """Return the values as numbers; None if a value is missing or invalid."""
    try:
        return [float(value) for value in values]
    except (TypeError, ValueError):
        return None
