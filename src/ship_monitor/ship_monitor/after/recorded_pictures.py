"""Pictures of a bag at the time that somebody chose: what the page shows of it.

A watch has to hear the ten minutes before a time to show it whole, and that takes a second or two. So another time is
shown at once from its last minute alone, which is all that words and verdicts rest on; the ten minutes, for plots,
events and since when a source is out, are heard a little at each look, and take its place when they are through. Of
what lies before them only alerts and states that still stand are heard: a source that is out for longer is told to be
out for ten minutes.
"""

import math
import time
from collections.abc import Callable, Iterator

from bokeh.models.ui import UIElement

from ship_bags.stamps import NS_PER_S
from ship_monitor.after.recorded_suite import Recorded, RecordedSuite
from ship_monitor.after.time_controls import TimeControls
from ship_watch.history import KEPT_S, History
from ship_watch.limits import Limits
from ship_watch.picture import Picture
from ship_watch.watch import Watch

QUICK_NS = 60 * NS_PER_S
"""The part before a time that is heard at once, ns: verdicts count the last minute."""

LOOK_S = 0.2
"""How long one look may go on with the ten minutes, s."""


class _Heard:
    """A watch that hears a suite from some time on."""

    def __init__(self, suite: RecordedSuite, limits: Limits, since_ns: int) -> None:
        self.watch = Watch(limits)
        self.time_ns = since_ns
        self._messages: Iterator[Recorded] = suite.messages(since_ns)
        self._next = next(self._messages, None)

    def hear(self, until_ns: int, deadline_s: float = math.inf) -> bool:
        """Hear what was said until a log time; the answer is whether that was reached before a time of the clock."""
        while self._next is not None and self._next.log_time_ns <= until_ns:
            message = self._next
            self.watch.take(message.topic, message.message, message.log_time_ns)
            self.time_ns = message.log_time_ns
            self._next = next(self._messages, None)
            if time.monotonic() > deadline_s:
                return False
        self.time_ns = until_ns
        return True


class RecordedPictures:
    """What one browser sees of a suite in a bag (:class:`ship_monitor.page.picture_source.PictureSource`).

    It begins at the end of the bag.

    Args:
        suite: what the bag holds.
        limits: of the ship.
    """

    def __init__(self, suite: RecordedSuite, limits: Limits) -> None:
        self._suite, self._limits = suite, limits
        self._time_ns = suite.end_ns
        self._last_look_s = time.monotonic()
        self._controls = TimeControls((suite.end_ns - suite.start_ns) / NS_PER_S, " · ".join(suite.notes), self._move)
        self._tell_moved: Callable[[], None] = lambda: None
        self._shown: _Heard | None = None
        self._whole: _Heard | None = None

    @property
    def label(self) -> str:
        """SIMULATED where the truth or a scenario is in the bag, else BAG."""
        return "SIMULATED · bag" if self._suite.is_simulated else "BAG"

    @property
    def name(self) -> str:
        """The name of the bag."""
        return self._suite.path.stem or self._suite.path.name

    @property
    def place(self) -> str:
        """What is missing in the bag, or else which bag it is."""
        return self._suite.notes[0] if self._suite.notes else f"bag {self._suite.path.name}"

    @property
    def history(self) -> History:
        """What the plots show: of the last minute until the ten are heard."""
        return self._heard().watch.history

    @property
    def is_whole(self) -> bool:
        """Whether all of the last ten minutes has been heard."""
        return self._whole is None and self._shown is not None

    def go_to(self, since_start_s: float) -> None:
        """Look at another time.

        Args:
            since_start_s: after the first message of the bag, s.
        """
        wanted_ns = self._suite.start_ns + round(since_start_s * NS_PER_S)
        wanted_ns = min(max(wanted_ns, self._suite.start_ns), self._suite.end_ns)
        if not self._time_ns <= wanted_ns <= self._time_ns + QUICK_NS:
            self._shown = self._whole = None
        self._time_ns = wanted_ns

    def look(self) -> Picture:
        """The picture of the time that is looked at, which goes on while the bag is played."""
        now_s = time.monotonic()
        self._play(now_s - self._last_look_s)
        self._last_look_s = now_s
        is_begun = self._shown is None
        shown = self._heard()
        shown.hear(self._time_ns)
        # Another time is shown before anything else is done.
        if not is_begun and self._whole is not None and self._whole.hear(self._time_ns, time.monotonic() + LOOK_S):
            shown = self._shown = self._whole
            self._whole = None
        return shown.watch.look(self._time_ns)

    def controls(self, moved: Callable[[], None]) -> UIElement:
        """Slider and buttons that choose the time; ``moved`` is called when somebody has."""
        self._tell_moved = moved
        return self._controls.layout

    def _move(self, since_start_s: float) -> None:
        """Somebody has chosen a time: the page does not wait for its next look."""
        self.go_to(since_start_s)
        self._tell_moved()

    def _heard(self) -> _Heard:
        """What hears for the picture; begun where the time is another one."""
        if self._shown is None:
            kept_ns = self._time_ns - round(KEPT_S * NS_PER_S)
            quick_ns = self._time_ns - QUICK_NS
            self._shown = _Heard(self._suite, self._limits, quick_ns)
            self._shown.hear(self._time_ns)
            if quick_ns > self._suite.start_ns:
                self._whole = _Heard(self._suite, self._limits, kept_ns)
        return self._shown

    def _play(self, passed_s: float) -> None:
        """Go on by what has passed since the last look; at the end the bag stops."""
        if not self._controls.is_playing:
            return
        length_s = (self._suite.end_ns - self._suite.start_ns) / NS_PER_S
        at_s = min((self._time_ns - self._suite.start_ns) / NS_PER_S + passed_s * self._controls.speed, length_s)
        self.go_to(at_s)
        self._controls.show(at_s)
        if at_s >= length_s:
            self._controls.stop()
