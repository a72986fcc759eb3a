"""Playback of a bag on the page: the state of its suite at a chosen time.

The full state at a time needs the messages of the ten minutes before that time; reading them takes a second or two.
A new time is therefore first displayed from the messages of the last minute. The minute is enough for safety and NIS
consistency. Plots, events and the times since which sources are OUT need all ten minutes. Each update reads a part of
the ten minutes; when all parts are read, they replace the minute.
From before the ten minutes, only alerts, alignment and calibration are read. A source that has been OUT for longer is
shown as OUT for ten minutes.
"""

import math
import time
from collections.abc import Callable, Iterator

from bokeh.models.ui import UIElement

from ship_bags.stamps import NS_PER_S
from ship_monitor.after.recorded_suite import RecordedMessage, RecordedSuite
from ship_monitor.after.time_controls import TimeControls
from ship_watch.history.history import HISTORY_S, History
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import SuiteState

SHORT_HISTORY_NS = 60 * NS_PER_S
"""Length of the history that is read immediately for a new time, ns: the minute that NIS consistency uses."""

MAX_READ_S = 0.2
"""Maximum duration of reading a part of the ten minutes in one update, s."""


class _Replay:
    """Monitor with the messages of a recorded suite from a start time on."""

    def __init__(self, suite: RecordedSuite, limits: Limits, since_ns: int) -> None:
        self.monitor = SuiteMonitor(limits)
        self.time_ns = since_ns
        self._messages: Iterator[RecordedMessage] = suite.messages(since_ns)
        self._next = next(self._messages, None)

    def read_until(self, until_ns: int, deadline_s: float = math.inf) -> bool:
        """Read messages up to a log time; return False if a deadline (monotonic time, s) passed before."""
        while self._next is not None and self._next.log_time_ns <= until_ns:
            message = self._next
            self.monitor.process_message(message.topic, message.message, message.log_time_ns)
            self.time_ns = message.log_time_ns
            self._next = next(self._messages, None)
            if time.monotonic() > deadline_s:
                return False
        self.time_ns = until_ns
        return True


class BagPlayback:
    """Playback of a recorded suite in one browser (:class:`ship_monitor.page.page_source.PageSource`).

    The displayed time is at first the end of the bag.

    Args:
        suite: the recorded suite.
        limits: limits of the ship.
    """

    def __init__(self, suite: RecordedSuite, limits: Limits) -> None:
        self._suite, self._limits = suite, limits
        self._time_ns = suite.end_ns
        self._last_update_s = time.monotonic()
        self._controls = TimeControls((suite.end_ns - suite.start_ns) / NS_PER_S, " · ".join(suite.notes), self._move)
        self._notify_moved: Callable[[], None] = lambda: None
        self._displayed_replay: _Replay | None = None
        self._full_replay: _Replay | None = None

    @property
    def label(self) -> str:
        """SIMULATED if the bag contains the truth or a scenario, else BAG."""
        return "SIMULATED · bag" if self._suite.is_simulated else "BAG"

    @property
    def name(self) -> str:
        """Name of the bag."""
        return self._suite.path.stem or self._suite.path.name

    @property
    def location(self) -> str:
        """Text about missing data in the bag, or the name of the bag."""
        return self._suite.notes[0] if self._suite.notes else f"bag {self._suite.path.name}"

    @property
    def history(self) -> History:
        """Data of the plots: of the last minute, and of all ten minutes as soon as they are read."""
        return self._current_replay().monitor.history

    @property
    def is_history_complete(self) -> bool:
        """True if all of the last ten minutes has been read."""
        return self._full_replay is None and self._displayed_replay is not None

    def go_to(self, since_start_s: float) -> None:
        """Set the displayed time.

        Args:
            since_start_s: time after the first message of the bag, s.
        """
        wanted_ns = self._suite.start_ns + round(since_start_s * NS_PER_S)
        wanted_ns = min(max(wanted_ns, self._suite.start_ns), self._suite.end_ns)
        if not self._time_ns <= wanted_ns <= self._time_ns + SHORT_HISTORY_NS:
            self._displayed_replay = self._full_replay = None
        self._time_ns = wanted_ns

    def current_state(self) -> SuiteState:
        """Return the state at the displayed time, which advances while the bag is played."""
        now_s = time.monotonic()
        self._advance(now_s - self._last_update_s)
        self._last_update_s = now_s
        is_new = self._displayed_replay is None
        replay = self._current_replay()
        replay.read_until(self._time_ns)
        # A new time is displayed before the ten minutes are read.
        if (
            not is_new
            and self._full_replay is not None
            and self._full_replay.read_until(self._time_ns, time.monotonic() + MAX_READ_S)
        ):
            replay = self._displayed_replay = self._full_replay
            self._full_replay = None
        return replay.monitor.current_state(self._time_ns)

    def controls(self, on_move: Callable[[], None]) -> UIElement:
        """Return slider and buttons for the time; ``on_move`` is called after a change by the user."""
        self._notify_moved = on_move
        return self._controls.layout

    def _move(self, since_start_s: float) -> None:
        """Set the time that the user has chosen, and update the page immediately."""
        self.go_to(since_start_s)
        self._notify_moved()

    def _current_replay(self) -> _Replay:
        """Return the replay for the displayed time; after a jump of the time it is a new replay."""
        if self._displayed_replay is None:
            kept_ns = self._time_ns - round(HISTORY_S * NS_PER_S)
            quick_ns = self._time_ns - SHORT_HISTORY_NS
            self._displayed_replay = _Replay(self._suite, self._limits, quick_ns)
            self._displayed_replay.read_until(self._time_ns)
            if quick_ns > self._suite.start_ns:
                self._full_replay = _Replay(self._suite, self._limits, kept_ns)
        return self._displayed_replay

    def _advance(self, passed_s: float) -> None:
        """Advance the displayed time by the time since the last update, s; stop at the end of the bag."""
        if not self._controls.is_playing:
            return
        length_s = (self._suite.end_ns - self._suite.start_ns) / NS_PER_S
        at_s = min((self._time_ns - self._suite.start_ns) / NS_PER_S + passed_s * self._controls.speed, length_s)
        self.go_to(at_s)
        self._controls.show(at_s)
        if at_s >= length_s:
            self._controls.stop()
