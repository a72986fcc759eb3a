"""Bounds on the quantities of a run: ``<bag>.expected.yaml`` (format in bags/README.md)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ship_bags.errors import BadInput
from ship_bags.input_files import compose, data_of

SKIP_KEY = "skip_s"
_LIMITS = ("min", "max")


@dataclass(frozen=True)
class Bounds:
    """Contents of a file of bounds.

    Attributes:
        skip_s: duration at the beginning of the bag that is excluded from the evaluation, s.
        limits: quantity → (minimum, maximum) allowed; infinite if not limited.
    """

    skip_s: float
    limits: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class _Entry:
    """One entry of a file of bounds: its place, key and value."""

    path: Path
    line: int
    key: str
    value: Any

    def error(self, text: str) -> BadInput:
        return BadInput(f"'{self.key}'{text}", file=self.path, line=self.line, parameters=(self.key,), value=self.value)

    def limits(self) -> tuple[float, float]:
        """Return the minimum and maximum allowed."""
        if not isinstance(self.value, dict) or not self.value or not set(self.value) <= set(_LIMITS):
            raise self.error(f": expected {{min: NUMBER, max: NUMBER}} or one of them, got {self.value!r}")
        least, greatest = (
            self.number(self.value[limit]) if limit in self.value else default
            for limit, default in zip(_LIMITS, (-math.inf, math.inf), strict=True)
        )
        if least > greatest:
            raise self.error(f": min {least:g} is above max {greatest:g}")
        return least, greatest

    def number(self, value: Any) -> float:
        """Return a finite number."""
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.error(f": expected a number, got {value!r:.40}")
        return float(value)


@dataclass(frozen=True)
class CheckedBound:
    """A quantity compared with its limits. NaN never meets a bound."""

    quantity: str
    value: float
    least: float
    greatest: float

    @property
    def is_met(self) -> bool:
        """True if the value lies within the limits."""
        return self.least <= self.value <= self.greatest

    @property
    def line(self) -> str:
        """Result in one line."""
        limits = [f">= {self.least:g}"] if math.isfinite(self.least) else []
        limits += [f"<= {self.greatest:g}"] if math.isfinite(self.greatest) else []
        return (
            f"{'met' if self.is_met else 'NOT MET'}: {self.quantity} = {self.value:.6g}, bound {' and '.join(limits)}"
        )


def read_bounds(path: Path) -> Bounds:
    """Read a file of bounds.

    Raises:
        BadInput: the file cannot be read or is invalid.
    """
    try:
        root = compose(str(path), path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as problem:
        raise BadInput(f"cannot be read: {problem}", file=path) from problem
    if not isinstance(root, yaml.MappingNode):
        raise BadInput("expected lines such as 'fused.heading.rms_arcsec: {max: 3.0}'", file=path)
    skip_s, limits = 0.0, {}
    for key_node, value_node in root.value:
        key = str(key_node.value)
        entry = _Entry(path, key_node.start_mark.line + 1, key, data_of(str(path), value_node))
        if key in limits:
            raise entry.error(" is given twice")
        if key == SKIP_KEY:
            skip_s = entry.number(entry.value)
        else:
            limits[key] = entry.limits()
    return Bounds(skip_s, limits)


def check_bounds(values: Mapping[str, float], bounds: Bounds, name: str) -> list[CheckedBound]:
    """Compare each bounded quantity with its limits.

    Raises:
        BadInput: a quantity with bounds was not evaluated.
    """
    missing = sorted(bounds.limits.keys() - values.keys())
    if missing:
        raise BadInput(f"{name}: no such quantity: {', '.join(missing)}; there are {', '.join(sorted(values))}")
    return [CheckedBound(key, values[key], *limits) for key, limits in bounds.limits.items()]
