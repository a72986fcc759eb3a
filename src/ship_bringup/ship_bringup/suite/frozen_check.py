"""Check for frozen programs of a suite: a program without heartbeats is reported, and later killed."""

import time
from collections.abc import Callable, Sequence

from ship_bringup.suite.heartbeats import HeartbeatSocket
from ship_bringup.suite.process import Process
from ship_bringup.suite.program import Role
from ship_bringup.suite.supervised_program import SupervisedProgram

FROZEN_REPORT_S = 5.0
"""Time without a heartbeat after which a program is reported, s."""

FROZEN_RESTART_S = 15.0
"""Time without a heartbeat after which a program is killed and started again, s."""

CHECK_PERIOD_S = 0.5
"""Period at which the times without a heartbeat are checked, s."""

_MAX_START_S = 60.0
"""Minimum time limit for the first heartbeat, s, because a slow computer loads libraries for a while."""


class FrozenCheck:
    """Checks the heartbeats of programs.

    Attributes:
        heartbeats: socket that receives the heartbeats.

    Args:
        report_s: time since the last heartbeat after which a program is reported, s.
        restart_s: time without a heartbeat after which a program is killed, s; at least 60 s for the first heartbeat.
        log: function that logs a line.
    """

    def __init__(self, report_s: float, restart_s: float, log: Callable[[str], None]) -> None:
        self._report_s, self._restart_s, self._log = report_s, restart_s, log
        self.heartbeats = HeartbeatSocket()
        self._checked_s = time.monotonic()

    @property
    def due_s(self) -> float:
        """Return the steady time of the next check, s."""
        return self._checked_s + CHECK_PERIOD_S

    def receive(self, programs: Sequence[SupervisedProgram]) -> None:
        """Record the heartbeats that have arrived."""
        pids = self.heartbeats.receive()
        for entry in programs:
            if entry.process is None or entry.process.pid not in pids:
                continue
            heartbeat_age = entry.process.heartbeat_age
            if heartbeat_age.is_reported and not heartbeat_age.is_killed:
                self._log(f"{entry.program.name} works again after {heartbeat_age.time_s:.0f} s without a heartbeat")
            heartbeat_age.reset()
            entry.has_run = True

    def check(self, programs: Sequence[SupervisedProgram]) -> None:
        """Report programs without a heartbeat, and kill those without one for long; the player is not checked."""
        now_s = time.monotonic()
        if now_s < self.due_s:
            return
        step_s, self._checked_s = now_s - self._checked_s, now_s
        for entry in programs:
            if entry.process is not None and entry.program.role is not Role.PLAYER:
                entry.process.heartbeat_age.add(step_s)
                self._check_process(entry.program.name, entry.process)

    def _check_process(self, name: str, process: Process) -> None:
        heartbeat_age = process.heartbeat_age
        limit_s = self._restart_s if heartbeat_age.has_heartbeat else max(_MAX_START_S, self._restart_s)
        if heartbeat_age.time_s >= limit_s and not heartbeat_age.is_killed:
            heartbeat_age.is_killed = True
            self._log(f"{name} sent no heartbeat for {heartbeat_age.time_s:.0f} s: killed")
            process.kill()
        elif heartbeat_age.has_heartbeat and heartbeat_age.time_s >= self._report_s and not heartbeat_age.is_reported:
            heartbeat_age.is_reported = True
            symptom = f"no heartbeat for {heartbeat_age.time_s:.0f} s, stopped or in a callback that does not return"
            left_s = max(0.0, self._restart_s - heartbeat_age.time_s)
            self._log(f"{name} is frozen: {symptom}; it is killed and started again in {left_s:.0f} s")
