"""A program of a suite with its processes and the state of its supervision."""

from dataclasses import dataclass, field

from ship_bags.command_line import EXIT_DONE
from ship_bringup.suite.process import Process
from ship_bringup.suite.program import Program
from ship_bringup.suite.restarts import Restarts


@dataclass
class SupervisedProgram:
    """A program, its working process and reserve process if they exist, and the times of their next starts.

    Attributes:
        program: the program.
        due_s: steady time of the next start, s; None if the program runs or is not started any more.
        restarts: delays between starts of the program.
        process: the working process.
        reserve: the process that waits to replace the working process.
        reserve_due_s: steady time of the start of the reserve process, s.
        ports: UDP ports of the working process.
        failure: exit code of the suite that follows from the last end of the program.
        has_run: True if the program has ever sent a heartbeat.
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
        """True if the program runs or will run again."""
        return self.process is not None or self.due_s is not None

    @property
    def processes(self) -> list[Process]:
        """Return the existing processes of the program."""
        return [process for process in (self.process, self.reserve) if process is not None]
