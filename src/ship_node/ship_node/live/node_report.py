"""What a live node says of itself, in its log and its diagnostics.

One line at the start tells how it is set up. A :class:`Guard` keeps the node alive: what a callback raises is caught,
counted, logged and reported, never let out. A :class:`StatusLog` brings what the diagnostics say into the log where it
changes: who has only a terminal must learn of it as well. Further statuses tell whether the node's name is its own and
the data are of its time.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from ship_estimation.refusals import failure
from ship_node.edge.adapter import Adapter
from ship_node.edge.input_health import InputHealthBook
from ship_node.edge.messages_out import DiagnosticStatus, Level

if TYPE_CHECKING:
    from rclpy.node import Node

Result = TypeVar("Result")

LOG_PERIOD_NS = 1_000_000_000
SHOWN_NS = 10_000_000_000
"""A failure is an error in the diagnostics for this long, then a warning, ns."""

_FILE = "_file"
_FIGURES = re.compile(r"'[^']*'|\d+(\.\d+)?")
"""What changes in a text from report to report without another meaning: figures, and examples in quotes."""
_MOST_REASONS = 5


def start_line(adapter: Adapter, config: Any, clock: str, black_box: str) -> str:
    """The line of a node about its set-up: devices by kind, files, clock, black box.

    Args:
        adapter: of the node, as configured.
        config: its configuration: a group of devices is a mapping, a file a text whose name ends with ``_file``.
        clock: full name of the topic that sets the node's time; empty where that is the system's.
        black_box: path of its box, empty for none.
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
    """What is used of a logger."""

    def info(self, message: str) -> Any:
        """Log what is well."""
        ...

    def warning(self, message: str) -> Any:
        """Log a warning."""
        ...

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


@dataclasses.dataclass
class _Told:
    """What the log knows of a status: its level, and the texts of that level without their figures and examples."""

    level: Level
    reasons: set[str]


class StatusLog:
    """Logs each status when its level changes or a fault has a new reason, not as often as it is reported.

    At the start only an error is said. Of a fault that lasts each reason is said once, and only the first few.

    Args:
        logger: takes the lines.
    """

    def __init__(self, logger: Logger) -> None:
        self._logger = logger
        self._told: dict[str, _Told] | None = None

    def tells_of(self, name: str) -> bool:
        """Whether an error of that status was logged and is not over yet."""
        return name in (told := self._told or {}) and told[name].level is Level.ERROR

    def see(self, statuses: Iterable[DiagnosticStatus]) -> None:
        """Take all statuses of a report."""
        before, now = self._told, {}
        for status in statuses:
            reason = _FIGURES.sub("", status.message)
            # A status that is new, as of a conflict, counts as well before.
            was = (before or {}).get(status.name, _Told(Level.OK, set()))
            is_change = status.level is not was.level
            now[status.name] = told = _Told(status.level, set()) if is_change else was
            is_new = reason not in told.reasons and len(told.reasons) < _MOST_REASONS and status.level is not Level.OK
            if (is_change or is_new) and (before is not None or status.level is Level.ERROR):
                self._say(status.level, f"{status.name}: {status.message}")
            if is_new:
                told.reasons.add(reason)
        for name, was in (before or {}).items():
            if name not in now and was.level is not Level.OK:
                self._say(Level.OK, f"{name}: over")
        self._told = now

    def _say(self, level: Level, text: str) -> None:
        # Three calls, because a logger of rclpy lets a line of code keep the severity with which it first logged.
        if level is Level.OK:
            self._logger.info(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)


def name_status(node: "Node") -> DiagnosticStatus:
    """Whether a second node has this one's name: services and parameters then reach either, outputs are of both."""
    own = node.get_fully_qualified_name()
    names = [f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()]
    if (count := names.count(own)) <= 1:
        return DiagnosticStatus("name", Level.OK, own)
    text = f"{count} nodes are called '{own}': end all but one, or name them apart with -r __node:=NAME"
    return DiagnosticStatus("name", Level.ERROR, text)


def stamps_status(health: InputHealthBook) -> DiagnosticStatus:
    """Whether any input's data are of another time; the diagnostics of that input say it too."""
    text = health.of_another_time()
    if not text:
        return DiagnosticStatus("stamps", Level.OK, "of the node's time")
    return DiagnosticStatus("stamps", Level.ERROR, text)
