"""Definitions of message types that only this ROS installation knows, taken into the message store."""

import os
from pathlib import Path

from rosbags.typesys import get_types_from_msg

from ship_bags.errors import BadInput
from ship_bags.message_store import message_store


def use_installed_definition(type_name: str) -> None:
    """Make the store know a type and all that it refers to, from the .msg files installed beside it.

    Raises:
        BadInput: a definition is not installed or cannot be parsed.
    """
    store = message_store()
    if type_name in store.fielddefs:
        return
    found = get_types_from_msg(_definition_text(type_name), type_name)
    for name in _referred(found[type_name][1]):
        use_installed_definition(name)
    store.register(found)


def _referred(fields: object) -> set[str]:
    """Names of the message types in a parsed definition: the strings package/msg/Name in its description."""
    if isinstance(fields, str):
        return {fields} if fields.count("/") == 2 else set()
    if isinstance(fields, tuple | list):
        return {name for part in fields for name in _referred(part)}
    return set()


def _definition_text(type_name: str) -> str:
    package, _, name = type_name.split("/")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if prefix and path.is_file():
            return path.read_text(encoding="utf-8")
    raise BadInput(f"the definition of {type_name} is not installed (share/{package}/msg/{name}.msg)")
