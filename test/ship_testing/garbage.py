"""Random values of the right type for any field of any message."""

import array
import contextlib
import functools
from typing import Any

import numpy as np

SECOND_NS = 1_000_000_000
NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 1e-320, 1e-160, 1e-9, 57.3, 100.0, 1e9, 1e154, 1e300, -1e308]
TEXTS = ["", "ins", "star_fore", "\x00", "deck" * 100, "θ—\n"]


Path = tuple[str | int, ...]
"""Path to a field of a message: names, and indices of lists."""


def paths(message: Any, prefix: Path = ()) -> list[Path]:
    """Return the paths of all fields that are not messages."""
    found: list[Path] = []
    for name in message.get_fields_and_field_types():
        value, path = getattr(message, name), (*prefix, name)
        if hasattr(value, "get_fields_and_field_types"):
            found += paths(value, path)
        elif isinstance(value, list) and all(hasattr(entry, "get_fields_and_field_types") for entry in value):
            found += [deeper for place, entry in enumerate(value) for deeper in paths(entry, (*path, place))]
        else:
            found.append(path)
    return found


def put_garbage(message: Any, fields: list[Path], rng: np.random.Generator) -> None:
    """Put random values of the right type into at most three fields."""
    for index in rng.integers(0, len(fields), rng.integers(1, 4)).tolist():
        *parents, name = fields[index]
        holder = functools.reduce(value_at, parents, message)
        # Values beyond the range of a float32 or 8-bit field cannot be received: setting them raises an AssertionError.
        with contextlib.suppress(AssertionError):
            setattr(holder, str(name), garbage(getattr(holder, str(name)), str(name), rng))


def value_at(holder: Any, part: str | int) -> Any:
    """Return the value at a path element."""
    return holder[part] if isinstance(part, int) else getattr(holder, part)


def garbage(value: Any, name: str, rng: np.random.Generator) -> Any:
    if isinstance(value, str):
        return TEXTS[rng.integers(len(TEXTS))]
    if isinstance(value, list):
        return [TEXTS[number] for number in rng.integers(len(TEXTS), size=rng.integers(0, 3))]
    if isinstance(value, float):
        return float(random_number(rng, value))
    if isinstance(value, np.ndarray) and rng.random() < 0.5:
        # A covariance of any magnitude, and of rank 0 to 3.
        root = rng.normal(size=(3, rng.integers(0, 4))) * 10.0 ** rng.uniform([-20.0] * 3, [1.0] * 3)[:, None]
        return (root @ root.T).ravel()
    if isinstance(value, np.ndarray):
        chosen = rng.random(value.size) < rng.choice([0.2, 1.0])
        return np.where(chosen, [random_number(rng, v) for v in value.tolist()], value)
    if isinstance(value, array.array) and value.typecode == "d":
        return [float(number) for number in garbage(np.array(value), name, rng)]
    if isinstance(value, array.array):
        return rng.integers(0, 5, rng.integers(0, 4)).tolist()
    if name == "sec":
        return int(rng.choice([0, -1, -(2**31), 2**31 - 1, value - 1, value + 1, value - 3]))
    if name == "nanosec":
        return int(rng.choice([0, 999_999_999, 1_000_000_000, 2**32 - 1, rng.integers(0, SECOND_NS)]))
    return int(rng.choice([0, 1, 2, 3, 4, 255]))


def random_number(rng: np.random.Generator, value: float) -> float:
    kind = rng.integers(3)
    if kind == 0:
        return float(NUMBERS[rng.integers(len(NUMBERS))])
    return float(rng.normal() * 10.0 ** rng.uniform(-12, 3)) if kind == 1 else value * float(rng.normal())
