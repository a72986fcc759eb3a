"""What every benchmark of ``make bench`` gives: rows; and the processor time of a process."""

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Row:
    """One result.

    Attributes:
        name: what was measured.
        value: the figure, in ``unit``.
        unit: its unit; "x" is a ratio.
        greatest: bound that the value must not exceed; None where it is only shown.
    """

    name: str
    value: float
    unit: str
    greatest: float | None = None

    @property
    def met(self) -> bool:
        """Whether the bound holds."""
        return self.greatest is None or self.value <= self.greatest

    @property
    def line(self) -> str:
        """The row for people."""
        bound = "" if self.greatest is None else f"   at most {self.greatest:g}: {'met' if self.met else 'NOT MET'}"
        return f"{self.name:<64}{self.value:10.3f} {self.unit}{bound}"


def process_cpu_s(pid: int) -> float:
    """Processor time of a process so far, all its threads, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
