"""``make bench``: speed, as ratios of two things measured in one run, so that they hold on any machine.

Each benchmark is a function in BENCHMARKS that returns rows; a row with a bound decides the exit code. Processor times
are in s. Exit code 0 done; 1 a bound was not met or a process failed; 2 bad usage.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_replay.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_replay.live_run import LiveFailure, LiveRun

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / "bags" / "demo.mcap"
RATE = 6.0
PAIRS = 3
GREATEST_BOX_RATIO = 1.10
"""A black box may cost a tenth of its node."""


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


def black_box_cost() -> list[Row]:
    """Processor time of the live node over the demo bag, with and without its black box, by turns."""
    without, with_box = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(PAIRS):
            without.append(_node_cpu_s(folder / f"without_{number}", {}))
            with_box.append(_node_cpu_s(folder / f"with_{number}", {"black_box": f"{folder}/box.mcap"}))
    # The least of several: what else the machine does only adds.
    return [
        Row("node over the demo bag, processor time", min(without), "s"),
        Row("the same with its black box", min(with_box), "s"),
        Row("ratio: black box", min(with_box) / min(without), "x", GREATEST_BOX_RATIO),
    ]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"black_box": black_box_cost}


def main() -> int:
    """Run the benchmarks."""
    parser = CommandParser(prog="bench", description=__doc__)
    parser.add_argument("--only", choices=sorted(BENCHMARKS), help="one of them (all)")
    return run_command(parser, _bench, None)


def _bench(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    met = True
    for name, benchmark in BENCHMARKS.items():
        if options.only in (None, name):
            try:
                rows = benchmark()
            except LiveFailure as failure:
                print(f"bench: {name}: {failure}", file=sys.stderr)
                return EXIT_BOUND_NOT_MET
            for row in rows:
                print(row.line, flush=True)
                met = met and row.met
    return EXIT_DONE if met else EXIT_BOUND_NOT_MET


def _node_cpu_s(folder: Path, parameters: dict[str, str]) -> float:
    """Processor time that the node spends on the demo bag, its start left out."""
    with LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", folder, parameters) as run:
        begin_s = _process_cpu_s(run.node.pid)
        run.play(RATE)
        return _process_cpu_s(run.node.pid) - begin_s


def _process_cpu_s(pid: int) -> float:
    """Processor time of a process so far, all its threads, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    sys.exit(main())
