"""First screen of the terminal view: the state of a suite as rows, at 80 columns by 24 rows.

All states are words, so that colours are not needed. A larger terminal shows more; a too small one a single line with
the worst state.
"""

import math
from dataclasses import dataclass
from zoneinfo import ZoneInfo

from ship_monitor.terminal.pen import Ink, Line, Look, Pen
from ship_watch import words
from ship_watch.picture import AlertShown, AngleShown, InputShown, SuiteState, Presence, Priority, Safety, SourceShown

LEAST_WIDTH, LEAST_HEIGHT = 64, 15
"""Smallest terminal with a full screen; a smaller one has one line."""

EVENTS_WANTED = 6
"""Minimum number of events before inputs are shown."""

KEYS = " a acknowledge   Enter details   t theme   p pause   ? help   q quit"

_MARKS = {Safety.SAFE: "+", Safety.CAUTION: "!", Safety.UNSAFE: "x"}
_LOOKS = {Safety.SAFE: Look.SAFE, Safety.CAUTION: Look.CAUTION, Safety.UNSAFE: Look.UNSAFE}
_ALERT_MARKS = {Priority.ALARM: "/!\\", Priority.WARNING: "(!)", Priority.CAUTION: "[!]"}
_ALERT_LOOKS = {Priority.ALARM: Look.ALARM, Priority.WARNING: Look.WARNING, Priority.CAUTION: Look.NOTICE}
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
        name: name of the suite: its namespace.
        label: LIVE, BAG or SIMULATED.
        location: namespace and domain, shown while waiting for data.
        paused_s: time since the pause, s; NaN if not paused.
        chosen: name of the selected angle or source; empty for none.
        note: result of the last action, shown instead of the keys; empty for none.
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
    def pen(self) -> Pen:
        """Formatter with the width of the terminal."""
        return Pen(self.width, self.is_ascii)


def screen(suite_state: SuiteState, alerts: tuple[AlertShown, ...] | None, view: View) -> tuple[Line, ...]:
    """Return the first screen: exactly ``view.height`` lines, each as wide as the view.

    Args:
        suite_state: displayed state; an earlier one while the view is paused.
        alerts: current alerts, also while the view is paused; None without an alert node.
        view: parameters of the display.
    """
    pen = view.pen
    if view.width < LEAST_WIDTH or view.height < LEAST_HEIGHT:
        return _filled([_small_screen_line(suite_state, view)], view)
    top = [top_bar(suite_state, view), _alert_line(alerts, pen), *_waiting(suite_state, view), pen.rule()]
    middle = [*_angles(suite_state, view), pen.rule(), _ages(suite_state, pen)]
    room = view.height - len(top) - len(middle) - 3
    source_rows = min(len(suite_state.sources), max(room - 2, 1))
    input_rows = len(suite_state.inputs) if room - source_rows >= len(suite_state.inputs) + 1 + EVENTS_WANTED else 0
    bottom = [_sources_rule(suite_state, pen), *_sources(suite_state, view, source_rows)]
    if input_rows:
        bottom += [pen.rule("inputs"), *(input_line(each, pen) for each in suite_state.inputs)]
    bottom.append(pen.rule("events"))
    event_rows = view.height - len(top) - len(middle) - len(bottom) - 1
    bottom += event_lines(suite_state, pen, max(event_rows, 0))
    keys = pen.styled_line(Ink(f" {view.note}", Look.STRONG) if view.note else Ink(KEYS, Look.SECOND))
    return (*_filled([*top, *middle, *bottom], view)[: view.height - 1], keys)


def shown_alert(alerts: tuple[AlertShown, ...] | None) -> AlertShown | None:
    """Return the alert of the alert line: the most urgent unacknowledged one, else the most urgent."""
    return min(alerts or (), key=lambda alert: alert.urgency, default=None)


def selectable_names(suite_state: SuiteState) -> tuple[str, ...]:
    """Return the names of the selectable angles and sources, from top to bottom."""
    return (*(angle.name for angle in suite_state.angles), *(source.name for source in suite_state.sources))


def top_bar(suite_state: SuiteState, view: View) -> Line:
    """Return the row with name, safety and reason of the suite, and the time; PAUSED during a pause."""
    pen, overall = view.pen, suite_state.overall
    left = [Ink(" ", Look.TEXT), Ink(view.name, Look.STRONG), Ink(f"  {view.label}  ", Look.SECOND)]
    if not math.isnan(view.paused_s):
        left += [Ink(f" PAUSED {words.age_text(view.paused_s)} ago ", Look.MARKED), Ink("  ", Look.TEXT)]
    left += [
        Ink(f" {_MARKS[overall.safety]} {overall.safety.name} ", _LOOKS[overall.safety]),
        Ink(f" {overall.text}", Look.TEXT),
    ]
    local = words.local_clock(suite_state.utc_ns, view.zone)
    right = f" {local}  " if local else " "
    right += f"{words.utc_clock(suite_state.utc_ns)} UTC "
    room = max(view.width - pen.cell_count(right), 0)
    return pen.styled_line(*Pen(room, view.is_ascii).styled_line(*left), Ink(right, Look.STRONG))


def words_line(suite_state: SuiteState, pen: Pen) -> Line:
    """Return the safety of all angles in one row, for the other pages: HDG + SAFE  PIT ! CAUTION."""
    pieces = [
        piece
        for angle in suite_state.angles
        for piece in (
            Ink(f" {_SHORT_NAMES.get(angle.name, angle.name)} ", Look.SECOND),
            Ink(f"{_MARKS[angle.safety]} {angle.safety.name}", _LOOKS[angle.safety]),
            Ink(" ", Look.TEXT),
        )
    ]
    return pen.styled_line(*pieces)


def alert_pieces(alert: AlertShown, pen: Pen, text_width: int) -> list[Ink]:
    """Return icon, priority, text, time and state of an alert."""
    look = _ALERT_LOOKS[alert.priority]
    head = f" {_ALERT_MARKS[alert.priority]} {alert.priority.name} "
    text = pen.cell(alert.text or alert.id, max(text_width - len(head), 1))
    state = pen.cell(_ALERT_STATES.get(alert.state, ""), 12)
    state_look = Look.TEXT if alert.is_acknowledged else Look.STRONG
    return [Ink(head + text, look), Ink(f" {words.utc_clock(alert.raised_ns)}  ", Look.SECOND), Ink(state, state_look)]


def source_line(source: SourceShown, suite_state: SuiteState, pen: Pen, *, is_chosen: bool) -> Line:
    """Return the row of a source: presence, age, rate, reason; indented below the source that causes it.

    Without any current output the row is struck through and has no tick.
    """
    is_out = source.presence is Presence.OUT
    is_consequence = is_out and source.because_of in {each.name for each in suite_state.sources if not each.because_of}
    consistency = source.nis_consistency.text if source.nis_consistency is not None else ""
    known = [source.reason, source.disagreement] if is_out else [source.disagreement, consistency]
    if is_out and source.because_of and not is_consequence and source.because_of not in source.reason:
        known.append(f"because of {source.because_of}")
    rate = f"{source.rate_hz:7.1f} Hz" if math.isfinite(source.rate_hz) else " " * 10
    mark = "?" if suite_state.is_old and not is_out else _SOURCE_MARKS[source.presence]
    name = f"{'>' if is_chosen else ' '}{mark} {pen.cell('  ' * is_consequence + source.name, 16)}"
    middle = f" {pen.cell(words.age_text(source.age_s), 8, to_right=True)} {rate}   "
    look = Look.OUT if is_out else Look.OLD if suite_state.is_old else Look.TEXT
    second = Look.OLD if suite_state.is_old and not is_out else Look.SECOND
    return pen.styled_line(
        Ink(name, Look.MARKED if is_chosen else look),
        Ink(f" {source.presence.value:3}", look),
        Ink(middle, second),
        Ink(", ".join(filter(None, known)), look if is_out else second),
    )


def input_line(shown: InputShown, pen: Pen) -> Line:
    """Return the row of an input topic: rate, latency, age and rejections."""
    latency = f"{shown.latency_s:7.3f} s" if math.isfinite(shown.latency_s) else f"{words.NO_VALUE:>9}"
    rate = f"{shown.rate_hz:7.1f} Hz" if math.isfinite(shown.rate_hz) else f"{words.NO_VALUE:>10}"
    numbers = f"{rate} {latency} {pen.cell(words.age_text(shown.age_s), 8, to_right=True)}"
    look = Look.OUT if shown.level else Look.TEXT
    return pen.styled_line(
        Ink(f"   {pen.cell(shown.topic, 30)}", look),
        Ink(f"{numbers}  {shown.rejected_60s:4d} rejected  {reasons_text(shown)}", Look.SECOND),
    )


def reasons_text(shown: InputShown) -> str:
    """Return the reasons of rejections of an input with their counts: "gate 9, misidentified 4"."""
    return ", ".join(f"{name} {count}" for name, count in sorted(shown.reasons.items()) if count)


def event_lines(suite_state: SuiteState, pen: Pen, room: int, subject: str = "") -> list[Line]:
    """Return the rows of the newest events, all or those of one subject."""
    events = [event for event in suite_state.events if not subject or event.subject == subject]
    return [
        pen.styled_line(
            Ink(f" {words.utc_clock(event.utc_ns)}  ", Look.SECOND),
            Ink(event.text if event.kind == "alert" else f"{event.kind}: {event.text}", Look.TEXT),
        )
        for event in events[:room]
    ]


def _filled(lines: list[Line], view: View) -> tuple[Line, ...]:
    empty = view.pen.styled_line()
    return (*lines, *[empty] * (view.height - len(lines)))[: view.height]


def _small_screen_line(suite_state: SuiteState, view: View) -> Line:
    """Return the line of a too small terminal: the worst state."""
    worst = max(suite_state.angles, key=lambda angle: angle.safety, default=None)
    text = f"waiting for {suite_state.waiting_for}" if suite_state.waiting_for else ""
    if worst is not None and not text:
        names = [angle.name for angle in suite_state.angles if angle.safety is worst.safety]
        text = "all SAFE" if worst.safety is Safety.SAFE else f"{worst.safety.name} {', '.join(names)}"
    look = Look.TEXT if worst is None else _LOOKS[worst.safety]
    small = f"  {words.utc_clock(suite_state.utc_ns)}  too small: {LEAST_WIDTH} by {LEAST_HEIGHT} needed"
    return view.pen.styled_line(Ink(text, look), Ink(small, Look.SECOND))


def _waiting(suite_state: SuiteState, view: View) -> list[Line]:
    if not suite_state.waiting_for:
        return []
    text = f" waiting for {suite_state.waiting_for}: {view.location}"
    return [view.pen.styled_line(Ink(text, Look.MARKED))]


def _alert_line(alerts: tuple[AlertShown, ...] | None, pen: Pen) -> Line:
    alert = shown_alert(alerts)
    if alerts is None or alert is None:
        return pen.styled_line(Ink(" no alerts" if alerts is not None else " no alert node", Look.SECOND))
    unacknowledged = sum(not each.is_acknowledged for each in alerts)
    active = sum(each.state != 4 for each in alerts)
    counts = f"{unacknowledged} unack, {active} active "
    return pen.styled_line(*alert_pieces(alert, pen, pen.width - 24 - len(counts)), Ink(counts, Look.TEXT))


def _angles(suite_state: SuiteState, view: View) -> list[Line]:
    header = f"{'':11}{'value':18}{'95 %':>10}{'limit':>7}  {'state':11} why"
    return [view.pen.styled_line(Ink(header, Look.SECOND)), *(_angle(angle, suite_state, view) for angle in suite_state.angles)]


def _angle(angle: AngleShown, suite_state: SuiteState, view: View) -> Line:
    pen = view.pen
    number, sense = words.angle_reading(angle)
    # Decimal points and signs are aligned: 034.39, 0.1, +68.74.
    value = pen.cell(f"{pen.clean(number):>8} {'' if number == words.NO_VALUE else sense}", 18)
    accuracy = pen.cell(words.accuracy_text(angle), 10, to_right=True)
    limit = pen.cell(words.limit_text(angle.limit), 7, to_right=True)
    is_pointing = angle.name in ("azimuth", "elevation")
    why = angle.reason or (suite_state.pointing_by if is_pointing else "")
    is_chosen = view.chosen == angle.name
    name = f"{'>' if is_chosen else ' '}{angle.name.upper():10}"
    return pen.styled_line(
        Ink(name, Look.MARKED if is_chosen else Look.TEXT),
        Ink(value.rstrip(), Look.OLD if angle.is_old else Look.STRONG),
        Ink(" " * (len(value) - len(value.rstrip())), Look.TEXT),
        Ink(accuracy, Look.STRONG if angle.is_old else Look.TEXT),
        Ink(f"{limit}  ", Look.SECOND),
        Ink(f"{_MARKS[angle.safety]} {angle.safety.name:7} ", _LOOKS[angle.safety]),
        Ink(f"  {why}", Look.TEXT if angle.reason else Look.SECOND),
    )


def _ages(suite_state: SuiteState, pen: Pen) -> Line:
    ages = "   ".join(f"{name} {words.age_text(age_s)}" for name, age_s in suite_state.ages_s.items())
    horizon = f"horizon {suite_state.horizon}" if suite_state.horizon else ""
    look, second = (Look.OLD, Look.OLD) if suite_state.is_old else (Look.TEXT, Look.SECOND)
    return pen.styled_line(Ink(" ages   ", Look.SECOND), Ink(ages, look), Ink(" " * 7, Look.TEXT), Ink(horizon, second))


def _sources_rule(suite_state: SuiteState, pen: Pen) -> Line:
    if suite_state.is_old:
        return pen.rule("sources", *("old",) * bool(suite_state.sources))
    configured = [source for source in suite_state.sources if source.presence is not Presence.OFF]
    present = sum(source.presence is Presence.IN for source in configured)
    return pen.rule("sources", f"{present} of {len(configured)} in")


def _sources(suite_state: SuiteState, view: View, room: int) -> list[Line]:
    """Return the rows of the sources that fit, including the selected one; the last row counts the others."""
    sources = suite_state.sources
    shown = room if len(sources) <= room else max(room - 1, 0)
    chosen = next((place for place, source in enumerate(sources) if source.name == view.chosen), 0)
    first = max(0, chosen - shown + 1) if shown else 0
    window = sources[first : first + shown]
    made = [source_line(source, suite_state, view.pen, is_chosen=source.name == view.chosen) for source in window]
    hidden = [*sources[:first], *sources[first + shown :]]
    counts = {
        each: sum(source.presence is each for source in hidden) for each in (Presence.OUT, Presence.IN, Presence.OFF)
    }
    parts = [
        f"{count} more {each.value if each is Presence.OUT else each.value.lower()}"
        for each, count in counts.items()
        if count
    ]
    if parts:
        look = Look.OUT if counts[Presence.OUT] else Look.SECOND
        made.append(view.pen.styled_line(Ink(f"   {', '.join(parts)}", look)))
    return made
