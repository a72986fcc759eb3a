"""Time since the last heartbeat, less the times for which a process waited for a processor."""

import errno
import os

import pytest

from ship_bringup.suite.process import HeartbeatAge

MISSING = OSError(errno.EMFILE, os.strerror(errno.EMFILE))


class Schedstat:
    """The schedstat file of a process: waiting times at successive readings, s, or exceptions that are raised."""

    def __init__(self, *waited_s: float | Exception) -> None:
        self._waited_s = list(waited_s)

    def read_text(self, encoding: str) -> str:
        waited_s = self._waited_s.pop(0)
        if isinstance(waited_s, Exception):
            raise waited_s
        return f"5000000 {waited_s * 1e9:.0f} 17\n"


@pytest.mark.parametrize(
    ("waited_s", "time_s"),
    [
        ((20.0, 20.0, 20.0), 1.5),
        ((20.0, 20.4, 25.0), 0.1),  # waiting during the whole last step
        ((20.0, MISSING, 20.0), 1.5),  # the supervisor had no file descriptor left
        ((20.0, MISSING, MISSING), 1.5),
        ((20.0, MISSING, 20.3), 1.2),
        ((MISSING, 20.0, 20.3), 1.2),
        ((20.0, 0.0, 0.0), 1.5),
    ],
)
def test_only_time_with_a_processor_counts(monkeypatch, waited_s, time_s):
    monkeypatch.setattr("ship_bringup.suite.process.Path", lambda _path: Schedstat(*waited_s))
    age = HeartbeatAge(1)
    age.add(0.5)
    age.add(1.0)
    assert age.time_s == pytest.approx(time_s)
