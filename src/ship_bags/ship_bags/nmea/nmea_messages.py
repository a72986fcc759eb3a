"""Lines of ship logs as ROS messages."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.nmea.nmea_attitude import LoggedAttitude
from ship_bags.nmea.nmea_log import LogLine, time_of_day_ns
from ship_bags.stamps import make_header
from ship_geometry.frames import rotation_from_angles
from ship_geometry.ros_axes import flu_from_device_vector, quaternion_from_rotation

Timed = tuple[int, str, Any]
"""(log time in ns, topic, message)."""

GYRO_HEADING_SIGMA_DEG = 0.1
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


def imu_messages(
    factory: MessageFactory, topic: str, frame_id: str, attitudes: Sequence[LoggedAttitude]
) -> Iterator[Timed]:
    """sensor_msgs/Imu, ENU <- FLU; covariances unknown, the rate "not given" where the log has none."""
    for attitude in attitudes:
        given = attitude.rate_d is not None
        rate_flu = flu_from_device_vector(attitude.rate_d) if given else np.zeros(3)
        rate_covariance = _UNKNOWN if given else _NOT_GIVEN
        message = _imu(factory, attitude.stamp_ns, frame_id, attitude.rotation_nd, _UNKNOWN, rate_flu, rate_covariance)
        yield attitude.log_time_ns, topic, message


def gyro_messages(factory: MessageFactory, topic: str, frame_id: str, lines: Iterable[LogLine]) -> Iterator[Timed]:
    """A gyrocompass's HDT as sensor_msgs/Imu, level, with roll and pitch as good as unknown.

    HDT carries no time: the stamp is the receive time.
    """
    variances = [_UNKNOWN_ANGLE_VARIANCE, _UNKNOWN_ANGLE_VARIANCE, np.deg2rad(GYRO_HEADING_SIGMA_DEG) ** 2]
    covariance = np.diag(variances).ravel()
    for line in lines:
        if line.kind == "HDT":
            rotation_nd = rotation_from_angles(np.deg2rad(float(line.content.heading)), 0.0, 0.0)
            message = _imu(factory, line.receive_ns, frame_id, rotation_nd, covariance, np.zeros(3), _NOT_GIVEN)
            yield line.receive_ns, topic, message


def fix_messages(factory: MessageFactory, lines: Iterable[LogLine], by_instrument: bool) -> Iterator[Timed]:
    """GGA as sensor_msgs/NavSatFix; the altitude is NaN where the geoid's height is not in the sentence."""
    for line in lines:
        if line.kind != "GGA":
            continue
        gga = line.content
        quality = gga.gps_qual if isinstance(gga.gps_qual, int) else 0
        status = _FIX_STATUS.get(quality, _FIX)
        position = _numbers(gga.latitude, gga.longitude) if gga.lat and gga.lon and status != _NO_FIX else None
        dilution = _numbers(gga.horizontal_dil)
        heights = _numbers(gga.altitude, gga.geo_sep)
        sigma_m = _RANGE_SIGMA_M * dilution[0] if dilution else 0.0
        stamp_ns = time_of_day_ns(gga.timestamp, line.receive_ns) if by_instrument else line.receive_ns
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


def weather_messages(factory: MessageFactory, lines: Iterable[LogLine]) -> Iterator[Timed]:
    """MET as temperature (°C), humidity (0 to 1) and pressure (Pa); stamped by the receive time."""
    for line in lines:
        if line.kind == "MET":
            header = make_header(factory, line.receive_ns, "met")
            weather = line.content
            yield (
                line.receive_ns,
                "met/temperature",
                factory.make(
                    "sensor_msgs/msg/Temperature", header=header, temperature=weather.temperature_c, variance=0.0
                ),
            )
            yield (
                line.receive_ns,
                "met/humidity",
                factory.make(
                    "sensor_msgs/msg/RelativeHumidity",
                    header=header,
                    relative_humidity=weather.humidity,
                    variance=0.0,
                ),
            )
            yield (
                line.receive_ns,
                "met/pressure",
                factory.make(
                    "sensor_msgs/msg/FluidPressure", header=header, fluid_pressure=weather.pressure_pa, variance=0.0
                ),
            )


def _imu(
    factory: MessageFactory,
    stamp_ns: int,
    frame_id: str,
    rotation_nd: np.ndarray,
    covariance_enu: np.ndarray,
    rate_flu: np.ndarray,
    rate_covariance: np.ndarray,
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
