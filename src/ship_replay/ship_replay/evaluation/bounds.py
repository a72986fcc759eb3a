"""Bounds that a run has to meet: ``<bag>.expected.yaml`` (format in bags/README.md)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ship_bags.errors import BadInput
from ship_bags.yaml_text import composed, data_of

SKIP_KEY = "skip_s"
_LIMITS = ("min", "max")


@dataclass(frozen=True)
class Bounds:
    """What a file of bounds says.

    Attributes:
        skip_s: what comes earlier than this after the beginning of the bag is left out of the evaluation.
        limits: quantity → (least, greatest) value allowed; infinite where not limited.
    """

    skip_s: float
    limits: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class JudgedBound:
    """A quantity held against its limits. NaN never meets a bound."""

    quantity: str
    value: float
    least: float
    greatest: float

    @property
    def met(self) -> bool:
        """Whether the value lies within the limits."""
        return self.least <= self.value <= self.greatest

    @property
    def line(self) -> str:
        """One line for people."""
        limits = [f">= {self.least:g}"] if math.isfinite(self.least) else []
        limits += [f"<= {self.greatest:g}"] if math.isfinite(self.greatest) else []
        return f"{'met' if self.met else 'NOT MET'}: {self.quantity} = {self.value:.6g}, bound {' and '.join(limits)}"


def read_bounds(path: Path) -> Bounds:
    """Read a file of bounds.

    Raises:
        BadInput: names the file, the line, the key and what was expected.
    """
    try:
        root = composed(str(path), path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as problem:
        raise BadInput(f"{path}: cannot be read: {problem}") from problem
    if not isinstance(root, yaml.MappingNode):
        raise BadInput(f"{path}: expected lines such as 'fused.heading.rms_arcsec: {{max: 3.0}}'")
    skip_s, limits = 0.0, {}
    for key_node, value_node in root.value:
        key, where = str(key_node.value), f"{path}:{key_node.start_mark.line + 1}: '{key_node.value}'"
        value = data_of(str(path), value_node)
        if key in limits:
            raise BadInput(f"{where} was given before")
        if key == SKIP_KEY:
            skip_s = _number(value, where)
        else:
            limits[key] = _limits(value, where)
    return Bounds(skip_s, limits)


def judge(values: Mapping[str, float], bounds: Bounds, name: str) -> list[JudgedBound]:
    """Each bound with the value that it limits.

    Raises:
        BadInput: a quantity with bounds was not evaluated.
    """
    missing = sorted(bounds.limits.keys() - values.keys())
    if missing:
        raise BadInput(f"{name}: no such quantity: {', '.join(missing)}; there are {', '.join(sorted(values))}")
    return [JudgedBound(key, values[key], *limits) for key, limits in bounds.limits.items()]


def _limits(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, dict) or not value or not set(value) <= set(_LIMITS):
        raise BadInput(f"{where}: expected {{min: NUMBER, max: NUMBER}} or one of them, got {value!r}")
    least, greatest = (
        _number(value[limit], where) if limit in value else default
        for limit, default in zip(_LIMITS, (-math.inf, math.inf), strict=True)
    )
    if least > greatest:
        raise BadInput(f"{where}: min {least:g} is above max {greatest:g}")
    return least, greatest


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise BadInput(f"{where}: expected a number, got {value!r:.40}")
    return float(value)
