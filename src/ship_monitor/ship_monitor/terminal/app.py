"""Program of the terminal view: draws twice a second, handles the keys, and shows pages of details.

The pages are the details of an angle, of a source or of the alerts, and help.
"""

import asyncio
import math
import signal
import time
from collections.abc import Callable
from textwrap import wrap
from typing import ClassVar, Protocol
from zoneinfo import ZoneInfo

from rich.segment import Segment
from rich.style import Style
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.strip import Strip
from textual.widget import Widget

from ship_bags.command_line import EXIT_INTERRUPTED
from ship_geometry.rotations import ARCSEC
from ship_monitor.terminal.screen import (
    View,
    alert_pieces,
    alert_to_show,
    event_lines,
    input_line,
    reasons_text,
    safety_line,
    screen,
    selectable_names,
    source_line,
    top_bar,
)
from ship_monitor.terminal.styled_text import Line, LineFormatter, StyledText, TextStyle
from ship_monitor.themes import THEMES, Theme
from ship_watch import value_texts
from ship_watch.suite_state import AlertEntry, AngleState, SourceDetails, SuiteState, SuiteStateSource

READ_PERIOD_S = 0.25
DRAW_PERIOD_S = 0.5
NOTE_TIME_S = 5.0

_BACK = " Enter or Escape: back   a acknowledge   t theme   p pause   q quit"

_HELP = """\
 SAFE      value is recent, its 95 % accuracy within the ship's limit
 CAUTION   up to 3 times over the limit, or no independent check
 UNSAFE    do not use: more than 3 times over the limit, invalid, or old
 OLD 12 s  no new value for 12 s; struck through, dashes after 60 s

 + IN      source is used               x OUT  source is not used; reason
 - OFF     source is not configured     σ as stated (1.01): stated σ is correct

 /!\\ ALARM: act at once   (!) WARNING: act soon   [!] CAUTION: information
 UNACK: not acknowledged   OVER, UNACK: over, but not acknowledged

 up, down  select an angle or a source; Escape: none
 Enter     details of the selection; without one: all alerts, all inputs
 a         acknowledge the alert in the second line
 t         theme: day, dusk, night (red light)
 p         pause the display; alerts continue
 q         quit"""


class TerminalSource(SuiteStateSource, Protocol):
    """Source of the terminal view: a suite on the network."""

    def tick(self) -> None:
        """Process the received messages."""

    def acknowledge(self, alert_id: str, instance: int) -> str:
        """Acknowledge one instance of an alert; return the result in words. The call may take seconds."""


class _Lines(Widget):
    """Lines of text over the whole terminal."""

    DEFAULT_CSS = "_Lines { width: 100%; height: 100%; }"

    def __init__(self) -> None:
        super().__init__()
        self._lines: tuple[Line, ...] = ()
        self._styles: dict[TextStyle, Style] = {}

    def show(self, lines: tuple[Line, ...], styles: dict[TextStyle, Style]) -> None:
        """Draw lines of text."""
        if (lines, styles) != (self._lines, self._styles):
            self._lines, self._styles = lines, styles
            self.refresh()

    def render_line(self, y: int) -> Strip:
        """Return one row for textual."""
        if y >= len(self._lines):
            return Strip.blank(self.size.width, self._styles.get(TextStyle.TEXT))
        return Strip([Segment(text, self._styles[style]) for text, style in self._lines[y]])


class TerminalApp(App[int]):
    """Terminal view of one suite.

    Args:
        suite: the suite.
        theme_name: theme at the start.
        is_ascii: True if the terminal shows ASCII only.
        zone: time zone of the local time; None for UTC only.
    """

    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("a", "acknowledge"),
        Binding("enter", "toggle_page('details')"),
        Binding("question_mark", "toggle_page('help')"),
        Binding("escape", "go_back"),
        Binding("up", "choose(-1)"),
        Binding("down", "choose(1)"),
        Binding("t", "next_theme"),
        Binding("p", "pause"),
        Binding("q", "leave(0)"),
        Binding("ctrl+c", f"leave({EXIT_INTERRUPTED})", priority=True),
    ]

    def __init__(
        self, suite: TerminalSource, theme_name: str = "day", *, is_ascii: bool = False, zone: ZoneInfo | None = None
    ) -> None:
        super().__init__()
        self._suite, self._theme_name, self._is_ascii, self._zone = suite, theme_name, is_ascii, zone
        self._drawing = _Lines()
        self._suite_state: SuiteState | None = None
        self._paused_s = math.nan
        self._page = self._chosen = self._note = ""
        self._note_until_s = 0.0

    def compose(self) -> ComposeResult:
        """Yield the only widget, which fills the terminal."""
        yield self._drawing

    def on_mount(self) -> None:
        """Start drawing, and install the signal handlers that end the program."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, self.exit, EXIT_INTERRUPTED)
        self.set_interval(READ_PERIOD_S, self._process_topics)
        self.set_interval(DRAW_PERIOD_S, self.draw)
        self.draw()

    def on_resize(self) -> None:
        """Draw with the new size, which is known after this call."""
        self.call_after_refresh(self.draw)

    def _process_topics(self) -> None:
        """Process the received messages; if a message raises, show a note and skip the rest of its batch."""
        try:
            self._suite.tick()
        except Exception as problem:
            self._show_note(f"message skipped: {type(problem).__name__}: {problem}")

    def draw(self) -> None:
        """Draw the current state; during a pause, the state at the start of the pause with the current alerts."""
        now, now_s = self._suite.current_state(), _now_s()
        if self._suite_state is None or math.isnan(self._paused_s):
            self._suite_state = now
        view = View(
            width=self.size.width,
            height=self.size.height,
            name=self._suite.name,
            label=self._suite.label,
            location=self._suite.location,
            paused_s=now_s - self._paused_s,
            chosen=self._chosen,
            note=self._note if now_s < self._note_until_s else "",
            is_ascii=self._is_ascii,
            zone=self._zone,
        )
        if self._page == "help":
            lines = help_page(self._suite_state, view)
        elif self._page == "details":
            lines = details(self._suite_state, now.alerts, view)
        else:
            lines = screen(self._suite_state, now.alerts, view)
        self._drawing.show(lines, styles_of(THEMES[self._theme_name]))

    def action_toggle_page(self, page: str) -> None:
        """Close the open page; if no page is open, open ``page``."""
        self._page = "" if self._page else page
        self.draw()

    def action_go_back(self) -> None:
        """Go back to the first screen; on the first screen clear the selection."""
        self._page, self._chosen = "", self._chosen if self._page else ""
        self.draw()

    def action_choose(self, step: int) -> None:
        """Select the next (``step`` 1) or previous (-1) angle or source."""
        if self._suite_state is None:
            return
        names = selectable_names(self._suite_state)
        place = names.index(self._chosen) + step if self._chosen in names else 0 if step > 0 else len(names) - 1
        self._chosen = names[place % len(names)] if names else ""
        self.draw()

    def action_next_theme(self) -> None:
        """Switch to the next theme: day, dusk, night."""
        names = tuple(THEMES)
        self._theme_name = names[(names.index(self._theme_name) + 1) % len(names)]
        self.draw()

    def action_pause(self) -> None:
        """Pause or resume the display."""
        self._paused_s = _now_s() if math.isnan(self._paused_s) else math.nan
        self.draw()

    def action_leave(self, exit_code: int) -> None:
        """End the program with an exit code."""
        self.exit(exit_code)

    def action_acknowledge(self) -> None:
        """Acknowledge the displayed instance of the alert in the alert line."""
        alert = alert_to_show(self._suite.current_state().alerts)
        if alert is None or alert.is_acknowledged:
            self._show_note("no alert to acknowledge")
            return
        self._show_note(f"acknowledging {alert.id} ...")
        self.run_worker(self._acknowledge(lambda: self._suite.acknowledge(alert.id, alert.instance)))

    async def _acknowledge(self, question: Callable[[], str]) -> None:
        self._show_note(await asyncio.to_thread(question))

    def _show_note(self, note: str) -> None:
        self._note, self._note_until_s = note, _now_s() + NOTE_TIME_S
        self.draw()


def _now_s() -> float:
    """Return a time that never steps and runs while the computer sleeps, s."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) * 1e-9


def styles_of(theme: Theme) -> dict[TextStyle, Style]:
    """Return the style of each kind of text in a theme. Reversed texts stay reversed on a terminal without colours."""

    def style(colour: str, *, bold: bool = False, strike: bool = False, reverse: bool = False) -> Style:
        return Style(color=colour, bgcolor=theme.background, bold=bold, strike=strike, reverse=reverse)

    return {
        TextStyle.TEXT: style(theme.text),
        TextStyle.SECOND: style(theme.second_text),
        TextStyle.STRONG: style(theme.text, bold=True),
        TextStyle.SAFE: style(theme.safe),
        # In reversed text the colour becomes the fill.
        TextStyle.CAUTION: Style(color=theme.caution_fill, bgcolor=theme.caution_word, reverse=True),
        TextStyle.UNSAFE: Style(color=theme.unsafe_fill, bgcolor=theme.unsafe_word, reverse=True, bold=True),
        TextStyle.OLD: style(theme.old, strike=True),
        TextStyle.OUT: style(theme.caution_border, bold=True),
        TextStyle.ALARM: style(theme.alarm, bold=True),
        TextStyle.WARNING: style(theme.warning, bold=True),
        TextStyle.NOTICE: style(theme.caution, bold=True),
        TextStyle.MARKED: style(theme.text, reverse=True),
    }


def help_page(suite_state: SuiteState, view: View) -> tuple[Line, ...]:
    """Return the help page with terms and keys."""
    texts = [StyledText(text, TextStyle.TEXT) for text in _HELP.splitlines()]
    return _page(suite_state, view, "help", [view.formatter.styled_line(text) for text in texts])


def details(suite_state: SuiteState, alerts: tuple[AlertEntry, ...] | None, view: View) -> tuple[Line, ...]:
    """Return the details of the selected angle or source; without a selection, the details of alerts and inputs."""
    for angle in suite_state.angles:
        if angle.name == view.chosen:
            return _page(suite_state, view, angle.name, _angle_rows(angle, suite_state, view.formatter))
    for source in suite_state.sources:
        if source.name == view.chosen:
            return _page(suite_state, view, source.name, _source_rows(source, suite_state, view.formatter))
    return _page(suite_state, view, "alerts", _alert_rows(alerts, suite_state, view.formatter))


def _page(suite_state: SuiteState, view: View, title: str, body: list[Line]) -> tuple[Line, ...]:
    formatter = view.formatter
    rows = [top_bar(suite_state, view), safety_line(suite_state, formatter), formatter.rule(title), *body][
        : max(view.height - 1, 0)
    ]
    rows += [formatter.styled_line()] * (view.height - 1 - len(rows))
    keys = StyledText(f" {view.note}", TextStyle.STRONG) if view.note else StyledText(_BACK, TextStyle.SECOND)
    return (*rows, formatter.styled_line(keys))[-view.height :]


def _row(formatter: LineFormatter, name: str, text: str) -> Line:
    return formatter.styled_line(
        StyledText(f" {formatter.fit(name, 18)}", TextStyle.SECOND), StyledText(text, TextStyle.TEXT)
    )


def _angle_rows(angle: AngleState, suite_state: SuiteState, formatter: LineFormatter) -> list[Line]:
    known = math.isfinite(angle.value) and not (angle.is_old and angle.age_s > value_texts.DASHES_AFTER_S)
    value = f"{math.degrees(angle.value):.6f}°" if known else value_texts.NO_VALUE
    rows = {
        "value": f"{value}  OLD {value_texts.age_text(angle.age_s)}" if angle.is_old else value,
        "state": f"{angle.safety.name}  {angle.reason}",
        "cause": angle.because_of or value_texts.NO_VALUE,
        "since": value_texts.date_and_clock(angle.since_ns),
        "95 % accuracy": value_texts.small_angle(angle.accuracy_95),
        "sigma": f"{angle.accuracy_95 / 1.96 / ARCSEC:.2f}″"
        if math.isfinite(angle.accuracy_95)
        else value_texts.NO_VALUE,
        "protection level": value_texts.small_angle(angle.protection_level),
        "limit": value_texts.limit_text(angle.limit),
        "time of the value": value_texts.date_and_clock(angle.stamp_ns),
        "age": value_texts.age_text(angle.age_s),
    }
    made = [_row(formatter, name, text) for name, text in rows.items()]
    return [*made, formatter.rule("events"), *event_lines(suite_state, formatter, 200, angle.name)]


def _source_rows(source: SourceDetails, suite_state: SuiteState, formatter: LineFormatter) -> list[Line]:
    consistency = source.nis_consistency
    residual = f"{source.residual:.1f} σ" if math.isfinite(source.residual) else value_texts.NO_VALUE
    rows = {
        "reason": source.reason or value_texts.NO_VALUE,
        "disagreement": source.disagreement or value_texts.NO_VALUE,
        "residual": residual,
        "out since": value_texts.date_and_clock(source.out_since_ns) if source.out_since_ns else value_texts.NO_VALUE,
        "because of": source.because_of or value_texts.NO_VALUE,
        "rejected in a row": str(source.rejected_in_a_row),
        "sigma": (consistency.text or f"{consistency.degrees_of_freedom} degrees of freedom")
        if consistency
        else value_texts.NO_VALUE,
    }
    inputs = []
    for each in suite_state.inputs:
        if each.topic in source.topics:
            inputs += [
                input_line(each, formatter),
                _row(formatter, "   rejected for", reasons_text(each) or value_texts.NO_VALUE),
            ]
    made = [
        source_line(source, suite_state, formatter, is_chosen=False),
        *(_row(formatter, name, text) for name, text in rows.items()),
    ]
    made += [formatter.rule("inputs"), *inputs]
    return [*made, formatter.rule("events"), *event_lines(suite_state, formatter, 200, source.name)]


def _alert_rows(alerts: tuple[AlertEntry, ...] | None, suite_state: SuiteState, formatter: LineFormatter) -> list[Line]:
    none = "no alerts" if alerts is not None else "no alert node"
    made: list[Line] = []
    for alert in alerts or ():
        made.append(formatter.styled_line(*alert_pieces(alert, formatter, formatter.width - 24)))
        advice = f"to do: {alert.advice}" if alert.advice else ""
        for text, style in ((alert.text, TextStyle.TEXT), (advice, TextStyle.SECOND)):
            parts = wrap(formatter.clean(text), max(formatter.width - 6, 1))
            made += [formatter.styled_line(StyledText(f"     {part}", style)) for part in parts]
    made = made or [formatter.styled_line(StyledText(f" {none}", TextStyle.SECOND))]
    return [*made, formatter.rule("inputs"), *(input_line(each, formatter) for each in suite_state.inputs)]
