"""Message classes of the ROS installation, by the name of their type."""

import importlib
from typing import Any

from ship_bags.errors import BadInput


def message_class(type_name: str) -> Any:
    """Class of a message type such as ``sensor_msgs/msg/Imu``.

    Raises:
        BadInput: the name is not one of a message type, or the type is not installed.
    """
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise BadInput(f"'{type_name}' is not the name of a message type (expected package/msg/Name)")
    package, _, name = parts
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as problem:
        raise BadInput(f"message type {type_name} is not installed") from problem
