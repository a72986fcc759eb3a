"""Fields of a message type (numbers, texts, times and arrays): getters of their values, units, names of values.

Nested messages and short fixed-length arrays of messages are expanded.

Units and names of values come from comments of ship_msgs' definitions, or from tables below. A field with an uncertain
unit gets no unit, because a wrong unit is worse than no unit. The same holds for the names of values.
"""

import functools
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import zip_longest
from operator import attrgetter
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ship_bags.errors import BadInput
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


_MAX_NUMBERED = 64
"""Maximum length of a fixed array that becomes numbered columns; a longer array becomes a table of its own."""

_MAX_DEPTH = 16
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
BYTES = ("uint8", "byte", "octet")
NO_FIELD = "structure_needs_at_least_one_member"
"""Name of the only entry in the definition of a message without fields."""

_PARALLEL_ARRAYS: dict[str, tuple[dict[str, int], ...]] = {
    "ship_msgs/msg/AlignmentState": ({"names": 1, "values": 1, "units": 1},),
    "ship_msgs/msg/TheodoliteCalibration": ({"names": 1, "values": 1, "units": 1},),
    "ship_msgs/msg/ErrorBudget": ({"sources": 1, "covariances": 9},),
    "ship_msgs/msg/Innovation": ({"components": 1, "residual": 1, "sigma": 1},),
    "ship_msgs/msg/InputHealth": ({"reasons": 1, "reason_counts": 1},),
    "ship_msgs/msg/Integrity": (
        {"quantities": 1, "protection_level": 1, "alert_limit": 1},
        {"hypotheses": 1, "statistic": 1, "threshold": 1},
        {"excluded": 1, "excluded_for_s": 1},
    ),
    "sensor_msgs/msg/JointState": ({"name": 1, "position": 1, "velocity": 1, "effort": 1},),
}
"""Message type → groups of arrays whose elements belong together → number of elements of each array in one row."""

Path = tuple[str | int, ...]
Get = Callable[[Any], Any]


class MessageField(NamedTuple):
    """Number, text, time or array in a message: path and type, and the meaning of its numbers.

    ``array`` names the array if the field is an element of a table's array; else it is empty. ``owner`` is the message
    type that contains the field.
    ``value_names`` are the names of the field's values, if these are constants of the message type.
    """

    path: Path
    node: Nodetype
    content: Any
    unit: Unit | None = None
    standard_name: str | None = None
    array: str = ""
    owner: str = ""
    value_names: tuple[tuple[str, int], ...] = ()

    @property
    def base(self) -> str:
        """Path as the beginning of a column's name; stamp and frame of the header are named without "header"."""
        if self.array:
            return self.array
        inner = self.path[1:] if self.path in (("header", "stamp"), ("header", "frame_id")) else self.path
        return "_".join(map(str, inner))

    @property
    def origin(self) -> str:
        """Path as a program writes it."""
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in self.path)
        return place.removeprefix(".") or self.array


def fields_of(
    type_name: str, store: Typestore, path: Path = (), inherited: Unit | None = None
) -> Iterator[MessageField]:
    """Yield all fields of a message, down to numbers, texts, times and the arrays that are not expanded."""
    if len(path) > _MAX_DEPTH:
        raise BadInput(f"{type_name}: messages within messages are more than {_MAX_DEPTH} deep")
    constants, fields = store.fielddefs[type_name]
    for name, (node, content) in fields:
        unit = unit_of(type_name, name) or inherited
        cf_name = _STANDARD_NAMES.get((type_name, name))
        values = tuple(value_names(type_name, name, constants).items())
        field = MessageField((*path, name), node, content, unit, cf_name, owner=type_name, value_names=values)
        yield from _expanded_fields(field, store)


def _expanded_fields(field: MessageField, store: Typestore) -> Iterator[MessageField]:
    """Yield the field itself, or the fields of a message or of a short array of messages."""
    if field.node == Nodetype.NAME and field.content not in TIMES:
        yield from fields_of(field.content, store, field.path, field.unit)
    elif field.node == Nodetype.ARRAY and field.content[0][0] == Nodetype.NAME and field.content[1] <= _MAX_NUMBERED:
        (node, content), length = field.content
        for place in range(length):
            yield from _expanded_fields(MessageField((*field.path, place), node, content, field.unit), store)
    else:
        yield field


def groups_of(fields: list[MessageField]) -> list[dict[MessageField, int]]:
    """Return the groups of arrays that share a table; each array has the number of its elements in one row."""
    groups: dict[tuple[Path, str], dict[MessageField, int]] = {}
    for field in fields:
        known = next((group for group in _PARALLEL_ARRAYS.get(field.owner, ()) if field.path[-1] in group), {})
        alone = not known or field.content[0][0] != Nodetype.BASE
        key = (field.path, "") if alone else (field.path[:-1], next(iter(known)))
        groups.setdefault(key, {})[field] = 1 if alone else known[str(field.path[-1])]
    return list(groups.values())


def elements_of(group: dict[MessageField, int]) -> Callable[[Any], Iterable[Any]]:
    """Return the getter of a table's rows from a message: elements of the only array, or tuples with an item per array.

    The item is one element, or the list of elements that belong to the row.
    """
    gets = [(getter(field.path), width) for field, width in group.items()]
    if len(gets) == 1:
        get, _ = gets[0]
        return lambda message: as_list(get(message))
    return lambda message: zip_longest(*(_grouped_elements(as_list(get(message)), width) for get, width in gets))


def _grouped_elements(elements: list[Any], width: int) -> list[Any]:
    """Return the elements, or lists of ``width`` elements that belong together."""
    return elements if width == 1 else [elements[place : place + width] for place in range(0, len(elements), width)]


def is_numbered(field: MessageField) -> bool:
    """Return True for a short fixed-length array of numbers or texts."""
    return field.node == Nodetype.ARRAY and field.content[1] <= _MAX_NUMBERED and field.content[0][0] == Nodetype.BASE


def is_bytes(field: MessageField) -> bool:
    """Return True for an array of bytes."""
    node, content = field.content[0]
    return bool(node == Nodetype.BASE and content[0] in BYTES)


def getter(path: Path) -> Get:
    """Return the getter of the value at a path in a message; an empty path gives the message itself."""
    if not path:
        return lambda message: message
    if all(isinstance(part, str) for part in path):
        return attrgetter(".".join(map(str, path)))

    def get(message: Any) -> Any:
        for part in path:
            message = message[part] if isinstance(part, int) else getattr(message, part)
        return message

    return get


def as_list(array: Any) -> list[Any]:
    """Return the elements of a numpy array or a list as Python objects."""
    return array.tolist() if hasattr(array, "tolist") else array  # type: ignore[no-any-return]


def type_in_row(array: MessageField, width: int) -> tuple[Nodetype, Any]:
    """Return the type of a row's value: an element, or an array of ``width`` elements."""
    return array.content[0] if width == 1 else (Nodetype.ARRAY, (array.content[0], width))


def unit_of(type_name: str, field: str) -> Unit | None:
    """Return the unit of a field of a message type, or of the numbers inside it; None if unknown."""
    text = _TABLE.get(type_name, {}).get(field)
    if text is None and type_name.startswith(f"{SHIP_MESSAGES}/msg/"):
        text = _commented_units(type_name.rpartition("/")[2]).get(field)
    return None if text is None else _UNITS[text]


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
