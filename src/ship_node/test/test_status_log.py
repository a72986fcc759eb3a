"""Changes of the diagnostics in the node's log."""

import pytest

from ship_node.edge.messages_out import DiagnosticStatus, Level
from ship_node.live.status_log import StatusLog


class Lines:
    """Takes what is logged."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, message: str) -> None:
        self.lines.append(f"info {message}")

    def warning(self, message: str) -> None:
        self.lines.append(f"warning {message}")

    def error(self, message: str) -> None:
        self.lines.append(f"error {message}")


@pytest.fixture
def lines() -> Lines:
    return Lines()


def test_mend_16_a_change_of_level_is_one_line(lines: Lines) -> None:
    log = StatusLog(lines)
    well, ill = (Level.OK, "VALID"), (Level.ERROR, "INVALID")
    course = (Level.WARN, "none"), well, (Level.OK, "still"), ill, ill, well
    for level, message in course:
        log.see([DiagnosticStatus("attitude", level, message)])
        assert log.tells_of("attitude") == (level is Level.ERROR)
    assert lines.lines == ["info attitude: VALID", "error attitude: INVALID", "info attitude: VALID"]


def test_an_error_from_the_start_is_said(lines: Lines) -> None:
    log = StatusLog(lines)
    log.see([DiagnosticStatus("name", Level.ERROR, "2 nodes"), DiagnosticStatus("clock", Level.WARN, "waits")])
    assert lines.lines == ["error name: 2 nodes"]


def test_mend_16_a_conflict_comes_and_goes(lines: Lines) -> None:
    log = StatusLog(lines)
    well = DiagnosticStatus("attitude", Level.OK, "VALID")
    conflict = DiagnosticStatus("conflict star.fore", Level.ERROR, "star.fore and the INS disagree")
    for statuses in ([well], [well, conflict], [well, conflict], [well]):
        log.see(statuses)
    assert lines.lines == ["error conflict star.fore: star.fore and the INS disagree", "info conflict star.fore: over"]
