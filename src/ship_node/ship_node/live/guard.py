"""Keeps a node alive: what a callback raises is caught, counted, logged and reported, never let out."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from ship_estimation.refusals import failure
from ship_node.edge.messages_out import DiagnosticStatus, Level

Result = TypeVar("Result")

LOG_PERIOD_NS = 1_000_000_000
SHOWN_NS = 10_000_000_000
"""A failure is an error in the diagnostics for this long, then a warning, ns."""


class Logger(Protocol):
    """The one method that is used of a logger."""

    def error(self, message: str) -> Any:
        """Log an error."""
        ...


class Guard:
    """Calls functions that may fail.

    Args:
        logger: gets a line at most once a second.
        monotonic_ns: a clock that never jumps.
    """

    def __init__(self, logger: Logger, monotonic_ns: Callable[[], int]) -> None:
        self._logger = logger
        self._monotonic_ns = monotonic_ns
        self._count = self._not_logged = 0
        self._last_text = ""
        self._last_ns = self._logged_ns = -LOG_PERIOD_NS

    def call(self, what: str, function: Callable[..., Result], *arguments: Any) -> Result | None:
        """The result of the function, or None where it raised.

        Args:
            what: names the call for people, as ``"ins/imu"``.
            function: what to call.
            arguments: with which arguments.
        """
        try:
            return function(*arguments)
        except Exception as error:
            self.note(f"{what}: {failure(error).text}")
            return None

    def status(self) -> DiagnosticStatus:
        """State of the node's own code."""
        if self._count == 0:
            return DiagnosticStatus("callbacks", Level.OK, "no exception")
        recent = self._monotonic_ns() - self._last_ns <= SHOWN_NS
        text = f"{self._count} exceptions, the last in {self._last_text}"
        level = Level.ERROR if recent else Level.WARN
        return DiagnosticStatus("callbacks", level, text, {"exceptions": str(self._count)})

    def note(self, text: str) -> None:
        """Count, log and report an exception that was caught where it was raised."""
        self._count += 1
        self._last_ns = self._monotonic_ns()
        self._last_text = text
        if self._last_ns - self._logged_ns < LOG_PERIOD_NS:
            self._not_logged += 1
            return
        more = f" ({self._not_logged} more since the last line)" if self._not_logged else ""
        self._logger.error(f"exception in {self._last_text}{more}")
        self._logged_ns, self._not_logged = self._last_ns, 0
