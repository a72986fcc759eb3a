"""What every benchmark of ``make bench`` gives: rows; and how two things are measured in one run."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

Figure = TypeVar("Figure")

WITH_INTEGRITY = 1.6
"""So many times more than issue 10 asks may a step, an output or a replay cost with integrity: the estimates without
each source beside the one by all. The nodes and the replay always keep them."""


@dataclass(frozen=True)
class Row:
    """One result.

    Attributes:
        name: what was measured.
        value: the figure, in ``unit``.
        unit: its unit; "x" is a ratio.
        greatest: bound that the value must not exceed; None where it is only shown.
        yardstick: what the figure is a ratio to; empty where it is none.
    """

    name: str
    value: float
    unit: str
    greatest: float | None = None
    yardstick: str = ""

    @property
    def met(self) -> bool:
        """Whether the bound holds."""
        return self.greatest is None or self.value <= self.greatest

    @property
    def bound(self) -> str:
        """The bound for people; empty where there is none."""
        return "" if self.greatest is None else f"at most {self.greatest:.3g}: {'met' if self.met else 'NOT MET'}"

    @property
    def line(self) -> str:
        """The row for people."""
        return f"{self.name:<64}{self.value:10.3f} {self.unit}   {self.bound}".rstrip()


def by_turns(rounds: int, *measured: Callable[[], Figure]) -> list[list[Figure]]:
    """Of each thing its figures, a round each: what else the machine does meanwhile comes upon all alike."""
    return [list(figures) for figures in zip(*([one() for one in measured] for _ in range(rounds)), strict=True)]


def median_ratio(of: list[float], to: list[float]) -> float:
    """Median of the ratios of the rounds."""
    return float(np.median(np.divide(of, to)))


def median_us(call: Callable[[], object], calls: int = 2000) -> float:
    """Median time of a call, us."""
    times_ns = []
    for _ in range(calls):
        begin_ns = time.perf_counter_ns()
        call()
        times_ns.append(time.perf_counter_ns() - begin_ns)
    return float(np.median(times_ns)) * 1e-3


def own_cpu_s(work: Callable[[], object]) -> float:
    """Processor time that this process spends on some work."""
    begin_s = time.process_time()
    work()
    return time.process_time() - begin_s


def process_cpu_s(pid: int) -> float:
    """Processor time of a process so far, all its threads, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
