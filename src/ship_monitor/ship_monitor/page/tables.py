"""Tables of the events, the newest first, and of the inputs with their rejections."""

import math
from collections.abc import Mapping
from html import escape

from bokeh.models import Div, InlineStyleSheet

from ship_geometry.earth.time_scales import utc_text
from ship_monitor.plots.figures import NARROW, PanelBox
from ship_monitor.plots.marking import is_event_of_source, with_mark
from ship_monitor.themes import FONT, Theme
from ship_watch.suite_state import Event, InputState, Presence, SourceDetails, SuiteState

MAX_EVENTS = 16
MAX_REASONS = 4


class EventsPanel:
    """Panel with the newest events.

    Attributes:
        box: the panel.
    """

    def __init__(self, theme: Theme) -> None:
        self._table = _table(theme)
        self.box = PanelBox(theme, "Events", [self._table])

    def update(self, suite_state: SuiteState, marked: str) -> None:
        """Write the newest events; events of the marked source are highlighted."""
        events = suite_state.events[:MAX_EVENTS]
        self._table.text = f"<table>{''.join(event_row(event, marked) for event in events)}</table>"
        more = len(suite_state.events) - len(events)
        self.box.set_subtitle(f"{more} more" if more else "" if events else "no events yet")


class InputsPanel:
    """Panel with the state of each input.

    Attributes:
        box: the panel.
    """

    def __init__(self, theme: Theme) -> None:
        self._table = _table(theme)
        self.box = PanelBox(theme, "Inputs", [self._table])

    def update(self, suite_state: SuiteState, marked: str) -> None:
        """Write the inputs; rows of sources that are OUT have a cross, rows of the marked source a frame."""
        faulty_sources = {
            topic: source
            for source in suite_state.sources
            if source.presence is Presence.OUT
            for topic in source.topics
        }
        framed = {topic for source in suite_state.sources if source.name == marked for topic in source.topics}
        rows = "".join(
            input_row(input_state, faulty_sources, is_marked=input_state.topic in framed)
            for input_state in suite_state.inputs
        )
        self._table.text = f"<table class=inputs>{_HEADINGS}{rows}</table>"
        self.box.set_subtitle("" if suite_state.inputs else "no input health data")


_HEADINGS = (
    "<tr><th>topic<th class=n>rate Hz<th class='n wide'>latency s<th class=n>age s<th class=n>rejected 60 s"
    "<th class=reasons>reasons"
)


def event_row(event: Event, marked: str = "") -> str:
    """Return a row of the events; an alert is bold, an event of the marked source has a frame."""
    time = utc_text(event.utc_ns)[11:19] if event.utc_ns else ""
    text = escape(
        event.text if event.kind == "alert" or event.subject in event.text else f"{event.subject}: {event.text}"
    )
    row_class = " class=marked" if is_event_of_source(event, marked) else ""
    return f"<tr{row_class}><td class=time>{time}<td>{f'<b>{text}</b>' if event.kind == 'alert' else text}"


def input_row(state: InputState, faulty_sources: Mapping[str, SourceDetails], *, is_marked: bool = False) -> str:
    """Return the row of an input topic.

    The row shows the number of rejections in 60 s or, if larger, the consecutive rejections of a source that is OUT.

    The row is highlighted if the source is OUT due to its own fault (``because_of`` is empty).
    """
    source = faulty_sources.get(state.topic)
    rejected = state.rejected_60s
    reasons = reasons_text(state.reasons)
    if source is not None:
        reasons = f"OUT: {source.reason}" + (f"; {reasons}" if reasons != "—" else "")
        rejected = max(rejected, source.rejected_in_a_row)
    cells = (
        ("n", _number(state.rate_hz, 1)),
        ("n wide", _number(state.latency_s, 3)),
        ("n", _number(state.age_s, 1)),
        ("n", str(rejected)),
        ("reasons", reasons),
    )
    name = with_mark(f"✕ {state.topic}" if source else state.topic, is_marked)
    classes = ["guilty"] * bool(source and not source.because_of) + ["marked"] * is_marked
    row_class = f" class='{' '.join(classes)}'" if classes else ""
    return f"<tr{row_class}><td>{escape(name).replace('/', '/<wbr>')}" + "".join(
        f"<td class='{kind}'>{escape(text)}" for kind, text in cells
    )


def reasons_text(reasons: Mapping[str, int]) -> str:
    """Return reasons with their counts, the most frequent first."""
    ordered = sorted(((count, word) for word, count in reasons.items() if count), key=lambda one: (-one[0], one[1]))
    words = [f"{word.replace('_', ' ')} {count}" for count, word in ordered[:MAX_REASONS]]
    more = len(ordered) - len(words)
    return ", ".join(words) + (f", {more} more" if more else "") if words else "—"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "—"


def _table(theme: Theme) -> Div:
    css = (
        ":host{padding:0 12px;box-sizing:border-box}"
        f".bk-clearfix{{width:100%;font:13px {FONT};color:{theme.text}}}"
        "table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}"
        f"td,th{{padding:3px 10px 3px 0;border-top:1px solid {theme.grid};text-align:left;vertical-align:top}}"
        f"th{{font-weight:normal;border-top:none}}th,.time{{color:{theme.second_text};white-space:nowrap}}"
        ".n{text-align:right;white-space:nowrap;padding-right:18px}.reasons{width:45%}"
        f".guilty td{{color:{theme.caution_border};font-weight:bold}}"
        f".marked{{outline:2px solid {theme.text};outline-offset:-2px}}"
        f"{NARROW}{{.wide{{display:none}}.n{{padding-right:8px}}.reasons{{width:auto}}}}"
    )
    return Div(disable_math=True, sizing_mode="stretch_width", stylesheets=[InlineStyleSheet(css=css)])
