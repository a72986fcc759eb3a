"""From messages to the ship's place and the air around it. Two adapters share it.

Reads attributes only, so any message class will do; what cannot be used raises
:class:`ship_node.message_checks.Refused`.
"""

from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.star_config import SkyConfig
from ship_geometry.geodetic import GeodeticPosition
from ship_geometry.ros_axes import horizon_covariance
from ship_geometry.rotations import FloatArray
from ship_node.message_checks import Refused, covariance_3x3, finite_numbers, stamp_ns

_NO_FIX = -1
_COVARIANCE_UNKNOWN = 0
_LARGEST_POSITION_SIGMA_M = 1e6
_LARGEST_HEIGHT_M = 20_000.0


class PositionFix(NamedTuple):
    """A fix: its stamp, the antenna, its covariance in (North, Up, East), and whether the message gave that."""

    time_ns: int
    position: GeodeticPosition
    covariance_m2: FloatArray
    covariance_known: bool


class Reading(NamedTuple):
    """A stamp, a value and its standard deviation; None where the message gives none."""

    time_ns: int
    value: float
    sigma: float | None


def position_fix(message: Any, config: SkyConfig, receive_ns: int) -> PositionFix:
    """``gnss/fix`` → the ship's place.

    Raises:
        Refused: with the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    if message.status.status <= _NO_FIX:
        raise Refused("no_fix", "the receiver itself says that it has no fix (STATUS_NO_FIX)")
    finite_numbers("latitude, longitude", message.latitude, message.longitude)
    if abs(message.latitude) > 90.0 or abs(message.longitude) > 360.0:
        text = f"latitude {message.latitude:.9g}, longitude {message.longitude:.9g}: expected degrees, ±90 and ±180"
        raise Refused("units", text)
    # A receiver without height says NaN; at sea it is near zero, and stars hardly know it.
    height_m = 0.0 if np.isnan(message.altitude) else message.altitude
    if not abs(height_m) < _LARGEST_HEIGHT_M:
        raise Refused("units", f"altitude {height_m:.6g}: expected metres above the ellipsoid")
    covariance_enu = None
    if message.position_covariance_type != _COVARIANCE_UNKNOWN:
        covariance_enu = covariance_3x3(message.position_covariance, "position_covariance")
    if covariance_enu is not None and covariance_enu.diagonal().max() > _LARGEST_POSITION_SIGMA_M**2:
        largest_m = np.sqrt(covariance_enu.diagonal().max())
        raise Refused("bad_covariance", f"position_covariance: a sigma of {largest_m:.3g} m is no fix")
    covariance_m2 = np.eye(3) * config.fix_sigma_m**2 if covariance_enu is None else horizon_covariance(covariance_enu)
    position = GeodeticPosition(np.deg2rad(message.latitude), np.deg2rad(message.longitude), height_m)
    return PositionFix(time_ns, position, covariance_m2, covariance_enu is not None)


def pressure_hpa(message: Any, receive_ns: int) -> Reading:
    """``met/pressure``, in Pa → hPa.

    Raises:
        Refused: with the reason.
    """
    pascal = float(message.fluid_pressure)
    hint = ": hPa, not Pa?" if 800.0 <= pascal <= 1100.0 else ""
    reading = _reading(message, "fluid_pressure", pascal, (80_000.0, 110_000.0), f"Pa at a ship{hint}", receive_ns)
    return Reading(reading.time_ns, 0.01 * pascal, None if reading.sigma is None else 0.01 * reading.sigma)


def temperature_c(message: Any, receive_ns: int) -> Reading:
    """``met/temperature``, in degrees Celsius.

    Raises:
        Refused: with the reason.
    """
    celsius = float(message.temperature)
    hint = ": kelvin, not °C?" if 213.0 <= celsius <= 333.0 else ""
    return _reading(message, "temperature", celsius, (-60.0, 60.0), f"°C at a ship{hint}", receive_ns)


def humidity(message: Any, receive_ns: int) -> Reading:
    """``met/humidity``, 0 to 1.

    Raises:
        Refused: with the reason.
    """
    fraction = float(message.relative_humidity)
    hint = ": percent?" if 1.0 < fraction <= 100.0 else ""
    return _reading(message, "relative_humidity", fraction, (0.0, 1.0), f"as a fraction{hint}", receive_ns)


def _reading(
    message: Any, what: str, value: float, allowed: tuple[float, float], meaning: str, receive_ns: int
) -> Reading:
    time_ns = stamp_ns(message.header, receive_ns)
    finite_numbers(what, value)
    finite_numbers("variance", message.variance)
    if not allowed[0] <= value <= allowed[1]:
        raise Refused("units", f"{what} {value:.6g}: expected {allowed[0]:g} to {allowed[1]:g} {meaning}")
    if message.variance < 0.0:
        raise Refused("bad_covariance", f"variance of {what} is negative: {message.variance:.6g}")
    return Reading(time_ns, value, None if message.variance == 0.0 else float(np.sqrt(message.variance)))
