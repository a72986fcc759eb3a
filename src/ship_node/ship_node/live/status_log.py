"""What the diagnostics say, in the log too where it changes: who has only a terminal must learn of it as well."""

from collections.abc import Iterable
from typing import Any, Protocol

from ship_node.edge.messages_out import DiagnosticStatus, Level


class LevelledLogger(Protocol):
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


class StatusLog:
    """Logs each status when its level changes, not as often as it is reported; at the start only an error is said.

    Args:
        logger: takes the lines.
    """

    def __init__(self, logger: LevelledLogger) -> None:
        self._logger = logger
        self._levels: dict[str, Level] | None = None

    def tells_of(self, name: str) -> bool:
        """Whether an error of that status was logged and is not over yet."""
        return (self._levels or {}).get(name) is Level.ERROR

    def see(self, statuses: Iterable[DiagnosticStatus]) -> None:
        """Take all statuses of a report."""
        before, now = self._levels, {}
        for status in statuses:
            now[status.name] = status.level
            # A status that was not there before, as of a conflict, was well.
            was = Level.OK if before is None else before.get(status.name, Level.OK)
            if status.level is not was and (before is not None or status.level is Level.ERROR):
                self._say(status.level, f"{status.name}: {status.message}")
        for name, level in (before or {}).items():
            if name not in now and level is not Level.OK:
                self._say(Level.OK, f"{name}: over")
        self._levels = now

    def _say(self, level: Level, text: str) -> None:
        # Three calls: a logger of rclpy takes no other severity from a line that it has heard before.
        if level is Level.OK:
            self._logger.info(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)
