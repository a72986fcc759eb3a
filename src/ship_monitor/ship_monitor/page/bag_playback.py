"""Playback of a bag or black box on the page: its messages, the state of its suite at a chosen time, and the controls.

The full state at a time needs the messages of the ten minutes before that time; reading them takes a second or two.
A new time is therefore first displayed from the messages of the last minute. The minute is enough for safety and NIS
consistency. Plots, events and the times since which sources are OUT need all ten minutes. Each update reads a part of
the ten minutes; when all parts are read, they replace the minute.
From before the ten minutes, only alerts, alignment and calibration are read. A source that has been OUT for longer is
shown as OUT for ten minutes.

The controls are under the top bar: play and pause, speed, time slider, and a note about missing data. They have the
colours of the page, which are custom properties of the CSS of the document.
"""

import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bokeh.models import Button, CustomJS, Div, InlineStyleSheet, Row, Slider, Toggle
from bokeh.models.ui import UIElement

from ship_bags.command_line import launcher
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import TRUTH_PREFIX, relative_topics
from ship_watch.history.history import HISTORY_S, History
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import SuiteState
from ship_watch.topics import monitored_topic

OUTPUTS = ("ship/attitude", "theodolite/pointing")
LATCHED_TOPICS = ("ship/alerts", "ship/alignment", "theodolite/calibration")
"""Topics whose last message stays valid until the next message."""

_NOMINAL_TOPICS = LATCHED_TOPICS[1:]
"""Topics whose first message in the bag gives the nominal values, with which later values are compared."""

THINNING_PERIOD_NS = 100_000_000
"""Period in which one message of a topic is decoded, ns, if the topic's newest message is enough.

The monitor evaluates the suite with the same period."""

SHORT_HISTORY_NS = 60 * NS_PER_S
"""Length of the history that is read immediately for a new time, ns: the minute that NIS consistency uses."""

MAX_READ_S = 0.2
"""Maximum duration of reading a part of the ten minutes in one update, s."""

SPEEDS = (1, 10, 60)
STEP_S = 1.0

_PLAY, _PAUSE = "▶ Play", "❚❚ Pause"

_CLOCK_JS = """
const two = (n) => String(Math.floor(n) % 60).padStart(2, "0");
const clockText = (s) => Math.floor(s / 3600) + ":" + two(s / 60) + ":" + two(s);
clock.text = clockText(cb_obj.value) + " / " + clockText(length);
"""

_CSS = """
:host,.bk-btn,.bk-clearfix{font-family:B612,"Wide Watch",sans-serif}
:host,.bk-btn,.bk-clearfix{color:var(--text);font-size:15px;font-variant-numeric:tabular-nums}
.bk-btn,.bk-btn.bk-active,.bk-btn:hover{background:var(--panel)!important;color:var(--text)!important;
  border:1px solid var(--second-text)!important;border-radius:2px;box-shadow:none!important;padding:6px 8px}
.noUi-target{background:var(--grid)!important;border:1px solid var(--border)!important;box-shadow:none!important}
.noUi-connect{background:var(--second-text)!important}
.noUi-handle{background:var(--text)!important;border:1px solid var(--background)!important;box-shadow:none!important}
.noUi-handle::before,.noUi-handle::after{display:none}
:focus-visible{outline:2px solid var(--text)!important}
"""


@dataclass(frozen=True)
class RecordedMessage:
    """One monitored message: its relative topic, the decoded message, and its log time, ns."""

    topic: str
    message: Any
    log_time_ns: int


class RecordedSuite:
    """An open bag of one suite. Several readers may use it at the same time.

    Attributes:
        path: path of the bag.
        start_ns: log time of the first message.
        end_ns: log time of the last message.
        is_simulated: True if the bag contains the truth or a scenario, unlike a recording of a ship.
        notes: lines about missing data and the consequence of each.

    Args:
        path: an MCAP file or a rosbag2 folder.
        namespace: namespace of the suite in the bag, with or without slashes; empty if the bag contains only one suite.

    Raises:
        BadInput: the bag cannot be read, contains several suites and no namespace is given, or does not contain the
            given suite.
    """

    def __init__(self, path: Path, namespace: str = "") -> None:
        self.path = path
        self._bag = read_bag(path)
        names = relative_topics(self._bag.topics, namespace or self._only_namespace())
        if namespace and not names:
            raise BadInput(f"there is no topic in the namespace /{namespace.strip('/')}", file=path)
        usable = {
            relative: name for relative, name in names.items() if monitored_topic(relative, self._bag.topics[name])
        }
        self._topics = {name: (relative, monitored_topic(relative)) for relative, name in usable.items()}
        self.start_ns, self.end_ns = self._bag.start_ns, self._bag.end_ns
        has_truth = any(relative.startswith(TRUTH_PREFIX) for relative in names)
        self.is_simulated = has_truth or SCENARIO_ATTACHMENT in self._bag.attachments
        self.notes = self._missing_data_notes(set(usable), has_truth)
        self._reported_topics: set[str] = set()
        self._latched = {name: usable[name] for name in LATCHED_TOPICS if name in usable}
        self._first_nominal = [
            next(self._bag.records({usable[name]}), None) for name in _NOMINAL_TOPICS if name in usable
        ]

    def messages(self, since_ns: int) -> Iterator[RecordedMessage]:
        """Yield the alerts, alignment and calibration valid at a log time, then the monitored messages from then on.

        The first alignment and calibration of the bag precede these messages, because they give the nominal values.
        Messages that cannot be decoded are skipped.

        Args:
            since_ns: the log time, ns; messages before it are yielded with this log time.
        """
        last = [self._bag.last_before(topic, since_ns) for topic in self._latched.values()]
        first = [record for record in self._first_nominal if record is not None and record.log_time_ns < since_ns]
        for record in (*first, *last):
            if record is not None:
                yield from self._decode(record, since_ns)
        taken_ns: dict[str, int] = {}
        for record in self._bag.records(self._topics, since_ns):
            row = self._topics[record.topic][1]
            if row is not None and not row.keeps_every_message:
                step = record.log_time_ns // THINNING_PERIOD_NS
                if taken_ns.get(record.topic) == step:
                    continue
                taken_ns[record.topic] = step
            yield from self._decode(record, record.log_time_ns)

    def close(self) -> None:
        """Close the bag."""
        self._bag.close()

    def _decode(self, record: BagRecord, log_time_ns: int) -> Iterator[RecordedMessage]:
        try:
            yield RecordedMessage(self._topics[record.topic][0], record.decode(), log_time_ns)
        except BadInput as problem:
            if record.topic not in self._reported_topics:
                print(f"monitor: message skipped: {problem}", file=sys.stderr, flush=True)
            self._reported_topics.add(record.topic)

    def _only_namespace(self) -> str:
        """Return the namespace of the monitored topics; empty if no topic is monitored."""
        found = {space for name, kind in self._bag.topics.items() if (space := _namespace_of(name, kind)) is not None}
        if len(found) > 1:
            named = ", ".join(f"/{space}" for space in sorted(found))
            raise BadInput(f"the bag contains suites in {named}: select one with --namespace", file=self.path)
        return found.pop() if found else ""

    def _missing_data_notes(self, usable: set[str], has_truth: bool) -> tuple[str, ...]:
        name = self.path.name
        if usable.isdisjoint(OUTPUTS):
            outputs = f"no {OUTPUTS[0]} and no {OUTPUTS[1]}"
            remedy = f"make them with '{launcher()} ship_replay replay {self.path} --out OUT.mcap', then open OUT.mcap"
            return (f"{name} contains {outputs}, only inputs: {remedy}",)
        lines = [] if has_truth else [f"{name} contains no truth: innovations are shown, errors are not"]
        if OUTPUTS[0] not in usable:
            lines.append(f"{name} contains no {OUTPUTS[0]}: heading, pitch and roll are unknown")
        return tuple(lines)


def _namespace_of(name: str, type_name: str) -> str | None:
    """Return the namespace of a monitored topic of a bag; None if the topic is not monitored in any namespace."""
    words = name.strip("/").split("/")
    for length in range(len(words)):
        if monitored_topic("/".join(words[length:]), type_name) is not None:
            return "/".join(words[:length])
    return None


class TimeControls:
    """Controls for the displayed time of a bag.

    The page's script finds the slider and the button by their names, ``time`` and ``play``.

    Attributes:
        layout: layout that the page places under its top bar.

    Args:
        length_s: length of the bag, s.
        note: note about missing data; may be empty.
        go_to: called with the time chosen by the user, s after the first message.
    """

    def __init__(self, length_s: float, note: str, go_to: Callable[[float], None]) -> None:
        self._length_s, self._go_to = length_s, go_to
        self._set_s = length_s
        self._speed_index = 0
        style = InlineStyleSheet(css=_CSS)
        self._play = Toggle(label=_PLAY, name="play", width=110, margin=0, stylesheets=[style])
        self._speed = Button(label=f"× {SPEEDS[0]}", width=64, margin=0, stylesheets=[style])
        self._slider = Slider(
            start=0.0,
            end=max(length_s, STEP_S),
            value=length_s,
            step=STEP_S,
            name="time",
            show_value=False,
            tooltips=False,
            sizing_mode="stretch_width",
            min_width=240,
            margin=(0, 8),
            stylesheets=[style],
        )
        self._clock = Div(text=_clock(length_s, length_s), width=150, margin=0, stylesheets=[style])
        self._play.on_change("active", self._on_play_changed)
        self._speed.on_click(self._on_speed_clicked)
        self._slider.on_change("value", self._on_slider_dragged)
        self._slider.on_change("value_throttled", self._on_slider_released)
        self._slider.js_on_change("value", CustomJS(args={"clock": self._clock, "length": length_s}, code=_CLOCK_JS))
        missing = Div(text=note, render_as_text=True, visible=bool(note), margin=0, stylesheets=[style])
        missing.styles = {"max-width": "22rem"}
        self.layout = Row(
            children=[self._play, self._speed, self._clock, self._slider, missing],
            sizing_mode="stretch_width",
            styles={"align-items": "center", "gap": "4px 12px", "flex-wrap": "wrap"},
        )

    @property
    def is_playing(self) -> bool:
        """True while the bag is played."""
        return bool(self._play.active)

    @property
    def speed(self) -> int:
        """Seconds of the bag that are played in one second."""
        return SPEEDS[self._speed_index]

    def show(self, at_s: float) -> None:
        """Move the slider to a time, s, without pausing the playback."""
        self._set_s = at_s
        self._slider.value = at_s

    def stop(self) -> None:
        """Pause the playback."""
        self._play.active = False

    def _on_play_changed(self, _name: str, _old: Any, is_playing: bool) -> None:
        self._play.label = _PAUSE if is_playing else _PLAY
        if is_playing and self._slider.value >= self._length_s:
            self.show(0.0)
            self._go_to(0.0)

    def _on_speed_clicked(self) -> None:
        self._speed_index = (self._speed_index + 1) % len(SPEEDS)
        self._speed.label = f"× {self.speed}"

    def _on_slider_dragged(self, _name: str, _old: Any, at_s: float) -> None:
        """Pause the playback while the user drags the slider."""
        if at_s != self._set_s:
            self.stop()

    def _on_slider_released(self, _name: str, _old: Any, at_s: float) -> None:
        self._set_s = at_s
        self._go_to(at_s)


def _clock(at_s: float, length_s: float) -> str:
    """Return a time and the length of the bag as hours, minutes and seconds."""
    return " / ".join(f"{int(s) // 3600}:{int(s) // 60 % 60:02d}:{int(s) % 60:02d}" for s in (at_s, length_s))


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
    """Playback of a recorded suite in one browser (:class:`ship_monitor.page.app.PageSource`).

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
