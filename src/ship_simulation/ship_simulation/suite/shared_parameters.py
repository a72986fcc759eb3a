"""What a scenario and the configuration of a node say by the same names."""

import dataclasses
import typing
from typing import Any


def shared(device: Any, parameters: type) -> dict[str, Any]:
    """The values of a simulated device that the estimator has a parameter of the same name for, without groups."""
    known = {field.name for field in dataclasses.fields(parameters)}
    values = {field.name: getattr(device, field.name) for field in dataclasses.fields(device) if field.name in known}
    return {name: value for name, value in values.items() if not dataclasses.is_dataclass(value)}


def shared_with_groups(device: Any, parameters: type) -> dict[str, Any]:
    """The same, and of all groups that both have."""
    groups = {
        name: shared_with_groups(getattr(device, name), kind)
        for name, kind in typing.get_type_hints(parameters).items()
        if dataclasses.is_dataclass(kind) and hasattr(device, name)
    }
    return shared(device, parameters) | groups
