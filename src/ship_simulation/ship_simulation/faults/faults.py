"""What goes wrong on the way from the devices to the bag.

drop                 nothing arrives
delay                arrives later by ``delay_s``
duplicate            arrives again, the same bytes, 1 ms later
conflict             another message with the same stamp and the next one's values arrives 1 ms later
freeze               new stamps, the values of the first message of the time
nan                  NaN in the first value (of the first star, where there is one)
stamp_zero           stamp zero
frame                another frame_id
covariance_unknown   covariances all zero
covariance_negative  a negative variance
rate_in_degrees      angular rate in degrees per second
angles_in_degrees    encoder angles in degrees
stamp_late           stamps later by ``delay_s`` than the moment that they are of
hide                 the first light of the image is missing
swap                 the first two lights of the image bear each other's id
wrong_id             the first light of the image, or the rover of a baseline, has an id that nobody knows
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.stamps import ns_from_stamp, stamp_fields
from ship_geometry.time_scales import SECOND_NS
from ship_simulation.scenario.names import (
    BASELINE,
    COVARIANCES,
    ENCODER,
    IMAGE,
    IMU,
    INERTIAL,
    OBSERVATIONS,
    SHIP_ATTITUDE,
    STAR,
)
from ship_simulation.scenario.scenario import Fault

_REPETITION_AFTER_NS = 1_000_000

_OTHER = "_other"

_SECOND_VARIANCE = 4
"""Its place in a covariance of nine elements. In the place of the first a negative number means "not given" to ROS."""

_FIRST_VALUE = {
    IMU: "orientation.x",
    INERTIAL: "orientation.x",
    STAR: "azimuth",
    OBSERVATIONS: "stars.u",
    SHIP_ATTITUDE: "heading",
    ENCODER: "azimuth",
    IMAGE: "beacons.x",
    BASELINE: "enu.x",
    "sensor_msgs/msg/NavSatFix": "latitude",
    "sensor_msgs/msg/FluidPressure": "fluid_pressure",
    "sensor_msgs/msg/Temperature": "temperature",
    "sensor_msgs/msg/RelativeHumidity": "relative_humidity",
}


@dataclass(frozen=True)
class Deliveries:
    """The messages of one topic as they arrive, all of shape (k,).

    Attributes:
        stamp_index: the sample whose stamp a message bears.
        value_index: the sample whose values it bears.
        log_time_ns: when it arrives.
        spoilt_by: bit i set where the i-th fault of the topic spoils the message.
    """

    stamp_index: np.ndarray
    value_index: np.ndarray
    log_time_ns: np.ndarray
    spoilt_by: np.ndarray


def deliver(time_ns: np.ndarray, log_time_ns: np.ndarray, faults: list[Fault], start_ns: int) -> Deliveries:
    """The deliveries of samples under the faults of their topic, in order of arrival."""
    samples = np.arange(time_ns.size)
    stamp, value, log, spoilt = samples, samples, log_time_ns, np.zeros(time_ns.size, dtype=np.int64)
    for bit, fault in enumerate(faults):
        since_start_s = (time_ns[stamp] - start_ns) / SECOND_NS
        inside = (since_start_s >= fault.start_s) & (since_start_s < fault.end_s)
        if fault.kind == "drop":
            stamp, value, log, spoilt = stamp[~inside], value[~inside], log[~inside], spoilt[~inside]
        elif fault.kind == "delay":
            log = log + np.where(inside, round(fault.delay_s * SECOND_NS), 0)
        elif fault.kind in ("duplicate", "conflict"):
            ahead = 1 if fault.kind == "conflict" else 0
            stamp, spoilt = np.append(stamp, stamp[inside]), np.append(spoilt, spoilt[inside])
            value = np.append(value, (value[inside] + ahead) % time_ns.size)
            log = np.append(log, log[inside] + _REPETITION_AFTER_NS)
        elif fault.kind == "freeze":
            value = np.where(inside, value[inside].min(initial=time_ns.size), value)
        else:
            spoilt = spoilt | (inside.astype(np.int64) << bit)
    order = np.argsort(log, kind="stable")
    return Deliveries(stamp[order], value[order], log[order], spoilt[order])


def spoil(message: Any, type_name: str, faults: Iterable[Fault]) -> None:
    """Put faults into a message. Its arrays may be shared with others, so they are replaced, not changed."""
    for fault in faults:
        _SPOILERS[fault.kind](message, type_name, fault)


def _nan(message: Any, type_name: str, fault: Fault) -> None:
    *parents, name = _FIRST_VALUE[type_name].split(".")
    for parent in parents:
        message = getattr(message, parent)
    # Of an array the first element, where it has one.
    for holder in message[:1] if isinstance(message, list) else [message]:
        setattr(holder, name, float("nan"))


def _stamp_zero(message: Any, type_name: str, fault: Fault) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = 0, 0


def _stamp_late(message: Any, type_name: str, fault: Fault) -> None:
    late_ns = ns_from_stamp(message.header.stamp) + round(fault.delay_s * SECOND_NS)
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(late_ns)


def _frame(message: Any, type_name: str, fault: Fault) -> None:
    message.header.frame_id += _OTHER


def _rate_in_degrees(message: Any, type_name: str, fault: Fault) -> None:
    rate = message.angular_velocity
    rate.x, rate.y, rate.z = (float(np.rad2deg(value)) for value in (rate.x, rate.y, rate.z))


def _angles_in_degrees(message: Any, type_name: str, fault: Fault) -> None:
    message.azimuth, message.elevation = np.rad2deg([message.azimuth, message.elevation]).tolist()


def _covariance(message: Any, type_name: str, fault: Fault) -> None:
    for name in COVARIANCES[type_name]:
        spoilt = np.zeros(9)
        if fault.kind == "covariance_negative":
            spoilt[:] = getattr(message, name)
            spoilt[_SECOND_VARIANCE] = -abs(spoilt[_SECOND_VARIANCE])
        setattr(message, name, spoilt)


def _hide(message: Any, type_name: str, fault: Fault) -> None:
    message.beacons = message.beacons[1:]


def _swap(message: Any, type_name: str, fault: Fault) -> None:
    pair = message.beacons[:2]
    for light, name in zip(pair, [light.beacon_id for light in reversed(pair)], strict=True):
        light.beacon_id = name


def _wrong_id(message: Any, type_name: str, fault: Fault) -> None:
    if type_name == BASELINE:
        message.rover_id += _OTHER
    else:
        for light in message.beacons[:1]:
            light.beacon_id += _OTHER


_SPOILERS: dict[str, Callable[[Any, str, Fault], None]] = {
    "nan": _nan,
    "stamp_zero": _stamp_zero,
    "stamp_late": _stamp_late,
    "frame": _frame,
    "rate_in_degrees": _rate_in_degrees,
    "angles_in_degrees": _angles_in_degrees,
    "covariance_unknown": _covariance,
    "covariance_negative": _covariance,
    "hide": _hide,
    "swap": _swap,
    "wrong_id": _wrong_id,
}
