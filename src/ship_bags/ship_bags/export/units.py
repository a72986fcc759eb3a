"""Units of message fields and names of their values: from comments of ship_msgs' definitions, or from tables below.

A field with an uncertain unit gets no unit, because a wrong unit is worse than no unit. The same holds for the names of
values.
"""

import functools
import re
from collections.abc import Iterable
from typing import Any, NamedTuple

from ship_bags.message_store import SHIP_MESSAGES, ship_message_folder


class Unit(NamedTuple):
    """Unit: symbol for UDUNITS, and suffix of a column's name (empty if the name needs no suffix)."""

    symbol: str
    suffix: str


_UNITS = {
    "rad": Unit("rad", "rad"),
    "rad^2": Unit("rad2", "rad2"),
    "rad/s": Unit("rad s-1", "rad_per_s"),
    "rad^2/s^2": Unit("rad2 s-2", "rad2_per_s2"),
    "deg": Unit("degree", "deg"),
    "arcsec": Unit("arcsec", "arcsec"),
    "m": Unit("m", "m"),
    "m^2": Unit("m2", "m2"),
    "m/s": Unit("m s-1", "m_per_s"),
    "m/s^2": Unit("m s-2", "m_per_s2"),
    "m^2/s^4": Unit("m2 s-4", "m2_per_s4"),
    "s": Unit("s", "s"),
    "ns": Unit("ns", "ns"),
    "Hz": Unit("Hz", "hz"),
    "1/h": Unit("h-1", "per_h"),
    "pixel": Unit("pixel", "px"),
    "sigma": Unit("1", "sigma"),
    "1": Unit("1", ""),
    "Pa": Unit("Pa", "pa"),
    "Pa^2": Unit("Pa2", "pa2"),
    "degC": Unit("degC", "celsius"),
    "K^2": Unit("K2", "kelvin2"),
}

NANOSECONDS = _UNITS["ns"]

_TABLE = {
    # Fields of ship_msgs whose comments have no unit in brackets.
    "ship_msgs/msg/StarObservation": {"declination": "rad"},
    "ship_msgs/msg/Integrity": {"statistic": "sigma"},
    "sensor_msgs/msg/Imu": {
        "orientation_covariance": "rad^2",
        "angular_velocity": "rad/s",
        "angular_velocity_covariance": "rad^2/s^2",
        "linear_acceleration": "m/s^2",
        "linear_acceleration_covariance": "m^2/s^4",
    },
    "sensor_msgs/msg/NavSatFix": {
        "latitude": "deg", "longitude": "deg", "altitude": "m", "position_covariance": "m^2",
    },
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa", "variance": "Pa^2"},
    "sensor_msgs/msg/Temperature": {"temperature": "degC", "variance": "K^2"},
    "sensor_msgs/msg/RelativeHumidity": {"relative_humidity": "1", "variance": "1"},
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/Pose": {"position": "m"},
    "geometry_msgs/msg/Transform": {"translation": "m"},
}
"""Type → field → unit, by REP-103 and the comments of the definitions; mixed covariances (m, rad) have no unit."""

_STANDARD_NAMES = {
    ("ship_msgs/msg/ShipAttitude", "heading"): "platform_orientation",
    ("ship_msgs/msg/ShipAttitude", "pitch"): "platform_pitch_fore_up",
    ("ship_msgs/msg/ShipAttitude", "roll"): "platform_roll_starboard_down",
    ("sensor_msgs/msg/NavSatFix", "latitude"): "latitude",
    ("sensor_msgs/msg/NavSatFix", "longitude"): "longitude",
    ("sensor_msgs/msg/NavSatFix", "altitude"): "height_above_reference_ellipsoid",
    ("sensor_msgs/msg/RelativeHumidity", "relative_humidity"): "relative_humidity",
}

_STANDARD_NAMES_IN_THE_AIR = {
    ("met/pressure", "fluid_pressure"): "air_pressure",
    ("met/temperature", "temperature"): "air_temperature",
}
"""CF standard names by topic and field; on other topics these fields may be any pressure or temperature."""

_CF_UNITS = {"latitude": "degrees_north", "longitude": "degrees_east"}
"""Unit that CF requires instead of "degree"."""

_CONSTANTS = {
    "diagnostic_msgs/msg/DiagnosticStatus": {"level": ""},
    "sensor_msgs/msg/NavSatStatus": {"status": "STATUS_"},
    "sensor_msgs/msg/NavSatFix": {"position_covariance_type": "COVARIANCE_TYPE_"},
}
"""Type → field whose value is one of the type's constants → prefix of the names of these constants."""

_ONE_OF = re.compile(
    r"\bOne of (?:the constants above|(?P<first>\w+) to (?P<last>\w+)|(?P<listed>\w+(?:, \w+)*))\."
)
_COMMENT_UNIT = re.compile(r"\[([^\]]+)\]")
_FIELD = re.compile(r"^(\S+)\s+([A-Za-z]\w*)\s*(?:#.*)?$")


def unit_of(type_name: str, field: str) -> Unit | None:
    """Return the unit of a field of a message type, or of the numbers inside it; None if unknown."""
    text = _TABLE.get(type_name, {}).get(field)
    if text is None and type_name.startswith(f"{SHIP_MESSAGES}/msg/"):
        text = _commented_units(type_name.rpartition("/")[2]).get(field)
    return None if text is None else _UNITS[text]


def standard_name(type_name: str, field: str) -> str | None:
    """Return the CF standard name of a field of a type; None if it has none."""
    return _STANDARD_NAMES.get((type_name, field))


def standard_name_on(topic: str, field: str) -> str | None:
    """Return the CF standard name that a field has because of its topic; None if it has none."""
    return _STANDARD_NAMES_IN_THE_AIR.get(("/".join(topic.split("/")[-2:]), field))


def cf_units(unit: Unit, name: str | None) -> str:
    """Return the attribute ``units`` of a variable with the given standard name (None if there is none)."""
    return _CF_UNITS.get(name or "", unit.symbol)


def value_names(type_name: str, field: str, constants: Iterable[tuple[str, str, Any]]) -> dict[str, int]:
    """Return the constants that are possible values of a field, name → value; empty if the field has no such constants.

    Args:
        type_name: type of the message.
        field: field of that type.
        constants: name, type and value of each constant, in the order of the definition in use.
    """
    values = {name: value for name, _, value in constants if isinstance(value, int)}
    prefix = _CONSTANTS.get(type_name, {}).get(field)
    if prefix is not None:
        return {name: value for name, value in values.items() if name.startswith(prefix)}
    if not type_name.startswith(f"{SHIP_MESSAGES}/msg/"):
        return {}
    one_of = _ONE_OF.search(_comments(type_name.rpartition("/")[2]).get(field, ""))
    return {} if one_of is None else _selection(one_of, values)


def _selection(one_of: re.Match[str], values: dict[str, int]) -> dict[str, int]:
    """Return the constants that a comment names: a list, a range, or all."""
    names = list(values)
    if one_of["listed"]:
        names = [name for name in one_of["listed"].split(", ") if name in values]
    elif one_of["first"] in values and one_of["last"] in values:
        names = names[names.index(one_of["first"]) : names.index(one_of["last"]) + 1]
    return {name: values[name] for name in names}


@functools.cache
def _commented_units(message: str) -> dict[str, str]:
    """Return field → unit in brackets, from the field's comment."""
    units = {}
    for field, comment in _comments(message).items():
        known = [text for text in _COMMENT_UNIT.findall(comment) if text in _UNITS]
        if known:
            units[field] = known[0]
    return units


@functools.cache
def _comments(message: str) -> dict[str, str]:
    """Return field (other than text) → its comment; a comment applies to all fields up to the next comment."""
    path = ship_message_folder() / f"{message}.msg"
    comments: dict[str, str] = {}
    comment, ended = "", True
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        if line.startswith("#"):
            comment = line if ended else f"{comment} {line}"
            ended = False
            continue
        ended = True
        field = _FIELD.match(line)
        if field is not None and not field[1].startswith("string"):
            comments[field[2]] = comment
    return comments
