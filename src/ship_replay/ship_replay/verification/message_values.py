"""The values in a message, field by field, for the comparison of two messages and for the golden table."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

Value = str | npt.NDArray[Any]
"""A text, or an array; a number is an array without dimensions."""


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


def are_texts(one: object, other: object) -> bool:
    """True if both values are strings and at least one contains a space.

    Strings without a space are names of frames, sources or reasons. Names are compared like numbers.

    Example:
        >>> are_texts("late: 2 s", "late by 2 s"), are_texts("star.fore", "star.aft"), are_texts("1", 1)
        (True, False, False)
    """
    return isinstance(one, str) and isinstance(other, str) and " " in one + other
