"""The terminal view of a live suite: restart of a bag, and sleep of the computer."""

import asyncio
import contextlib
import itertools
import time

import pytest

from ship_bags.stamps import NS_PER_S
from ship_monitor.live.live_suite import LiveSuite
from ship_monitor.terminal.app import TerminalApp, _Lines
from ship_testing.publishing_ship import SuitePublisher, attitude
from ship_testing.suite_states import plain_text
from ship_watch.safety.limits import Limits

pytestmark = pytest.mark.live

START_NS = 1_777_636_807 * NS_PER_S
"""2026-05-01 12:00:07 UTC."""

LIMIT_S = 20.0
HOUR_NS = 3600 * NS_PER_S


class Bridge:
    """A ship that publishes, with its terminal view."""

    def __init__(self, app, pilot, ship):
        self.app, self.pilot, self.ship = app, pilot, ship
        self._times = iter(())

    def sail_from(self, time_ns):
        self._times = itertools.count(time_ns, NS_PER_S // 50)

    def stop_clock(self):
        self._times = iter(())

    def rows(self):
        return [plain_text(line).rstrip() for line in self.app.query_one(_Lines)._lines]

    def heading(self):
        return next(row for row in self.rows() if row.startswith(" HEADING"))

    async def continue_until(self, condition):
        """Continue until the view meets a condition."""
        deadline_s = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < deadline_s, "\n".join(self.rows())
            for time_ns in itertools.islice(self._times, 3):
                self.ship.publish("ship/attitude", attitude(time_ns))
            await self.pilot.pause(0.06)

    def is_current(self):
        return "057.30" in self.heading() and "OLD" not in self.heading()  # 1 rad


@contextlib.asynccontextmanager
async def bridge():
    with contextlib.ExitStack() as stack:
        ship = SuitePublisher()
        stack.callback(ship.stop)
        suite = LiveSuite("monitor_terminal", "demo", Limits())
        stack.callback(suite.close)
        app = TerminalApp(suite)
        async with app.run_test(size=(80, 24)) as pilot:
            yield Bridge(app, pilot, ship)


@pytest.fixture
def sleep(monkeypatch):
    """Simulate a sleep of the computer: only CLOCK_BOOTTIME advances."""

    def fall_asleep(duration_ns):
        true_clock_ns = time.clock_gettime_ns

        def clock_after_sleep(clock):
            return true_clock_ns(clock) + (duration_ns if clock == time.CLOCK_BOOTTIME else 0)

        monkeypatch.setattr(time, "clock_gettime_ns", clock_after_sleep)

    return fall_asleep


def test_restarted_bag_is_shown_from_its_start():
    async def run_app():
        async with bridge() as seen:
            seen.sail_from(START_NS + HOUR_NS)
            await seen.continue_until(seen.is_current)
            assert any("13:00:" in row for row in seen.rows())
            seen.sail_from(START_NS)
            await seen.continue_until(lambda: any("12:00:" in row for row in seen.rows()))
            await seen.continue_until(seen.is_current)
            assert not any("13:00:" in row for row in seen.rows())

    asyncio.run(run_app())


def test_values_are_old_after_a_sleep_and_then_recover(sleep):
    async def run_app():
        async with bridge() as seen:
            seen.sail_from(START_NS)
            await seen.continue_until(seen.is_current)
            seen.stop_clock()
            sleep(HOUR_NS)
            await seen.continue_until(lambda: "OLD 60 min" in seen.heading())
            assert "057.30" not in seen.heading()
            assert "UNSAFE" in seen.heading()
            seen.sail_from(START_NS + HOUR_NS)
            await seen.continue_until(seen.is_current)

    asyncio.run(run_app())


def test_pause_includes_the_time_of_a_sleep(sleep):
    async def run_app():
        async with bridge() as seen:
            seen.sail_from(START_NS)
            await seen.continue_until(seen.is_current)
            await seen.pilot.press("p")
            sleep(HOUR_NS)
            await seen.continue_until(lambda: any("PAUSED" in row and "60 min" in row for row in seen.rows()))

    asyncio.run(run_app())
