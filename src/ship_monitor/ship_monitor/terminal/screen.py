"""First screen of the terminal view: the state of a suite as rows, at 80 columns by 24 rows.

All states are words, so that colours are not needed. A larger terminal shows more rows; a too small terminal shows a
single line with the worst state.
"""

import math
from dataclasses import dataclass
from zoneinfo import ZoneInfo

from ship_monitor.terminal.styled_text import Line, LineFormatter, StyledText, TextStyle
from ship_watch import value_texts
from ship_watch.suite_state import (
    AlertEntry,
    AngleState,
    InputState,
    Presence,
    Priority,
    Safety,
    SourceDetails,
    SuiteState,
)

MIN_WIDTH, MIN_HEIGHT = 64, 15
"""Size of the smallest terminal with a full screen; a smaller terminal shows one line."""

MIN_EVENT_ROWS = 6
"""Rows for events that must remain free if the inputs are shown."""

KEYS = " a acknowledge   Enter details   t theme   p pause   ? help   q quit"

_MARKS = {Safety.SAFE: "+", Safety.CAUTION: "!", Safety.UNSAFE: "x"}
_LOOKS = {Safety.SAFE: TextStyle.SAFE, Safety.CAUTION: TextStyle.CAUTION, Safety.UNSAFE: TextStyle.UNSAFE}
_ALERT_MARKS = {Priority.ALARM: "/!\\", Priority.WARNING: "(!)", Priority.CAUTION: "[!]"}
_ALERT_LOOKS = {
    Priority.ALARM: TextStyle.ALARM,
    Priority.WARNING: TextStyle.WARNING,
    Priority.CAUTION: TextStyle.NOTICE,
}
# Alert.state of ship_msgs.
_ALERT_STATES = {1: "UNACK", 2: "SILENCED", 3: "ack", 4: "OVER, UNACK"}
_SOURCE_MARKS = {Presence.IN: "+", Presence.OUT: "x", Presence.OFF: "-"}
_SHORT_NAMES = {"heading": "HDG", "pitch": "PIT", "roll": "ROL", "azimuth": "AZI", "elevation": "ELE"}


@dataclass(frozen=True)
class View:
    """Parameters of the display.

    Attributes:
        width: columns of the terminal.
        height: rows of the terminal.
        name: namespace of the suite without slashes, or name of the bag.
        label: label of the source of the state, for example LIVE.
        location: namespace and domain, or bag, shown while waiting for data.
        paused_s: time since the pause, s; NaN if not paused.
        chosen: name of the selected angle or source; empty without a selection.
        note: result of the last action, shown instead of the keys; empty for no note.
        is_ascii: True if the terminal shows ASCII only.
        zone: time zone of the local time; None for UTC only.
    """

    width: int
    height: int
    name: str
    label: str
    location: str
    paused_s: float = math.nan
    chosen: str = ""
    note: str = ""
    is_ascii: bool = False
    zone: ZoneInfo | None = None

    @property
    def formatter(self) -> LineFormatter:
        """Formatter with the width of the terminal."""
        return LineFormatter(self.width, self.is_ascii)


def screen(suite_state: SuiteState, alerts: tuple[AlertEntry, ...] | None, view: View) -> tuple[Line, ...]:
    """Return the first screen: exactly ``view.height`` lines, each as wide as the view.

    Args:
        suite_state: displayed state; an earlier state while the view is paused.
        alerts: current alerts, also while the view is paused; None without an alert node.
        view: parameters of the display.
    """
    formatter = view.formatter
    if view.width < MIN_WIDTH or view.height < MIN_HEIGHT:
        return _pad_to_height([_small_screen_line(suite_state, view)], view)
    top = [top_bar(suite_state, view), _alert_line(alerts, formatter), *_waiting(suite_state, view), formatter.rule()]
    middle = [*_angles(suite_state, view), formatter.rule(), _ages(suite_state, formatter)]
    room = view.height - len(top) - len(middle) - 3
    source_rows = min(len(suite_state.sources), max(room - 2, 1))
    input_rows = len(suite_state.inputs) if room - source_rows >= len(suite_state.inputs) + 1 + MIN_EVENT_ROWS else 0
    bottom = [_sources_rule(suite_state, formatter), *_sources(suite_state, view, source_rows)]
    if input_rows:
        bottom += [formatter.rule("inputs"), *(input_line(each, formatter) for each in suite_state.inputs)]
    bottom.append(formatter.rule("events"))
    event_rows = view.height - len(top) - len(middle) - len(bottom) - 1
    bottom += event_lines(suite_state, formatter, max(event_rows, 0))
    keys = formatter.styled_line(
        StyledText(f" {view.note}", TextStyle.STRONG) if view.note else StyledText(KEYS, TextStyle.SECOND)
    )
    return (*_pad_to_height([*top, *middle, *bottom], view)[: view.height - 1], keys)


def alert_to_show(alerts: tuple[AlertEntry, ...] | None) -> AlertEntry | None:
    """Return the alert of the alert line: the most urgent unacknowledged alert, else the most urgent alert."""
    return min(alerts or (), key=lambda alert: alert.urgency, default=None)


def selectable_names(suite_state: SuiteState) -> tuple[str, ...]:
    """Return the names of the selectable angles and sources, from top to bottom."""
    return (*(angle.name for angle in suite_state.angles), *(source.name for source in suite_state.sources))


def top_bar(suite_state: SuiteState, view: View) -> Line:
    """Return the row with name, safety and reason of the suite, and the time; PAUSED during a pause."""
    formatter, overall = view.formatter, suite_state.overall
    left = [
        StyledText(" ", TextStyle.TEXT),
        StyledText(view.name, TextStyle.STRONG),
        StyledText(f"  {view.label}  ", TextStyle.SECOND),
    ]
    if not math.isnan(view.paused_s):
        left += [
            StyledText(f" PAUSED {value_texts.age_text(view.paused_s)} ago ", TextStyle.MARKED),
            StyledText("  ", TextStyle.TEXT),
        ]
    left += [
        StyledText(f" {_MARKS[overall.safety]} {overall.safety.name} ", _LOOKS[overall.safety]),
        StyledText(f" {overall.text}", TextStyle.TEXT),
    ]
    local = value_texts.local_clock(suite_state.utc_ns, view.zone)
    right = f" {local}  " if local else " "
    right += f"{value_texts.utc_clock(suite_state.utc_ns)} UTC "
    room = max(view.width - formatter.cell_count(right), 0)
    return formatter.styled_line(
        *LineFormatter(room, view.is_ascii).styled_line(*left), StyledText(right, TextStyle.STRONG)
    )


def safety_line(suite_state: SuiteState, formatter: LineFormatter) -> Line:
    """Return the safety of all angles in one row, for the other pages, as in "HDG + SAFE  PIT ! CAUTION"."""
    pieces = [
        piece
        for angle in suite_state.angles
        for piece in (
            StyledText(f" {_SHORT_NAMES.get(angle.name, angle.name)} ", TextStyle.SECOND),
            StyledText(f"{_MARKS[angle.safety]} {angle.safety.name}", _LOOKS[angle.safety]),
            StyledText(" ", TextStyle.TEXT),
        )
    ]
    return formatter.styled_line(*pieces)


def alert_pieces(alert: AlertEntry, formatter: LineFormatter, text_width: int) -> list[StyledText]:
    """Return icon, priority, text, time and state of an alert."""
    style = _ALERT_LOOKS[alert.priority]
    head = f" {_ALERT_MARKS[alert.priority]} {alert.priority.name} "
    text = formatter.fit(alert.text or alert.id, max(text_width - len(head), 1))
    state = formatter.fit(_ALERT_STATES.get(alert.state, ""), 12)
    state_look = TextStyle.TEXT if alert.is_acknowledged else TextStyle.STRONG
    return [
        StyledText(head + text, style),
        StyledText(f" {value_texts.utc_clock(alert.raised_ns)}  ", TextStyle.SECOND),
        StyledText(state, state_look),
    ]


def source_line(source: SourceDetails, suite_state: SuiteState, formatter: LineFormatter, *, is_chosen: bool) -> Line:
    """Return the row of a source: presence, age, rate, reason. A source that is OUT due to a faulty source is indented.

    If no output is current, the row of a source that is not OUT is struck through and marked "?".
    """
    is_out = source.presence is Presence.OUT
    is_consequence = is_out and source.because_of in {each.name for each in suite_state.sources if not each.because_of}
    consistency = source.nis_consistency.text if source.nis_consistency is not None else ""
    known = [source.reason, source.disagreement] if is_out else [source.disagreement, consistency]
    if is_out and source.because_of and not is_consequence and source.because_of not in source.reason:
        known.append(f"because of {source.because_of}")
    rate = f"{source.rate_hz:6.1f} Hz" if math.isfinite(source.rate_hz) else " " * 9
    mark = "?" if suite_state.is_old and not is_out else _SOURCE_MARKS[source.presence]
    name = f"{'>' if is_chosen else ' '}{mark} {formatter.fit('  ' * is_consequence + source.name, 16)}"
    middle = f" {formatter.fit(value_texts.age_text(source.age_s), 7, to_right=True)} {rate}  "
    style = TextStyle.OUT if is_out else TextStyle.OLD if suite_state.is_old else TextStyle.TEXT
    second = TextStyle.OLD if suite_state.is_old and not is_out else TextStyle.SECOND
    return formatter.styled_line(
        StyledText(name, TextStyle.MARKED if is_chosen else style),
        StyledText(f" {source.presence.value:3}", style),
        StyledText(middle, second),
        StyledText(", ".join(filter(None, known)), style if is_out else second),
    )


def input_line(state: InputState, formatter: LineFormatter) -> Line:
    """Return the row of an input topic: rate, latency, age and rejections."""
    latency = f"{state.latency_s:7.3f} s" if math.isfinite(state.latency_s) else f"{value_texts.NO_VALUE:>9}"
    rate = f"{state.rate_hz:7.1f} Hz" if math.isfinite(state.rate_hz) else f"{value_texts.NO_VALUE:>10}"
    numbers = f"{rate} {latency} {formatter.fit(value_texts.age_text(state.age_s), 8, to_right=True)}"
    style = TextStyle.OUT if state.level else TextStyle.TEXT
    return formatter.styled_line(
        StyledText(f"   {formatter.fit(state.topic, 30)}", style),
        StyledText(f"{numbers}  {state.rejected_60s:4d} rejected  {reasons_text(state)}", TextStyle.SECOND),
    )


def reasons_text(state: InputState) -> str:
    """Return the reasons of rejections of an input with their counts, as in "gate 9, misidentified 4"."""
    return ", ".join(f"{name} {count}" for name, count in sorted(state.reasons.items()) if count)


def event_lines(suite_state: SuiteState, formatter: LineFormatter, room: int, subject: str = "") -> list[Line]:
    """Return the rows of the newest events, of all subjects or of one subject."""
    events = [event for event in suite_state.events if not subject or event.subject == subject]
    return [
        formatter.styled_line(
            StyledText(f" {value_texts.utc_clock(event.utc_ns)}  ", TextStyle.SECOND),
            StyledText(event.text if event.kind == "alert" else f"{event.kind}: {event.text}", TextStyle.TEXT),
        )
        for event in events[:room]
    ]


def _pad_to_height(lines: list[Line], view: View) -> tuple[Line, ...]:
    empty = view.formatter.styled_line()
    return (*lines, *[empty] * (view.height - len(lines)))[: view.height]


def _small_screen_line(suite_state: SuiteState, view: View) -> Line:
    """Return the line with the worst state, for a too small terminal."""
    worst = max(suite_state.angles, key=lambda angle: angle.safety, default=None)
    text = f"waiting for {suite_state.waiting_for}" if suite_state.waiting_for else ""
    if worst is not None and not text:
        names = [angle.name for angle in suite_state.angles if angle.safety is worst.safety]
        text = "all SAFE" if worst.safety is Safety.SAFE else f"{worst.safety.name} {', '.join(names)}"
    style = TextStyle.TEXT if worst is None else _LOOKS[worst.safety]
    small = f"  {value_texts.utc_clock(suite_state.utc_ns)}  too small: {MIN_WIDTH} by {MIN_HEIGHT} needed"
    return view.formatter.styled_line(StyledText(text, style), StyledText(small, TextStyle.SECOND))


def _waiting(suite_state: SuiteState, view: View) -> list[Line]:
    if not suite_state.waiting_for:
        return []
    text = f" waiting for {suite_state.waiting_for}: {view.location}"
    return [view.formatter.styled_line(StyledText(text, TextStyle.MARKED))]


def _alert_line(alerts: tuple[AlertEntry, ...] | None, formatter: LineFormatter) -> Line:
    alert = alert_to_show(alerts)
    if alerts is None or alert is None:
        return formatter.styled_line(
            StyledText(" no alerts" if alerts is not None else " no alert node", TextStyle.SECOND)
        )
    unacknowledged = sum(not each.is_acknowledged for each in alerts)
    active = sum(each.state != 4 for each in alerts)
    counts = f"{unacknowledged} unack, {active} active "
    return formatter.styled_line(
        *alert_pieces(alert, formatter, formatter.width - 24 - len(counts)), StyledText(counts, TextStyle.TEXT)
    )


def _angles(suite_state: SuiteState, view: View) -> list[Line]:
    header = f"{'':11}{'value':18}{'95 %':>10}{'limit':>7}  {'state':11} why"
    return [
        view.formatter.styled_line(StyledText(header, TextStyle.SECOND)),
        *(_angle(angle, suite_state, view) for angle in suite_state.angles),
    ]


def _angle(angle: AngleState, suite_state: SuiteState, view: View) -> Line:
    formatter = view.formatter
    number, sense = value_texts.angle_reading(angle)
    # Decimal points and signs are aligned: 034.39, 0.1, +68.74.
    value = formatter.fit(f"{formatter.clean(number):>8} {'' if number == value_texts.NO_VALUE else sense}", 18)
    accuracy = formatter.fit(value_texts.accuracy_text(angle), 10, to_right=True)
    limit = formatter.fit(value_texts.limit_text(angle.limit), 7, to_right=True)
    is_pointing = angle.name in ("azimuth", "elevation")
    why = angle.reason or (suite_state.pointing_by if is_pointing else "")
    is_chosen = view.chosen == angle.name
    name = f"{'>' if is_chosen else ' '}{angle.name.upper():10}"
    return formatter.styled_line(
        StyledText(name, TextStyle.MARKED if is_chosen else TextStyle.TEXT),
        StyledText(value.rstrip(), TextStyle.OLD if angle.is_old else TextStyle.STRONG),
        StyledText(" " * (len(value) - len(value.rstrip())), TextStyle.TEXT),
        StyledText(accuracy, TextStyle.STRONG if angle.is_old else TextStyle.TEXT),
        StyledText(f"{limit}  ", TextStyle.SECOND),
        StyledText(f"{_MARKS[angle.safety]} {angle.safety.name:7} ", _LOOKS[angle.safety]),
        StyledText(f"  {why}", TextStyle.TEXT if angle.reason else TextStyle.SECOND),
    )


def _ages(suite_state: SuiteState, formatter: LineFormatter) -> Line:
    ages = "   ".join(f"{name} {value_texts.age_text(age_s)}" for name, age_s in suite_state.ages_s.items())
    horizon = f"horizon {suite_state.horizon}" if suite_state.horizon else ""
    style, second = (TextStyle.OLD, TextStyle.OLD) if suite_state.is_old else (TextStyle.TEXT, TextStyle.SECOND)
    return formatter.styled_line(
        StyledText(" ages   ", TextStyle.SECOND),
        StyledText(ages, style),
        StyledText(" " * 7, TextStyle.TEXT),
        StyledText(horizon, second),
    )


def _sources_rule(suite_state: SuiteState, formatter: LineFormatter) -> Line:
    if suite_state.is_old:
        return formatter.rule("sources", *("old",) * bool(suite_state.sources))
    configured = [source for source in suite_state.sources if source.presence is not Presence.OFF]
    present = sum(source.presence is Presence.IN for source in configured)
    return formatter.rule("sources", f"{present} of {len(configured)} in")


def _sources(suite_state: SuiteState, view: View, room: int) -> list[Line]:
    """Return the rows of the sources that fit, including the selected source; the last row counts the other sources."""
    sources = suite_state.sources
    row_count = room if len(sources) <= room else max(room - 1, 0)
    chosen = next((place for place, source in enumerate(sources) if source.name == view.chosen), 0)
    first = max(0, chosen - row_count + 1) if row_count else 0
    window = sources[first : first + row_count]
    made = [source_line(source, suite_state, view.formatter, is_chosen=source.name == view.chosen) for source in window]
    hidden = [*sources[:first], *sources[first + row_count :]]
    counts = {
        each: sum(source.presence is each for source in hidden) for each in (Presence.OUT, Presence.IN, Presence.OFF)
    }
    parts = [
        f"{count} more {each.value if each is Presence.OUT else each.value.lower()}"
        for each, count in counts.items()
        if count
    ]
    if parts:
        style = TextStyle.OUT if counts[Presence.OUT] else TextStyle.SECOND
        made.append(view.formatter.styled_line(StyledText(f"   {', '.join(parts)}", style)))
    return made
