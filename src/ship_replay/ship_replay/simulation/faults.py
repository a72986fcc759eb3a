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
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_replay.simulation.noise import SECOND_NS
from ship_replay.simulation.scenario import Fault, Scenario

IMU = "sensor_msgs/msg/Imu"
STAR = "ship_msgs/msg/StarHorizonAttitude"
OBSERVATIONS = "ship_msgs/msg/StarObservationArray"
INERTIAL = "ship_msgs/msg/StarInertialAttitude"

_STAR_TYPES = {"horizon_attitude": STAR, "observations": OBSERVATIONS, "inertial_attitude": INERTIAL}

_REPETITION_AFTER_NS = 1_000_000

_FIRST_VALUE = {
    STAR: "azimuth",
    "sensor_msgs/msg/NavSatFix": "latitude",
    "sensor_msgs/msg/FluidPressure": "fluid_pressure",
    "sensor_msgs/msg/Temperature": "temperature",
    "sensor_msgs/msg/RelativeHumidity": "relative_humidity",
}
_COVARIANCES = {
    IMU: ("orientation_covariance",),
    STAR: ("covariance", "rotation_covariance", "noise_covariance"),
    INERTIAL: ("covariance",),
}


def simulated_topics(scenario: Scenario) -> dict[str, str]:
    """Topic → type of what the devices of a scenario send (the truth aside)."""
    return {
        "ins/imu": IMU,
        **{f"star/{key}/{star.output}": _STAR_TYPES[star.output] for key, star in scenario.star_sensors.items()},
        **{f"reference/{key}/imu": IMU for key in scenario.references},
        "gnss/fix": "sensor_msgs/msg/NavSatFix",
        "met/pressure": "sensor_msgs/msg/FluidPressure",
        "met/temperature": "sensor_msgs/msg/Temperature",
        "met/humidity": "sensor_msgs/msg/RelativeHumidity",
    }


def can_happen(kind: str, type_name: str) -> bool:
    """Whether a message type has the field that a fault spoils."""
    if kind.startswith("covariance"):
        return type_name in _COVARIANCES
    return kind != "rate_in_degrees" or type_name == IMU


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
        if fault.kind == "nan":
            _spoil_first_value(message, type_name)
        elif fault.kind == "stamp_zero":
            message.header.stamp.sec, message.header.stamp.nanosec = 0, 0
        elif fault.kind == "frame":
            message.header.frame_id += "_other"
        elif fault.kind == "rate_in_degrees":
            rate = message.angular_velocity
            rate.x, rate.y, rate.z = (float(np.rad2deg(value)) for value in (rate.x, rate.y, rate.z))
        else:
            for name in _COVARIANCES[type_name]:
                setattr(message, name, _spoilt_covariance(getattr(message, name), fault.kind))


def _spoil_first_value(message: Any, type_name: str) -> None:
    if type_name in (IMU, INERTIAL):
        message.orientation.x = float("nan")
    elif type_name == OBSERVATIONS:
        for star in message.stars[:1]:
            star.u = float("nan")
    else:
        setattr(message, _FIRST_VALUE[type_name], float("nan"))


def _spoilt_covariance(covariance: Any, kind: str) -> np.ndarray:
    spoilt = np.zeros(9)
    if kind == "covariance_negative":
        spoilt[:] = covariance
        # Not the first: there a negative number means "not given" to ROS.
        spoilt[4] = -abs(spoilt[4])
    return spoilt
