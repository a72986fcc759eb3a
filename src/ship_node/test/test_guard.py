from ship_node.edge.messages_out import Level
from ship_node.live.guard import Guard


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
    guard = Guard(Log(), Steady())
    assert guard.call("sum", lambda a, b: a + b, 1, 2) == 3
    assert guard.status().level is Level.OK


def test_logs_once_a_second_and_counts_the_rest():
    log, steady = Log(), Steady()
    guard = Guard(log, steady)
    for tenth in range(12):
        steady.now_ns = tenth * 100_000_000
        assert guard.call("ins/imu", fail, f"number {tenth}") is None
    assert len(log.lines) == 2
    assert log.lines[0].startswith("exception in ins/imu: ValueError: number 0 (")
    assert "number 10" in log.lines[1]
    assert log.lines[1].endswith("(9 more since the last line)")
    assert guard.status().values == {"exceptions": "12"}


def test_error_becomes_a_warning_when_it_is_long_past():
    steady = Steady()
    guard = Guard(Log(), steady)
    guard.call("tick", fail, "no")
    steady.now_ns = 10_000_000_000
    assert guard.status().level is Level.ERROR
    steady.now_ns += 1
    assert guard.status().level is Level.WARN
    assert "tick: ValueError: no (" in guard.status().message
    assert "test_guard.py:" in guard.status().message
