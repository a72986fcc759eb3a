"""Message types without a ROS installation: the types of ROS 2 Jazzy from `rosbags`, and the types of ship_msgs.

:func:`message_store` has the types as this version of the suite defines them. :func:`store_with_definitions` adds the
definitions embedded in a bag, which take precedence for that bag.
"""

import functools
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ship_bags.cdr_template import CdrMessage, Definition, FieldType
from ship_bags.errors import BadInput
from ship_bags.message_factory import Converters, MessageFactory

SHIP_MESSAGES = "ship_msgs"

MAX_DEFINITION_CHARACTERS = 100_000
"""Maximum length of a message definition with all types that it refers to, without comments.

This is ten times the length of a large definition.
"""

ADDITIONAL_FIELD = "is unknown to this suite"
"""Ending of a line about a field that a bag's definition has in addition to those of the suite."""

_ARRAY_DTYPES = {"byte": "uint8", "char": "uint8"}
_ELEMENTS = {
    "float64": "d",
    "float32": "f",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "bool": "?",
    "char": "B",
    "string": "string",
}
_REFERENCE_SEPARATOR = "/msg/"


@functools.cache
def message_store() -> Typestore:
    """Return the one store of the process: the types of ROS 2 Jazzy and of ship_msgs.

    :func:`use_installed_definition` adds types to this store.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(ship_message_folder().glob("*.msg")):
        type_name = f"{SHIP_MESSAGES}{_REFERENCE_SEPARATOR}{path.stem}"
        store.register(_parse(path.read_text(encoding="utf-8"), type_name, path))
    return store


def ship_message_folder() -> Path:
    """Return the folder of ship_msgs' message definitions: of the installed package, else of the source tree.

    Raises:
        BadInput: neither folder exists.
    """
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    installed = [prefix / "share" / SHIP_MESSAGES / "msg" for prefix in prefixes]
    in_the_checkout = Path(__file__).resolve().parents[2] / SHIP_MESSAGES / "msg"
    for folder in [*installed, in_the_checkout]:
        if folder.is_dir():
            return folder
    raise BadInput(f"package {SHIP_MESSAGES} was not found: source the workspace's setup file first")


def definition(type_name: str) -> str:
    """Return the definition of a type with all types that it refers to, as a bag embeds it ("ros2msg")."""
    return message_store().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """Return the hash of a type as rosbag2 stores it (RIHS01)."""
    return message_store().hash_rihs01(type_name)


def serialize(message: Any) -> bytes:
    """Return the CDR bytes (little endian) of a message made by :class:`RosbagsFactory` or decoded from a bag."""
    if isinstance(message, CdrMessage):
        return message.__cdr__
    return bytes(message_store().serialize_cdr(message, message.__msgtype__, little_endian=True))


def use_installed_definition(type_name: str) -> None:
    """Add a type from this ROS installation to the store, with all types that it refers to.

    The definitions are the .msg files that the type's package installed.

    Raises:
        BadInput: a definition is not installed or cannot be parsed.
    """
    store = message_store()
    if type_name in store.fielddefs:
        return
    found = _parse(_definition_text(type_name), type_name)
    for name in _referenced_types(found[type_name][1]):
        use_installed_definition(name)
    store.register(found)


class BagTypes(NamedTuple):
    """Types for reading one bag.

    Attributes:
        store: types as the bag defines them; the suite's own store if the bag's definitions agree with this store and
            add no types.
        differences: name of a type → one line per field that differs between bag and suite, fields of nested types
            included. Types without a difference are left out.
        unreadable: type of the bag whose definition cannot be used → reason.
    """

    store: Typestore
    differences: dict[str, list[str]]
    unreadable: dict[str, str]


def store_with_definitions(definitions: Mapping[str, str]) -> BagTypes:
    """Return the types for reading one bag; an unusable definition affects only the type that it defines.

    Args:
        definitions: type name → text of the definition with dependencies; an empty text stands for the suite's
            definition.
    """
    ours = message_store()
    parsed: dict[str, Any] = {}
    unreadable: dict[str, str] = {}
    for type_name, text in definitions.items():
        try:
            parsed[type_name] = _complete_definition(_parse(text or definition(type_name), type_name), ours)
        except BadInput as problem:  # noqa: PERF203 - each type by itself
            unreadable[type_name] = problem.reason
    found = {type_name: _part_differences(parts, ours) for type_name, parts in parsed.items()}
    differences = {type_name: lines for type_name, lines in found.items() if lines}
    if not differences and all(parts.keys() <= ours.fielddefs.keys() for parts in parsed.values()):
        return BagTypes(ours, {}, unreadable)
    store = Typestore()
    # Types without a difference are registered first. A later, differing definition of a nested type does not affect
    # them.
    for type_name in sorted(parsed, key=differences.__contains__):
        try:
            store.register(parsed[type_name])
        except Exception as problem:  # noqa: PERF203 - the store may raise anything for a bag's definition
            unreadable[type_name] = f"its definition contradicts those of other topics: {problem}"
            differences.pop(type_name, None)
    return BagTypes(store, differences, unreadable)


def _complete_definition(parts: Any, ours: Typestore) -> Any:
    """Return a parsed definition with all types that it refers to; missing types are taken from the suite.

    Raises:
        BadInput: the definition refers to an unknown type.
    """
    complete = dict(parts)
    pending = {name for _, fields in parts.values() for name in _referenced_types(fields)} - complete.keys()
    while pending:
        name = pending.pop()
        if name not in ours.fielddefs:
            raise BadInput(f"its definition refers to {name}, which is not in the bag")
        complete[name] = ours.fielddefs[name]
        pending |= _referenced_types(complete[name][1]) - complete.keys()
    return complete


def _part_differences(parts: Any, ours: Typestore) -> list[str]:
    return [
        line
        for part in sorted(parts.keys() & ours.fielddefs.keys())
        for line in field_differences(part, parts[part][1], ours.fielddefs[part][1])
    ]


def field_differences(type_name: str, theirs: Any, ours: Any) -> list[str]:
    """Return one line per field whose name or type differs between a bag's definition and the suite's.

    If there is no such field, the first field at another position gives one line.
    """
    their_fields, our_fields = dict(theirs), dict(ours)
    lines = [f"{type_name}.{name} is missing in the bag" for name in our_fields if name not in their_fields]
    lines += [f"{type_name}.{name} {ADDITIONAL_FIELD}" for name in their_fields if name not in our_fields]
    lines += [
        f"{type_name}.{name} is {_type_text(their_fields[name])} in the bag and {_type_text(our_fields[name])} here"
        for name in our_fields
        if name in their_fields and their_fields[name] != our_fields[name]
    ]
    if not lines and list(their_fields) != list(our_fields):
        moved = next(name for name, other in zip(their_fields, our_fields, strict=True) if name != other)
        lines.append(f"{type_name}.{moved} has another position in the bag")
    return lines


class RosbagsFactory(MessageFactory):
    """Factory of messages by the name of their type, for writing to bags (see :mod:`ship_bags.message_factory`).

    Arrays of numbers may be any sequence; they become numpy arrays of the field's type. A field of type byte
    (DiagnosticStatus.level) takes an integer or, as in rclpy, one byte. An unknown type raises KeyError.
    """

    def plan(self, type_name: str) -> tuple[Any, Converters]:
        """See :meth:`MessageFactory.plan`."""
        store = message_store()
        fields = store.fielddefs[type_name][1]
        return store.types[type_name], {name: self._converter(node, content) for name, (node, content) in fields}

    def definition(self, type_name: str) -> Definition:
        """See :meth:`MessageFactory.definition`."""
        return definition_in(message_store(), type_name)

    def _converter(self, node: Nodetype, content: Any) -> Callable[[Any], Any] | None:
        """Return the converter of a field from its type in rosbags; None if values need no conversion."""
        if node == Nodetype.NAME:
            return self.message_converter(content)
        if node == Nodetype.BASE:
            is_byte = content[0] == "byte"
            return (lambda value: value[0] if isinstance(value, bytes) else int(value)) if is_byte else None
        element_node, element = content[0]
        if element_node == Nodetype.NAME:
            return self.list_converter(element)
        if element[0] == "string":
            return None
        return functools.partial(np.ascontiguousarray, dtype=np.dtype(_ARRAY_DTYPES.get(element[0], element[0])))


def definition_in(store: Typestore, type_name: str) -> Definition:
    """Return the fields of a type in a store, in order, for templates.

    Raises:
        TypeError: a field has a type without template.
    """
    return {name: _field_type(node, content) for name, (node, content) in store.fielddefs[type_name][1]}


def _field_type(node: Nodetype, content: Any) -> FieldType:
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (element_node, element), count = content
        is_sequence = node == Nodetype.SEQUENCE
        return FieldType(_field_type(element_node, element).element, None if is_sequence else count, is_sequence)
    if node == Nodetype.NAME:
        return FieldType(str(content))
    if content[0] not in _ELEMENTS:
        raise TypeError(f"there is no template for a field of type {content[0]}")
    return FieldType(_ELEMENTS[content[0]])


def _referenced_types(fields: object) -> set[str]:
    """Return the names of message types (package/msg/Name) in a parsed definition."""
    if isinstance(fields, str):
        return {fields} if fields.count("/") == 2 else set()
    if isinstance(fields, tuple | list):
        return {name for part in fields for name in _referenced_types(part)}
    return set()


def _definition_text(type_name: str) -> str:
    package, _, name = type_name.split("/")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if prefix and path.is_file():
            return path.read_text(encoding="utf-8")
    raise BadInput(f"the definition of {type_name} is not installed (share/{package}/msg/{name}.msg)")


def _parse(text: str, type_name: str, source: Path | None = None) -> Any:
    # Comments are removed, because the parser needs as much time for a comment as for a field. Windows line ends are
    # accepted.
    lines = (line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
    text = "".join(f"{line}\n" for line in lines)
    if len(text) > MAX_DEFINITION_CHARACTERS:
        reason = f"definition of {type_name} has {len(text)} characters without comments"
        raise BadInput(f"{reason}, at most {MAX_DEFINITION_CHARACTERS} are read", file=source)
    try:
        return get_types_from_msg(text, type_name)
    except Exception as problem:
        # The text is untrusted: the parser may raise anything.
        raise BadInput(f"definition of {type_name} cannot be parsed: {problem}", file=source) from problem


def _type_text(description: Any) -> str:
    """Return a field's type as in a .msg file, except that the bound of a sequence looks like a length."""
    node, content = description
    if node == Nodetype.NAME:
        return str(content)
    if node == Nodetype.BASE:
        return str(content[0])
    element, length = content
    return f"{_type_text(element)}[{length or ''}]"
