"""A program of a suite with its processes, and what the keeper remembers of it."""

from dataclasses import dataclass, field

from ship_bags.command_line import EXIT_DONE
from ship_bringup.suite.process import Process
from ship_bringup.suite.program import Program
from ship_bringup.suite.restarts import Restarts


@dataclass
class KeptProgram:
    """A program with its process, if it runs, the one in reserve, and the times at which they are to be started.

    Attributes:
        program: the program.
        due_s: steady time of its next start, s; None where it runs, or is not started any more.
        restarts: pauses between its starts.
        process: the process that works.
        reserve: the process that waits to be its successor.
        reserve_due_s: steady time of the start of one in reserve, s.
        ports: UDP ports of the process that works.
        failure: what its last end means for the suite's exit code.
        has_run: whether it has ever sent a sign of life.
    """

    program: Program
    due_s: float | None
    restarts: Restarts = field(default_factory=Restarts)
    process: Process | None = None
    reserve: Process | None = None
    reserve_due_s: float | None = None
    ports: frozenset[int] = frozenset()
    failure: int = EXIT_DONE
    has_run: bool = False

    @property
    def is_alive(self) -> bool:
        """True if it runs or is to run again."""
        return self.process is not None or self.due_s is not None

    @property
    def processes(self) -> list[Process]:
        """Those that there are."""
        return [process for process in (self.process, self.reserve) if process is not None]
