"""Message types of this ROS installation: their classes, and their definitions for the bags of live nodes."""

import json
import re
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_writer import TypeDefinition
from ship_bags.message_factory import message_class

_SEPARATOR = "=" * 80
_NESTED = re.compile(r"(\w+)/(\w+)")


def installed_class(type_name: str) -> Any:
    """Return the class of a message type such as ``sensor_msgs/msg/Imu``.

    Raises:
        BadInput: the name is not the name of a message type, or the type is not installed.
    """
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise BadInput(f"'{type_name}' is not the name of a message type (expected package/msg/Name)")
    try:
        return message_class(type_name)
    except ImportError as problem:
        raise BadInput(f"message type {type_name} is not installed") from problem


def installed_definition(type_name: str) -> TypeDefinition:
    """Return the definition of a message type with all types that it refers to, as rosbag2 embeds it.

    Raises:
        ImportError: the class of a type is not installed.
        LookupError: a type's package has no share folder, or the hash of the type is missing.
        OSError: the files of a type are not installed.
    """
    own, *others = _nested_types(type_name)
    parts = [_text(own)]
    for name in others:
        package, _, kind = name.split("/")
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{kind}\n{_text(name)}")
    return TypeDefinition("\n".join(parts), type_hash(type_name))


def type_hash(type_name: str) -> str:
    """Return the hash of a type (RIHS01)."""
    description = json.loads(_file(type_name, "json").read_text(encoding="utf-8"))
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return str(hashes[type_name])


def _nested_types(type_name: str) -> list[str]:
    """Return the type and the types of its fields, recursively, each once."""
    names = [type_name]
    for name in names:
        for field_type in message_class(name).get_fields_and_field_types().values():
            nested = _NESTED.search(field_type)
            if nested is not None and (full := f"{nested[1]}/msg/{nested[2]}") not in names:
                names.append(full)
    return names


def _text(type_name: str) -> str:
    return _file(type_name, "msg").read_text(encoding="utf-8")


def _file(type_name: str, suffix: str) -> Path:
    package, _, kind = type_name.split("/")
    return Path(get_package_share_directory(package)) / "msg" / f"{kind}.{suffix}"
