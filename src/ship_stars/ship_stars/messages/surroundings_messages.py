"""Readers of position and air messages for the sky model of all nodes: checks and conversion.

The readers use only attributes of messages, so any message class can be used. For a message that cannot be used the
readers raise :class:`ship_node.messages.field_checks.MessageRejected`.
"""

import functools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.frames import horizon_covariance
from ship_node.adapters.adapter import Feed
from ship_node.health.duplicate_publishers import POSITION
from ship_node.messages.field_checks import MessageRejected, ReadMessage, check_finite, covariance_3x3, stamp_ns
from ship_node.messages.inputs_outputs import InputTopic
from ship_stars.attitude_samples import AirReading, PositionFix, SkyInput
from ship_stars.sky.config import SkyConfig

_NO_FIX = -1
_COVARIANCE_UNKNOWN = 0
_MAX_POSITION_SIGMA_M = 1e5
_MAX_HEIGHT_M = 20_000.0

SURROUNDINGS = {
    "gnss/fix": "sensor_msgs/msg/NavSatFix",
    "met/pressure": "sensor_msgs/msg/FluidPressure",
    "met/temperature": "sensor_msgs/msg/Temperature",
    "met/humidity": "sensor_msgs/msg/RelativeHumidity",
}
"""Topics of position and air data, and their types; stars cannot be used without a position."""


def position_fix(message: Any, config: SkyConfig, receive_ns: int) -> ReadMessage[SkyInput]:
    """Read ``gnss/fix``: position of the ship.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    if message.status.status <= _NO_FIX:
        raise MessageRejected(Reason.NO_FIX, "the receiver reports no fix (STATUS_NO_FIX)")
    check_finite("latitude, longitude", message.latitude, message.longitude)
    if abs(message.latitude) > 90.0 or abs(message.longitude) > 360.0:
        text = f"latitude {message.latitude:.9g}, longitude {message.longitude:.9g}: expected degrees, ±90 and ±180"
        raise MessageRejected(Reason.UNITS, text)
    # A receiver without height sends NaN. At sea the height is near zero and has little effect on stars.
    height_m = 0.0 if np.isnan(message.altitude) else message.altitude
    if not abs(height_m) < _MAX_HEIGHT_M:
        raise MessageRejected(Reason.UNITS, f"altitude {height_m:.6g}: expected metres above the ellipsoid")
    covariance_enu = None
    if message.position_covariance_type != _COVARIANCE_UNKNOWN:
        covariance_enu = covariance_3x3(message.position_covariance, "position_covariance")
    if covariance_enu is not None and covariance_enu.diagonal().max() > _MAX_POSITION_SIGMA_M**2:
        largest_m = np.sqrt(covariance_enu.diagonal().max())
        raise MessageRejected(
            Reason.BAD_COVARIANCE, f"position_covariance: sigma {largest_m:.3g} m is too large for a fix"
        )
    if covariance_enu is not None and not covariance_enu.diagonal()[:2].all():
        text = "position_covariance: a horizontal variance is zero, although others are not"
        raise MessageRejected(Reason.BAD_COVARIANCE, text)
    covariance_m2 = np.eye(3) * config.fix_sigma_m**2 if covariance_enu is None else horizon_covariance(covariance_enu)
    position = GeodeticPosition(np.deg2rad(message.latitude), np.deg2rad(message.longitude), height_m)
    return ReadMessage(PositionFix(time_ns, position, covariance_m2), covariance_enu is not None)


def pressure(message: Any, receive_ns: int) -> ReadMessage[SkyInput]:
    """Read ``met/pressure``: air pressure, converted from Pa to hPa.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    pascal = float(message.fluid_pressure)
    hint = ": hPa, not Pa?" if 800.0 <= pascal <= 1100.0 else ""
    meaning = f"80000 to 110000 Pa at a ship{hint}"
    return _reading("pressure", message, pascal, (80_000.0, 110_000.0), 0.01, meaning, receive_ns)


def temperature(message: Any, receive_ns: int) -> ReadMessage[SkyInput]:
    """Read ``met/temperature``: air temperature, °C.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    celsius = float(message.temperature)
    hint = ": kelvin, not °C?" if 213.0 <= celsius <= 333.0 else ""
    return _reading("temperature", message, celsius, (-60.0, 60.0), 1.0, f"-60 to 60 °C at a ship{hint}", receive_ns)


def humidity(message: Any, receive_ns: int) -> ReadMessage[SkyInput]:
    """Read ``met/humidity``: relative humidity, 0 to 1.

    Raises:
        MessageRejected: the message cannot be used; the exception contains the reason.
    """
    fraction = float(message.relative_humidity)
    hint = ": percent?" if 1.0 < fraction <= 100.0 else ""
    return _reading("humidity", message, fraction, (0.0, 1.0), 1.0, f"0 to 1{hint}", receive_ns)


def _reading(
    quantity: str,
    message: Any,
    value: float,
    allowed: tuple[float, float],
    scale: float,
    expected: str,
    receive_ns: int,
) -> ReadMessage[SkyInput]:
    time_ns = stamp_ns(message.header, receive_ns)
    check_finite(quantity, value)
    check_finite(f"variance of {quantity}", message.variance)
    if not allowed[0] <= value <= allowed[1]:
        raise MessageRejected(Reason.UNITS, f"{quantity} {value:.6g}: expected {expected}")
    if message.variance < 0.0:
        raise MessageRejected(Reason.BAD_COVARIANCE, f"variance of {quantity} is negative: {message.variance:.6g}")
    if message.variance > (allowed[1] - allowed[0]) ** 2:
        raise MessageRejected(Reason.BAD_COVARIANCE, f"variance of {quantity} {message.variance:.6g}: too large")
    sigma = None if message.variance == 0.0 else scale * float(np.sqrt(message.variance))
    # The humidity error is not used anywhere, so a message without variance needs no configured value.
    known = sigma is not None or quantity == "humidity"
    return ReadMessage(AirReading(quantity, time_ns, scale * value, sigma), known)


def surroundings_reader(topic: str, config: SkyConfig) -> Callable[..., ReadMessage[SkyInput]]:
    """Return the reader of a topic of :data:`SURROUNDINGS`; its arguments are the message and ``receive_ns=``."""
    if topic == "gnss/fix":
        return functools.partial(position_fix, config=config)
    return {"met/pressure": pressure, "met/temperature": temperature, "met/humidity": humidity}[topic]


def surroundings_feeds(
    config: SkyConfig,
    process: Callable[[Any, int], Any],
    position_required: bool = True,
    topics: Iterable[str] = tuple(SURROUNDINGS),
) -> Iterator[Feed]:
    """Yield the rows of an adapter's table for position and air data.

    Args:
        config: parameters of the sky model.
        process: method of the core that processes these data.
        position_required: True if the node needs a position.
        topics: the topics of :data:`SURROUNDINGS` that the node needs.
    """
    for topic in topics:
        is_position = topic == PositionFix.source
        needed = InputTopic(
            topic, SURROUNDINGS[topic], position_required and is_position, depth=100, is_valid_until_next=True
        )
        quantity = POSITION if is_position else None
        yield Feed(needed, topic, surroundings_reader(topic, config), process, stream_quantity=quantity)
