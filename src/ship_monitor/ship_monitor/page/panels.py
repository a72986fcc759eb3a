"""Panels below the first screen, in two columns, with the data behind the tiles; tables of events and inputs.

A panel is put into its frame when the frame becomes visible. Panels follow one at a time, so that the texts are updated
in between. A panel that is not visible is not updated; it catches up when it becomes visible.
"""

import math
from collections.abc import Callable, Collection, Mapping
from html import escape
from typing import Any

from bokeh.models import Column, Div, InlineStyleSheet

from ship_geometry.earth.time_scales import utc_text
from ship_monitor.plots.alignment_panel import AlignmentPanel
from ship_monitor.plots.budget_panel import BudgetPanel
from ship_monitor.plots.curves import TimeAxis
from ship_monitor.plots.figures import (
    NARROW,
    GrowingRows,
    PanelBox,
    batched_model_changes,
    is_event_of_source,
    tooltip_style,
    with_mark,
)
from ship_monitor.plots.innovation_panel import ErrorPanel, InnovationPanel, has_truth
from ship_monitor.plots.lights_panel import LightsPanel
from ship_monitor.plots.sky_panel import SkyPanel
from ship_monitor.themes import FONT, Theme
from ship_watch.history.history import HISTORY_S, History
from ship_watch.suite_state import Event, InputState, Presence, SourceDetails, SuiteState

MAX_EVENTS = 16
MAX_REASONS = 4

_ROWS_AT_ONCE = 1
"""Number of plots of a panel that are made in one step."""

_HEIGHTS_PX = {"innovations": 420, "error": 420, "alignment": 300, "inputs": 200}
"""Heights of frames that contain no panel yet; other frames have 260 px."""

_ONE_COLUMN = ("error", "budget", "innovations", "sky", "lights", "alignment", "events", "inputs")
"""Order of the panels on a small screen."""

_HEADINGS = (
    "<tr><th>topic<th class=n>rate Hz<th class='n wide'>latency s<th class=n>age s<th class=n>rejected 60 s"
    "<th class=reasons>reasons"
)


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


class Panels:
    """All panels of one browser.

    Args:
        theme: colours.
        is_stepwise: True to start with empty frames, which :meth:`place_next` fills.
        is_bag: True if the data are from a bag, which changes the texts about missing data.

    Attributes:
        layout: layout that the page places below its first screen.
        times: time axis of the plots.
        marked: name of the marked source; empty if no source is marked.
        visible_panels: names of the visible panels, which are drawn; None to draw all panels.
        frames: name → frame of the panel.
    """

    def __init__(self, theme: Theme, *, is_stepwise: bool = False, is_bag: bool = False) -> None:
        self.times = TimeAxis(HISTORY_S)
        self.marked = ""
        self.visible_panels: Collection[str] | None = frozenset() if is_stepwise else None
        self._innovations, self._errors = InnovationPanel(theme, self.times), ErrorPanel(theme, self.times)
        self._budget, self._events = BudgetPanel(theme, self.times), EventsPanel(theme)
        self._sky, self._lights = SkyPanel(theme, is_bag=is_bag), LightsPanel(theme)
        self._alignment, self._inputs = AlignmentPanel(theme), InputsPanel(theme)
        self._boxes = {
            "innovations": self._innovations.box,
            "error": self._errors.box,
            "budget": self._budget.box,
            "sky": self._sky.box,
            "lights": self._lights.box,
            "events": self._events.box,
            "alignment": self._alignment.box,
            "inputs": self._inputs.box,
        }
        self._plots: dict[str, GrowingRows[Any, Any]] = {
            "innovations": self._innovations.plots,
            "error": self._errors.plots,
        }
        for plots in self._plots.values():
            plots.max_new_rows = _ROWS_AT_ONCE if is_stepwise else plots.max_new_rows
        self._placed: set[str] = set()
        self.frames = {name: _frame(theme, name, box) for name, box in self._boxes.items()}
        self._grid = InlineStyleSheet(css="")
        self.layout = Column(
            children=list(self.frames.values()),
            sizing_mode="stretch_width",
            stylesheets=[self._grid, tooltip_style(theme)],
        )

    def choose(self, angle: str) -> None:
        """Show the budget and highlight the error of an angle, one of :data:`ship_watch.suite_state.ANGLES`."""
        self._budget.choose(angle)

    def update(self, history: History, suite_state: SuiteState) -> None:
        """Draw the new data in the visible panels.

        Args:
            history: data of the plots.
            suite_state: state of the suite.
        """
        for name in self._update_layout(history, suite_state):
            if self.visible_panels is None and name not in self._placed:
                self._place(name)
            if name in self._placed:
                self._draw(name, history, suite_state)

    def place_next(self, history: History, suite_state: SuiteState) -> bool:
        """Draw the next part of a visible panel; return False if there was nothing left to draw.

        The panel is put into its frame after its first part is drawn.

        A panel is drawn before it is placed: otherwise a browser could refer to models that drawing has replaced.
        """
        complete = {name for name in self._placed if name not in self._plots or self._plots[name].are_complete}
        name = next((each for each in self._update_layout(history, suite_state) if each not in complete), None)
        if name is not None:
            with batched_model_changes(self.layout):
                self._draw(name, history, suite_state)
                if name not in self._placed:
                    self._place(name)
        return name is not None

    def _place(self, name: str) -> None:
        self._placed.add(name)
        # A style that is not set again would stay in the browser.
        styles = {"grid-area": name, "min-height": "0"}
        self.frames[name].update(children=[self._boxes[name].layout], styles=styles)

    def _update_layout(self, history: History, suite_state: SuiteState) -> list[str]:
        """Update the time axis and the visible frames; return the visible panels."""
        self.times.update(suite_state.utc_ns)
        is_simulated, has_telescope = has_truth(history), bool(history.beacons)
        self.frames["error"].visible = is_simulated
        self.frames["lights"].visible = has_telescope
        self._grid.css = _grid_css(is_simulated=is_simulated, has_telescope=has_telescope)
        seen = self._boxes if self.visible_panels is None else self.visible_panels
        return [name for name in self._boxes if name in seen and self.frames[name].visible]

    def _draw(self, name: str, history: History, suite_state: SuiteState) -> None:
        marked, is_simulated = self.marked, bool(self.frames["error"].visible)
        draw: dict[str, Callable[[], Any]] = {
            "innovations": lambda: self._innovations.update(history, suite_state, marked, has_truth=is_simulated),
            "error": lambda: self._errors.update(history, self._budget.chosen_angle),
            "budget": lambda: self._budget.update(history, marked),
            "sky": lambda: self._sky.update(history, suite_state, marked),
            "lights": lambda: self._lights.update(history, suite_state, marked),
            "events": lambda: self._events.update(suite_state, marked),
            "alignment": lambda: self._alignment.update(history, marked),
            "inputs": lambda: self._inputs.update(suite_state, marked),
        }
        draw[name]()


def _frame(theme: Theme, name: str, box: PanelBox) -> Column:
    """Return a frame with the title and about the height of a panel."""
    head = PanelBox(theme, box.title, []).layout
    box.layout.styles = {"flex": "1 1 auto"}
    head.styles = {"flex": "1 1 auto"}
    head.children[0].text += "<span>Loading plots…</span>"
    return Column(
        name=name,
        children=[head],
        sizing_mode="stretch_width",
        styles={"grid-area": name, "min-height": f"{_HEIGHTS_PX.get(name, 260)}px"},
        stylesheets=[InlineStyleSheet(css=":host{align-self:stretch !important;height:auto !important}")],
    )


def _grid_css(*, is_simulated: bool, has_telescope: bool) -> str:
    """Return the grid of the panels: error and budget of an angle next to the innovations of the sources."""
    sky = ("sky", "lights" if has_telescope else "sky")
    rows = [("innovations", "budget"), ("innovations", "events"), sky, ("alignment", "alignment")]
    if is_simulated:
        rows = [("innovations", "error"), ("innovations", "budget"), sky, ("events", "alignment")]
    rows.append(("inputs", "inputs"))
    wide = " ".join(f"'{' '.join(row)}'" for row in rows)
    narrow = " ".join(f"'{name}'" for name in _ONE_COLUMN if any(name in row for row in rows))
    return (
        ":host{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:12px;padding:12px 16px;"
        f"box-sizing:border-box;grid-template-areas:{wide}}}"
        f"{NARROW}{{:host{{grid-template-columns:minmax(0,1fr);padding:8px;grid-template-areas:{narrow}}}}}"
    )
