"""Effects of faults on the values of one message.

The arrays of a message may be shared with other messages, and are therefore replaced, not changed.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.stamps import END_OF_TIME_NS, ns_from_stamp, stamp_fields
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, wrap_two_pi
from ship_simulation.faults.device_geometry import SuiteOptics, convert_axes, turn_in_device, turn_in_horizon
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import (
    BASELINE,
    COVARIANCES,
    ENCODER,
    FIRST_VALUE,
    FIX,
    HUMIDITY,
    IMAGE,
    IMU,
    PRESSURE,
    SHIP_ATTITUDE,
    STAR,
    TARGET,
    TEMPERATURE,
)
from ship_simulation.scenario.scenario_file import field_steps
from ship_stars.sky.catalogue import hipparcos

_OTHER = "_other"

_FIXED = 4
"""Value of RtkBaseline.FIXED."""

_MINUTE_S = 60.0
_EARTH_RADIUS_M = 6_371_000.0
_BRIGHT = 5.5
"""Magnitude limit (Hp) of the catalogue stars whose magnitudes and identities are given to false stars."""
_HALF_FIELD = math.tan(math.radians(3.0))
"""Largest offset of false lights from the axis along each coordinate, 3°, in focal lengths."""

_RATES = ("angular_velocity.x", "angular_velocity.y", "angular_velocity.z")
_DEGREES = 180.0 / math.pi
_UNITS: dict[str, tuple[tuple[str, ...], float, float]] = {
    IMU: (_RATES, _DEGREES, 0.0),
    SHIP_ATTITUDE: (("heading", "pitch", "roll", *_RATES), _DEGREES, 0.0),
    STAR: (("azimuth", "elevation", "roll"), _DEGREES, 0.0),
    ENCODER: (("azimuth", "elevation"), _DEGREES, 0.0),
    BASELINE: (("enu.x", "enu.y", "enu.z"), 1000.0, 0.0),
    IMAGE: (("beacons[*].x", "beacons[*].z"), 1000.0, 0.0),
    TARGET: (("x", "z"), 1000.0, 0.0),
    FIX: (("latitude", "longitude"), 1.0 / _DEGREES, 0.0),
    PRESSURE: (("fluid_pressure",), 0.01, 0.0),
    TEMPERATURE: (("temperature",), 1.0, 273.15),
    HUMIDITY: (("relative_humidity",), 100.0, 0.0),
}
"""Message type → fields, and the factor and the offset that convert them to the wrong unit."""


@dataclass(frozen=True)
class ValueFault:
    """A fault that changes the values of messages of one type.

    Attributes:
        fault: the fault.
        type_name: type of the messages.
        optics: cameras of the devices.
        rng: random generator of the fault.
    """

    fault: Fault
    type_name: str
    optics: SuiteOptics
    rng: np.random.Generator

    def apply(self, message: Any, since_s: float) -> None:
        """Apply the fault to a message stamped ``since_s`` after the start of the fault."""
        _VALUE_FAULTS[self.fault.kind](self, message, since_s)


def _change_field(value_fault: ValueFault, message: Any, since_s: float) -> None:
    fault = value_fault.fault
    path = fault.field or FIRST_VALUE[value_fault.type_name]
    fixed = {"nan": math.nan, "infinite": math.inf, "corrupt": fault.value}
    if fault.kind in fixed:
        _change(message, path, lambda value: fixed[fault.kind])
    else:
        _change(message, path, lambda value: value + fault.value)


def _change(message: Any, path: str, new: Callable[[float], float]) -> None:
    """Change the numbers at a path; an index beyond the end of an array changes nothing."""
    holders = [message]
    *parents, (name, index) = field_steps(path)
    for parent, chosen in parents:
        holders = [part for holder in holders for part in _select_items(getattr(holder, parent), chosen or "0")]
    for holder in holders:
        old = getattr(holder, name)
        if not index:
            setattr(holder, name, type(old)(new(old)))
            continue
        values = np.array(old)
        places = range(len(values)) if index == "*" else range(len(values))[int(index) : int(index) + 1]
        for place in places:
            values[place] = new(values[place])
        setattr(holder, name, values)


def _select_items(value: Any, index: str) -> list[Any]:
    """Return the messages of a list that an index selects; a single message is returned as a list of one."""
    if not isinstance(value, list):
        return [value]
    return value if index == "*" else value[int(index) : int(index) + 1]


def _set_stamp_zero(value_fault: ValueFault, message: Any, since_s: float) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = 0, 0


def _shift_stamp(value_fault: ValueFault, message: Any, since_s: float) -> None:
    off_s = value_fault.fault.delay_s + value_fault.fault.step_s
    stamp_ns = ns_from_stamp(message.header.stamp) + round(off_s * SECOND_NS)
    stamp_ns = max(-END_OF_TIME_NS, min(stamp_ns, END_OF_TIME_NS - 1))
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(stamp_ns)


def _change_frame(value_fault: ValueFault, message: Any, since_s: float) -> None:
    message.header.frame_id += _OTHER


def _convert_units(value_fault: ValueFault, message: Any, since_s: float) -> None:
    fields, factor, offset = _UNITS[value_fault.type_name]
    for path in fields:
        if value_fault.fault.kind != "angles_in_degrees" or path not in _RATES:
            _change(message, path, lambda value: value * factor + offset)


def _change_covariance(value_fault: ValueFault, message: Any, since_s: float) -> None:
    for name in COVARIANCES[value_fault.type_name]:
        given = np.asarray(getattr(message, name), dtype=float)
        faulty = np.zeros(given.size)
        if value_fault.fault.kind == "covariance_negative":
            faulty[:] = given
            # The second variance is used, because a negative first variance means "not given" in ROS.
            second = math.isqrt(given.size) + 1
            faulty[second] = -abs(faulty[second])
        setattr(message, name, faulty)


def _turn_in_horizon(value_fault: ValueFault, message: Any, since_s: float) -> None:
    fault = value_fault.fault
    turn_n = ARCSEC * np.array([fault.north_arcsec, fault.up_arcsec, fault.east_arcsec])
    turn_in_horizon(message, value_fault.type_name, turn_n)


def _turn_device(value_fault: ValueFault, message: Any, since_s: float) -> None:
    """Rotate a device in its frame or offset the encoders: by the fault's angles, or by its rates times the time."""
    fault = value_fault.fault
    unit, factor = ("arcsec_per_min", since_s / _MINUTE_S) if fault.kind == "drift" else ("arcsec", 1.0)
    if value_fault.type_name == ENCODER:
        azimuth_arcsec, elevation_arcsec = (getattr(fault, f"{axis}_{unit}") for axis in ("azimuth", "elevation"))
        message.azimuth = float(wrap_two_pi(message.azimuth + azimuth_arcsec * factor * ARCSEC))
        message.elevation += elevation_arcsec * factor * ARCSEC
    else:
        turn = ARCSEC * factor * np.array([getattr(fault, f"{axis}_{unit}") for axis in ("forward", "up", "right")])
        turn_in_device(message, value_fault.type_name, turn, fault.topic, value_fault.optics)


def _shift_position(value_fault: ValueFault, message: Any, since_s: float) -> None:
    fault = value_fault.fault
    to_deg = math.degrees(1.0 / _EARTH_RADIUS_M)
    message.longitude += fault.east_m * to_deg / math.cos(math.radians(message.latitude))
    message.latitude += fault.north_m * to_deg
    message.altitude += fault.up_m


def _shift_baseline(value_fault: ValueFault, message: Any, since_s: float) -> None:
    fault = value_fault.fault
    message.fix = _FIXED
    message.enu.x += fault.east_m
    message.enu.y += fault.north_m
    message.enu.z += fault.up_m


def _add_false_stars(value_fault: ValueFault, message: Any, since_s: float) -> None:
    """Add spots anywhere on the detector; each spot has the identity of a bright star if the first star has one."""
    if not message.stars:
        return
    camera, rng = value_fault.optics.stars[value_fault.fault.topic], value_fault.rng
    bright = hipparcos().rows_brighter_than(_BRIGHT)
    edge_px = 2.0 * np.array([camera.principal_u_px, camera.principal_v_px])
    false = []
    for _ in range(value_fault.fault.count):
        star, row = copy.copy(message.stars[0]), int(rng.choice(bright))
        star.u, star.v = (edge_px * rng.random(2)).tolist()
        star.magnitude = float(hipparcos().magnitude[row])
        if star.catalogue_id:
            star.catalogue_id = int(hipparcos().hip[row])
        elif not math.isnan(star.right_ascension):
            star.right_ascension = float(wrap_two_pi(hipparcos().at_j2000.right_ascension[row]))
            star.declination = float(hipparcos().at_j2000.declination[row])
        false.append(star)
    message.stars = [*message.stars, *false]


def _add_false_lights(value_fault: ValueFault, message: Any, since_s: float) -> None:
    telescope = value_fault.optics.telescope
    if telescope is None or not message.beacons:
        return
    half_field_m = _HALF_FIELD * float(telescope.focal_length_m)
    lights = [copy.copy(light) for light in message.beacons]
    for number in range(len(lights), value_fault.fault.count):
        lights.append(copy.copy(lights[0]))
        lights[-1].beacon_id = f"false_{number}"
    for light in lights[: value_fault.fault.count]:
        place_m = telescope.principal_point_m + half_field_m * value_fault.rng.uniform(-1.0, 1.0, 2)
        light.x, light.z = place_m.tolist()
    message.beacons = lights


def _hide_first_light(value_fault: ValueFault, message: Any, since_s: float) -> None:
    message.beacons = message.beacons[1:]


def _swap_identities(value_fault: ValueFault, message: Any, since_s: float) -> None:
    seen_lights = value_fault.type_name == IMAGE
    spots = (message.beacons if seen_lights else message.stars)[:2]
    names = ["beacon_id"] if seen_lights else ["catalogue_id", "right_ascension", "declination"]
    identities = [[getattr(spot, name) for name in names] for spot in reversed(spots)]
    for spot, values in zip(spots, identities, strict=True):
        for name, value in zip(names, values, strict=True):
            setattr(spot, name, value)


def _change_id(value_fault: ValueFault, message: Any, since_s: float) -> None:
    if value_fault.type_name == BASELINE:
        message.rover_id += _OTHER
    else:
        for light in message.beacons[:1]:
            light.beacon_id += _OTHER


_VALUE_FAULTS: dict[str, Callable[[ValueFault, Any, float], None]] = {
    "nan": _change_field,
    "infinite": _change_field,
    "corrupt": _change_field,
    "offset": _change_field,
    "stamp_zero": _set_stamp_zero,
    "stamp_late": _shift_stamp,
    "clock_step": _shift_stamp,
    "frame": _change_frame,
    "covariance_unknown": _change_covariance,
    "covariance_negative": _change_covariance,
    "rate_in_degrees": _convert_units,
    "angles_in_degrees": _convert_units,
    "units": _convert_units,
    "axes": lambda value_fault, message, _: convert_axes(message, value_fault.type_name, value_fault.fault.axes),
    "bias": _turn_in_horizon,
    "position_off": _shift_position,
    "knock": _turn_device,
    "drift": _turn_device,
    "slip": _turn_device,
    "wrong_fix": _shift_baseline,
    "false_stars": _add_false_stars,
    "false_lights": _add_false_lights,
    "hide": _hide_first_light,
    "swap": _swap_identities,
    "wrong_id": _change_id,
}
