"""Fields of a message type (numbers, texts, times and arrays), and getters of their values.

Nested messages and short fixed-length arrays of messages are expanded.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import zip_longest
from operator import attrgetter
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ship_bags.errors import BadInput
from ship_bags.export.units import Unit, standard_name, unit_of, value_names

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
        cf_name = standard_name(type_name, name)
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
