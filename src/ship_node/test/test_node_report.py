"""Exceptions of callbacks, counted and logged; changes of the diagnostics in the node's log."""

import pytest

from ship_node.live.node_report import ExceptionGuard, StatusLog
from ship_node.messages.common_messages import DiagnosticStatus, Level


class Log:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def error(self, message: str) -> None:
        self.lines.append(message)


class Steady:
    now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def fail(text: str) -> None:
    raise ValueError(text)


def test_result_is_passed_through():
    guard = ExceptionGuard(Log(), Steady())
    assert guard.call("sum", lambda a, b: a + b, 1, 2) == 3
    assert guard.status().level is Level.OK


def test_logs_once_a_second_and_counts_the_rest():
    log, steady = Log(), Steady()
    guard = ExceptionGuard(log, steady)
    for tenth in range(12):
        steady.now_ns = tenth * 100_000_000
        assert guard.call("ins/imu", fail, f"number {tenth}") is None
    assert len(log.lines) == 2
    assert log.lines[0].startswith("exception in ins/imu: ValueError: number 0 (")
    assert "number 10" in log.lines[1]
    assert log.lines[1].endswith("(9 more since the last line)")
    assert guard.status().values == {"exceptions": "12"}


def test_an_old_error_becomes_a_warning():
    steady = Steady()
    guard = ExceptionGuard(Log(), steady)
    guard.call("tick", fail, "no")
    steady.now_ns = 10_000_000_000
    assert guard.status().level is Level.ERROR
    steady.now_ns += 1
    assert guard.status().level is Level.WARN
    assert "tick: ValueError: no (" in guard.status().message
    assert "test_node_report.py:" in guard.status().message


class Lines:
    """Logger that collects the lines."""

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


def test_a_change_of_level_is_one_log_line(lines: Lines) -> None:
    log = StatusLog(lines)
    well, ill = (Level.OK, "VALID"), (Level.ERROR, "INVALID")
    reports = (Level.WARN, "none"), well, (Level.OK, "still"), ill, ill, well
    for level, message in reports:
        log.update([DiagnosticStatus("attitude", level, message)])
        assert log.has_open_error("attitude") == (level is Level.ERROR)
    assert lines.lines == ["info attitude: VALID", "error attitude: INVALID", "info attitude: VALID"]


def test_each_reason_of_a_continuing_fault_is_logged_once(lines: Lines) -> None:
    log = StatusLog(lines)
    log.update([DiagnosticStatus("source gyro", Level.OK, "gives")])
    messages = "no line for 3 s", "no line for 4 s", "broken, as '$HE'", "no line for 5 s", "broken, as '$HEHDT'"
    for message in messages:
        log.update([DiagnosticStatus("source gyro", Level.ERROR, message)])
    assert lines.lines == ["error source gyro: no line for 3 s", "error source gyro: broken, as '$HE'"]
    log.update([DiagnosticStatus("source gyro", Level.OK, "gives")])
    for letter in "abcdefghij":
        log.update([DiagnosticStatus("source gyro", Level.ERROR, letter)])
    assert lines.lines[2:] == ["info source gyro: gives", *(f"error source gyro: {letter}" for letter in "abcde")]


def test_an_error_at_the_start_is_logged(lines: Lines) -> None:
    log = StatusLog(lines)
    log.update([DiagnosticStatus("name", Level.ERROR, "2 nodes"), DiagnosticStatus("clock", Level.WARN, "waits")])
    assert lines.lines == ["error name: 2 nodes"]


def test_start_and_end_of_a_conflict_are_logged(lines: Lines) -> None:
    log = StatusLog(lines)
    well = DiagnosticStatus("attitude", Level.OK, "VALID")
    conflict = DiagnosticStatus("conflict star.fore", Level.ERROR, "star.fore and the INS disagree")
    for statuses in ([well], [well, conflict], [well, conflict], [well]):
        log.update(statuses)
    assert lines.lines == [
        "error conflict star.fore: star.fore and the INS disagree", "info conflict star.fore: no longer reported"
    ]
