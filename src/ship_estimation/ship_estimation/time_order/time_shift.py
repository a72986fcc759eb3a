"""Time shift of estimates at a step of the time base, which shifts all stamps and keeps all other values."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from ship_geometry.earth.time_scales import NEVER_NS

Value = TypeVar("Value")


def with_shifted_stamps(value: Value, step_ns: int) -> Value:
    """Return a copy of an immutable value in which every field named ``…_ns`` is shifted by a step.

    Such fields hold stamps: an integer, None, an array or a mapping of integers; ``NEVER_NS`` in an array stays. Fields
    of other names are searched recursively.

    Args:
        value: a frozen dataclass, a named tuple, a mapping, or anything without stamps.
        step_ns: the step, ns.

    Example:
        >>> from ship_estimation.fault_detection.unconfirmed_step import UnconfirmedStep
        >>> with_shifted_stamps(UnconfirmedStep(10, "why", "stars"), -3).since_ns
        7
    """
    anything: Any = value
    kind: Any = type(value)
    shifted: Any = value
    if is_dataclass(value) and not isinstance(value, type):
        shifted = object.__new__(kind)
        shifted.__dict__.update(value.__dict__)
        for one in fields(value):
            shifted.__dict__[one.name] = _shifted_field(one.name, getattr(value, one.name), step_ns)
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        named = anything._asdict()
        shifted = anything._replace(**{name: _shifted_field(name, held, step_ns) for name, held in named.items()})
    elif isinstance(value, Mapping):
        shifted = kind({key: with_shifted_stamps(entry, step_ns) for key, entry in value.items()})
    return shifted  # type: ignore[no-any-return]


def _shifted_field(name: str, value: Any, step_ns: int) -> Any:
    return _shifted_stamps(value, step_ns) if name.endswith("_ns") else with_shifted_stamps(value, step_ns)


def _shifted_stamps(value: Any, step_ns: int) -> Any:
    if value is None:
        return None
    if isinstance(value, Mapping):
        kind: Any = type(value)
        return kind({key: _shifted_stamps(entry, step_ns) for key, entry in value.items()})
    if isinstance(value, np.ndarray):
        return np.where(value == NEVER_NS, value, value + step_ns)
    return value + step_ns
