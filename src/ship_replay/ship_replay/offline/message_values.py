"""The values in a message, field by field: what a comparison of two messages and a golden table are made of."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

Value = str | npt.NDArray[Any]
"""A text, or a number or an array of numbers as an array."""


def values(message: Any, name: str = "") -> Iterator[tuple[str, Value]]:
    """Yield the dotted name and the value of each field; a sequence of messages or texts is preceded by its length.

    Args:
        message: message as rosbags decodes it, or a part of one.
        name: dotted name of the part, empty for a message.
    """
    if dataclasses.is_dataclass(message):
        for field in dataclasses.fields(message):
            if not field.name.startswith("__"):
                yield from values(getattr(message, field.name), f"{name}.{field.name}".lstrip("."))
    elif isinstance(message, list):
        yield f"{name} (length)", np.asarray(len(message))
        for i, element in enumerate(message):
            yield from values(element, f"{name}[{i}]")
    else:
        yield name, message if isinstance(message, str) else np.asarray(message)


def numbers(message: Any) -> npt.NDArray[np.float64]:
    """Return all numbers in a message, lengths of its sequences included, in the order of its fields."""
    found = [np.atleast_1d(value) for _, value in values(message) if not isinstance(value, str)]
    return np.concatenate(found).astype(float) if found else np.empty(0)
