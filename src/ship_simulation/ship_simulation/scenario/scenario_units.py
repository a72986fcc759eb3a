"""Units and ranges that several parts of a scenario file share."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters import parameter

ANGLE: dict[str, Any] = {"unit": "deg", "minimum": -360.0, "maximum": 360.0}
SIGMA: dict[str, Any] = {"unit": "arcsec", "minimum": 0.0, "maximum": 360_000.0}
CORRELATION: dict[str, Any] = {"unit": "s", "minimum": 0.1, "maximum": 1e7}
RATE: dict[str, Any] = {"unit": "Hz", "minimum": 0.01, "maximum": 1000.0}
MOMENT: dict[str, Any] = {"unit": "s", "minimum": 0.0, "maximum": 1e6}
DELAY: dict[str, Any] = {"unit": "s", "minimum": 0.0, "maximum": 60.0}


@dataclass(frozen=True)
class Outage:
    """A time without something."""

    start_s: float = parameter(doc="from, after the start", **MOMENT)
    end_s: float = parameter(doc="to, after the start", **MOMENT)


def window_problems(key: str, start_s: float, end_s: float) -> Iterator[str]:
    """What is wrong with a time, as text that begins with the key."""
    if end_s <= start_s:
        yield f"'{key}.end_s' = {end_s} s must be after start_s = {start_s} s"
