"""Pages of the terminal view: details of an angle, of a source or of the alerts, and help."""

import math
from textwrap import wrap

from ship_geometry.rotations import ARCSEC
from ship_monitor.terminal.screen import (
    View,
    alert_pieces,
    event_lines,
    input_line,
    reasons_text,
    safety_line,
    source_line,
    top_bar,
)
from ship_monitor.terminal.styled_text import Line, LineFormatter, StyledText, TextStyle
from ship_watch import value_texts
from ship_watch.suite_state import AlertEntry, AngleState, SourceDetails, SuiteState

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
