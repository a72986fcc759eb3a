"""Rows of the benchmarks of ``make bench``, and functions that measure two values in one run."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

Figure = TypeVar("Figure")

WITH_INTEGRITY = 1.6
"""Factor of the bounds of a step, an output and a replay due to integrity.

Nodes and replay always update the subfilters.
"""


@dataclass(frozen=True)
class Row:
    """Result of a benchmark.

    Attributes:
        name: what was measured.
        value: the value, in ``unit``.
        unit: unit of the value; "x" for a ratio.
        greatest: bound that the value must not exceed; None for a value that is only shown.
        yardstick: denominator of a ratio; empty for other values, and for a ratio whose name is clear without it.
    """

    name: str
    value: float
    unit: str
    greatest: float | None = None
    yardstick: str = ""

    @property
    def is_within_bound(self) -> bool:
        """True if the bound is met."""
        return self.greatest is None or self.value <= self.greatest

    @property
    def bound(self) -> str:
        """Return the bound as text; empty without a bound."""
        return (
            ""
            if self.greatest is None
            else f"at most {self.greatest:.3g}: {'met' if self.is_within_bound else 'NOT MET'}"
        )

    @property
    def line(self) -> str:
        """Return the row as a line of text."""
        return f"{self.name:<64}{self.value:10.3f} {self.unit}   {self.bound}".rstrip()


def alternate(rounds: int, *measured: Callable[[], Figure]) -> list[list[Figure]]:
    """Return the results of each function, one for each round; the calls alternate, so that other load affects all."""
    return [list(figures) for figures in zip(*([one() for one in measured] for _ in range(rounds)), strict=True)]


def median_ratio(of: list[float], to: list[float]) -> float:
    """Return the median of the ratios of the rounds."""
    return float(np.median(np.divide(of, to)))


def median_us(call: Callable[[], object], calls: int = 2000) -> float:
    """Return the median time of a call, us."""
    times_ns = []
    for _ in range(calls):
        begin_ns = time.perf_counter_ns()
        call()
        times_ns.append(time.perf_counter_ns() - begin_ns)
    return float(np.median(times_ns)) * 1e-3


def own_cpu_s(work: Callable[[], object]) -> float:
    """Return the processor time that this process spends on some work, s."""
    begin_s = time.process_time()
    work()
    return time.process_time() - begin_s


def process_cpu_s(pid: int) -> float:
    """Return the processor time of a process so far (all threads, user and system), s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
