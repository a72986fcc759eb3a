"""Steps of the clocks of all inputs of a node, with the core's state from before a possible step."""

from typing import Any

from ship_bags.stamps import duration_text
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_node.health.time_base import TimeBase
from ship_node.messages.common_messages import DiagnosticStatus, Level

_STARS = "star."
_LEAP_SECOND = "a leap second is inserted: two seconds have the same UTC, so this stamp is ambiguous"
_MAX_PENDING_STEP_NS = 60 * SECOND_NS
"""Maximum age of the state from before a possible time step, ns; the core is not reset to an older state."""
_STEP_SHOWN_NS = 60 * SECOND_NS
"""Time for which a step of the time base is a warning, ns."""


class TimeSteps:
    """Steps of the time base, found from the stamps of all inputs.

    Attributes:
        time_base: the clocks of the inputs.
    """

    def __init__(self) -> None:
        self.time_base = TimeBase()
        # State of the core, and timeout-clock time, when the first input with a moved clock was found.
        self._state_before: tuple[Any, int] | None = None
        self._stepped_at_ns = 0

    def restart(self) -> None:
        """Discard the clocks of the inputs."""
        self.time_base.restart()
        self._state_before = None

    def add_arrival(self, topic: str, time_ns: int, receive_ns: int, waiting_ns: int, core: Any) -> int | None:
        """Add the stamp of a message; return a time step that the stamp reveals, ns, or None."""
        step_ns = self.time_base.add_arrival(topic, time_ns, receive_ns, waiting_ns)
        if step_ns is None and not self.time_base.is_step_pending:
            self._state_before = None
        elif step_ns is None and self._state_before is None:
            self._state_before = getattr(core, "state", None), waiting_ns
        return step_ns

    def rejection(self, topic: str, source: str, time_ns: int, waiting_ns: int) -> Rejection | None:
        """Return the rejection of a message whose stamp is ahead of other inputs or ambiguous; None if it is usable."""
        ahead_ns = self.time_base.ahead_ns(topic) if self.time_base.is_step_pending else 0
        if ahead_ns:
            text = f"stamp is {duration_text(ahead_ns)} ahead of the other inputs: check the clock of {source}"
            return Rejection(Reason.FUTURE, text)
        if source.startswith(_STARS) and self.time_base.is_misdated(time_ns, waiting_ns):
            return Rejection(Reason.CLOCK, _LEAP_SECOND)
        return None

    def accept_step(self, core: Any, waiting_ns: int) -> Any:
        """Record a step; return the core's state from before the step, to which the core is reset."""
        state, before = getattr(core, "state", None), self._state_before
        self._state_before, self._stepped_at_ns = None, waiting_ns
        # Messages from after the step may have been used as late messages from before the step.
        return before[0] if before is not None and waiting_ns - before[1] <= _MAX_PENDING_STEP_NS else state

    def statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return one status with the last step of the time base; an empty list if there was no step."""
        if not self.time_base.steps:
            return []
        level = Level.WARN if waiting_ns - self._stepped_at_ns <= _STEP_SHOWN_NS else Level.OK
        text = f"stepped by {step_text(self.time_base.last_step_ns)}: reset, mountings and calibration kept"
        return [DiagnosticStatus("time base", level, text, {"steps": str(self.time_base.steps)})]


def step_text(step_ns: int) -> str:
    """Return the text of a time step."""
    return f"{step_ns / SECOND_NS:+.3f} s"
