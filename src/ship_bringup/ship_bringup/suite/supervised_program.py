"""A program of a suite with its processes and the state of its supervision."""

from dataclasses import dataclass, field

from ship_bags.command_line import EXIT_DONE
from ship_bringup.suite.process import Process
from ship_bringup.suite.program import Program
from ship_bringup.suite.restarts import Restarts


@dataclass
class SupervisedProgram:
    """A program, its process if it runs, and the time of its next start.

    Attributes:
        program: the program.
        due_s: steady time of the next start, s; None if the program runs or is not started any more.
        restarts: delays between starts of the program.
        process: the process.
        ports: UDP ports of the process.
        failure: exit code of the suite that follows from the last end of the program.
        has_run: True if the program has ever sent a heartbeat.
    """

    program: Program
    due_s: float | None
    restarts: Restarts = field(default_factory=Restarts)
    process: Process | None = None
    ports: frozenset[int] = frozenset()
    failure: int = EXIT_DONE
    has_run: bool = False

    @property
    def is_alive(self) -> bool:
        """True if the program runs or will run again."""
        return self.process is not None or self.due_s is not None
