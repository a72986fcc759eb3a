"""Log and diagnostics of a live node's own state.

A :class:`NodeLog` writes the lines of the log, each with its code location. One line at the start gives the set-up. A
:class:`ExceptionGuard` catches, counts, logs and reports exceptions of callbacks, so that they do not end the node. A
:class:`StatusLog` logs changes of the diagnostics for users who have only a terminal. Further statuses report a
duplicate node name and too old stamps.

The logger of rclpy would search for the code location in the files of all modules. The search takes 40 ms for the first
line of a node and 0.3 ms for each later line, and no message is processed meanwhile.
"""

import dataclasses
import re
import sys
from collections.abc import Callable, Iterable
from typing import Any, Protocol, TypeVar

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity
from rclpy.node import Node

from ship_estimation.rejection_rules import failure_rejection
from ship_node.adapters.adapter import Adapter
from ship_node.health.input_health import InputHealthMonitor
from ship_node.messages.common_messages import DiagnosticStatus, Level

Result = TypeVar("Result")

LOG_PERIOD_NS = 1_000_000_000
SHOWN_NS = 10_000_000_000
"""Time for which an exception is an error in the diagnostics before it becomes a warning, ns."""

_FILE = "_file"
_FIGURES = re.compile(r"'[^']*'|\d+(\.\d+)?")
"""Numbers and quoted examples, which change from report to report while the meaning of a text stays."""
_MOST_REASONS = 5


def start_line(adapter: Adapter, config: Any, clock: str, black_box: str) -> str:
    """Return the log line about a node's set-up: devices by kind, files, required topics, clock, black box.

    Args:
        adapter: adapter of the node, as configured.
        config: configuration of the node. A group of devices is a mapping; the name of a file parameter ends with
            ``_file``.
        clock: full name of the topic that sets the node's time; empty for the system's time.
        black_box: path of the node's black box; empty if the node has no black box.
    """
    parts = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if isinstance(value, dict):
            parts.append(f"{field.name.replace('_', ' ')}: {', '.join(value) or 'none'}")
        elif field.name.endswith(_FILE):
            parts.append(f"{field.name}: {value or 'none'}")
    required = [topic.topic for topic in adapter.inputs if topic.required]
    parts += [
        f"needs {', '.join(required) or 'no topic'}",
        f"clock: {clock or 'system time'}",
        f"black box: {black_box or 'none'}",
    ]
    return "; ".join(parts)


class Logger(Protocol):
    """Interface of a logger."""

    def info(self, message: str) -> Any:
        """Log information."""
        ...

    def warning(self, message: str) -> Any:
        """Log a warning."""
        ...

    def error(self, message: str) -> Any:
        """Log an error."""
        ...


class ExceptionGuard:
    """Calls of functions whose exceptions are caught, counted and logged.

    Args:
        logger: gets a line at most once a second.
        monotonic_ns: a steady clock, ns.
    """

    def __init__(self, logger: Logger, monotonic_ns: Callable[[], int]) -> None:
        self._logger = logger
        self._monotonic_ns = monotonic_ns
        self._count = self._not_logged = 0
        self._last_text = ""
        self._last_ns = self._logged_ns = -LOG_PERIOD_NS

    def call(self, what: str, function: Callable[..., Result], *arguments: Any) -> Result | None:
        """Return the result of a function, or None if it raised.

        Args:
            what: name of the call in texts, as ``"ins/imu"``.
            function: the function.
            arguments: arguments of the function.
        """
        try:
            return function(*arguments)
        except Exception as error:
            self.record(f"{what}: {failure_rejection(error).text}")
            return None

    def status(self) -> DiagnosticStatus:
        """Return the status of the node's own code."""
        if self._count == 0:
            return DiagnosticStatus("callbacks", Level.OK, "no exception")
        recent = self._monotonic_ns() - self._last_ns <= SHOWN_NS
        text = f"exceptions: {self._count}, the last in {self._last_text}"
        level = Level.ERROR if recent else Level.WARN
        return DiagnosticStatus("callbacks", level, text, {"exceptions": str(self._count)})

    def record(self, text: str) -> None:
        """Count, log and report an exception that was caught elsewhere."""
        self._count += 1
        self._last_ns = self._monotonic_ns()
        self._last_text = text
        if self._last_ns - self._logged_ns < LOG_PERIOD_NS:
            self._not_logged += 1
            return
        more = f" ({self._not_logged} more since the last line)" if self._not_logged else ""
        self._logger.error(f"exception in {self._last_text}{more}")
        self._logged_ns, self._not_logged = self._last_ns, 0


@dataclasses.dataclass
class _LoggedStatus:
    """Logged state of a status: its level, and the texts logged at that level without numbers and examples."""

    level: Level
    reasons: set[str]


class StatusLog:
    """Logs a status when its level changes or when a fault has a new reason, not at every report.

    At the start only errors are logged. For a lasting fault each reason is logged once, and only the first few.

    Args:
        logger: gets the lines.
    """

    def __init__(self, logger: Logger) -> None:
        self._logger = logger
        self._logged: dict[str, _LoggedStatus] | None = None

    def has_open_error(self, name: str) -> bool:
        """Return True if an error of that status was logged and still persists."""
        return name in (logged := self._logged or {}) and logged[name].level is Level.ERROR

    def update(self, statuses: Iterable[DiagnosticStatus]) -> None:
        """Process all statuses of a report."""
        before, now = self._logged, {}
        for status in statuses:
            reason = _FIGURES.sub("", status.message)
            # Before its first report, a status (for example of a conflict) counts as OK.
            previous = (before or {}).get(status.name, _LoggedStatus(Level.OK, set()))
            is_change = status.level is not previous.level
            now[status.name] = logged = _LoggedStatus(status.level, set()) if is_change else previous
            is_new = (
                reason not in logged.reasons and len(logged.reasons) < _MOST_REASONS and status.level is not Level.OK
            )
            if (is_change or is_new) and (before is not None or status.level is Level.ERROR):
                self._log(status.level, f"{status.name}: {status.message}")
            if is_new:
                logged.reasons.add(reason)
        for name, previous in (before or {}).items():
            if name not in now and previous.level is not Level.OK:
                self._log(Level.OK, f"{name}: no longer reported")
        self._logged = now

    def _log(self, level: Level, text: str) -> None:
        # Three calls, because a logger of rclpy ties each line of code to the severity of its first use.
        if level is Level.OK:
            self._logger.info(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)


def name_status(node: Node) -> DiagnosticStatus:
    """Return the status of the node's name: ERROR if another node has the same name.

    Service calls and parameters for such a name reach either node, and both nodes publish outputs.
    """
    own = node.get_fully_qualified_name()
    names = [f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()]
    if (count := names.count(own)) <= 1:
        return DiagnosticStatus("name", Level.OK, own)
    text = f"{count} nodes are called '{own}': stop all but one, or rename them with -r __node:=NAME"
    return DiagnosticStatus("name", Level.ERROR, text)


def stamps_status(health: InputHealthMonitor) -> DiagnosticStatus:
    """Return the status of the stamps: ERROR if the stamps of an input are too old."""
    if text := health.stale_stamps_text():
        return DiagnosticStatus("stamps", Level.ERROR, text)
    return DiagnosticStatus("stamps", Level.OK, "consistent with the node's time")


class NodeLog:
    """Log of a node, written as by rclpy to the console, to a file and to /rosout.

    Args:
        node: the node.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()

    def info(self, message: str) -> None:
        """Log information."""
        self._write(LoggingSeverity.INFO, message)

    def warning(self, message: str) -> None:
        """Log a warning."""
        self._write(LoggingSeverity.WARN, message)

    def error(self, message: str) -> None:
        """Log an error."""
        self._write(LoggingSeverity.ERROR, message)

    def _write(self, severity: LoggingSeverity, message: str) -> None:
        if self._logger.is_enabled_for(severity):
            caller = sys._getframe(2)
            place = caller.f_code.co_name, caller.f_code.co_filename, caller.f_lineno
            rclpy_implementation.rclpy_logging_rcutils_log(severity, self._logger.name, message, *place)
