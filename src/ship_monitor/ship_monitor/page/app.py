"""Page of one browser: its source of data, the template, the texts of its first screen, and the panels below.

All browsers share the source of a running suite. For a bag each browser has its own source, because each browser
displays its own time.
"""

import json
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Protocol
from zoneinfo import ZoneInfo

from bokeh.core.templates import get_env
from bokeh.document import Document
from bokeh.models import Column, ColumnDataSource, CustomJS
from bokeh.models.ui import UIElement
from jinja2 import Template

from ship_monitor.page.first_screen import first_screen
from ship_monitor.page.panels import Panels
from ship_monitor.themes import THEMES, Theme
from ship_watch.history.history import History
from ship_watch.suite_state import ANGLES, SuiteStateSource
from ship_watch.value_texts import local_clock

STATIC = Path(__file__).with_name("static")
"""Folder of template, style and script of the page."""

SCRIPTS = ("bokeh", "bokeh-widgets")
"""Bokeh scripts that the page needs; the other scripts, more than half of the bytes, are not loaded."""

_ERROR_PAGE = """\
<!doctype html><html style="background:{{ theme.background }};color:{{ theme.text }}">
<meta http-equiv="refresh" content="2"><title>monitor</title>
<p>The page cannot be drawn; retrying. The reason is in the log of monitor.</p></html>
"""

TEXTS_PERIOD_MS = 500
"""Period of the updates of the texts."""

PANEL_PERIOD_MS = 20
"""Time between two steps in which panels are put into their frames."""

TEXTS_PER_PLOT_UPDATE = 2
"""Number of text updates for each update of the plots."""


class PageSource(SuiteStateSource, Protocol):
    """Interface of the page to a running suite or a bag."""

    @property
    def history(self) -> History:
        """Data of the plots."""

    def controls(self, on_move: Callable[[], None]) -> UIElement | None:
        """Return new controls to be placed under the top bar, such as the time slider of a bag; None for no controls.

        Args:
            on_move: called after the controls have changed the displayed time; the page then updates.
        """


class Page:
    """Fills and updates the document of one browser.

    Plots are made when the first of them becomes visible, one panel after another. A panel is not updated while it is
    out of sight or the page is paused. The texts of the first screen do not wait for plots.

    Args:
        document: document of the browser.
        theme: theme of the page.
        source: source of the suite's state.
        zone: time zone of the local time; None for UTC only.
    """

    def __init__(self, document: Document, theme: Theme, source: PageSource, zone: ZoneInfo | None) -> None:
        self._source, self._theme, self._zone = source, theme, zone
        self._document = document
        self._panels: Panels | None = None
        self._is_placing = False
        self._panel_column = Column(name="panels", sizing_mode="stretch_width")
        self._count = 0
        self._is_paused = False
        self._pending_angle = ""  # angle chosen by the user but not yet displayed
        self._texts = ColumnDataSource(data={"text": [self._text()]}, name="texts")
        # The page's script is called at each change; the first call shows that the link works.
        self._texts.js_on_change("data", CustomJS(code="monitor.show(JSON.parse(cb_obj.data.text[0]))"))
        self._choice = ColumnDataSource(data={}, name="chosen")
        self._choice.on_change("data", self._on_choice)
        document.js_on_event(
            "document_ready", CustomJS(args={"chosen": self._choice}, code="monitor.connected(chosen)")
        )
        controls = source.controls(self._update_texts)
        if controls is not None:
            controls.name = "controls"
            document.add_root(controls)
        self._panel_column.js_on_change("children", CustomJS(code="monitor.watchPanels(cb_obj.children[0].children)"))
        for root in (self._panel_column, self._texts, self._choice):
            document.add_root(root)
        # The page's script reports a lost link, in the colours of the theme.
        document.config.notify_connection_status = False
        document.title = f"{source.name} · monitor"
        document.template = _template()
        first = json_in_script(self._texts.data["text"][0])
        document.template_variables.update(_variables(theme, source, first))
        document.add_periodic_callback(self._update, TEXTS_PERIOD_MS)

    def _update(self) -> None:
        """Update texts and plots. Bokeh logs an exception, and the next period tries again."""
        self._update_texts()
        self._count += 1
        if self._count % TEXTS_PER_PLOT_UPDATE == 0:
            self._draw()

    def _update_texts(self) -> None:
        self._texts.data = {"text": [self._text()]}

    def _draw(self) -> None:
        if self._panels is not None and not self._is_paused:
            self._drawn_state = self._suite_state
            self._panels.update(self._source.history, self._drawn_state)

    def _make_panels(self) -> None:
        """Make the panels, and show their frames; each panel follows when it becomes visible in the browser."""
        self._update_texts()
        self._panels = Panels(self._theme, is_stepwise=True, is_bag="BAG" in self._source.label.upper())
        self._drawn_state = self._suite_state
        self._panels.update(self._source.history, self._drawn_state)
        self._panel_column.children = [self._panels.layout]

    def _place_panels(self) -> None:
        """Put one panel after another into its frame, with an update of the texts before each step."""
        if self._panels is None:
            return
        self._is_placing = False  # also if one of the next lines fails
        self._update_texts()
        self._is_placing = self._panels.place_next(self._source.history, self._drawn_state)
        if self._is_placing:
            self._document.add_timeout_callback(self._place_panels, PANEL_PERIOD_MS)

    def _text(self) -> str:
        source = self._source
        self._suite_state = source.current_state()
        local = local_clock(self._suite_state.utc_ns, self._zone)
        content = first_screen(self._suite_state, source.history, source.label, source.location, local)
        content["is_paused"] = self._is_paused or (self._panels is not None and self._panels.times.is_paused)
        return json.dumps(content, allow_nan=False)

    def _on_choice(self, _name: str, _old: Any, chosen: dict[str, list[Any]]) -> None:
        """Apply the choices of the user, sent by the page's script."""
        choice = {name: values[0] for name, values in chosen.items()}
        self._is_paused = bool(choice["paused"])
        self._pending_angle = choice["angle"] if choice["angle"] in ANGLES else self._pending_angle
        if self._panels is None and choice["wanted"]:
            self._make_panels()
        if self._panels is None:
            return
        if choice["live"]:
            self._panels.times.go_live()
            self._drawn_state = self._suite_state
        if self._pending_angle:
            self._panels.choose(self._pending_angle)
            self._pending_angle = ""
        self._panels.marked = str(choice["marked"])
        if choice["seen"] is not None:
            self._panels.visible_panels = frozenset(str(choice["seen"]).split())
        # Draw at once; a paused page keeps its time.
        self._panels.update(self._source.history, self._drawn_state)
        if not self._is_placing:
            self._is_placing = True
            self._document.add_next_tick_callback(self._place_panels)


def page_maker(
    open_source: Callable[[], PageSource], default_theme: str, zone: ZoneInfo | None = None
) -> Callable[[Document], None]:
    """Return a function that fills the document of a browser.

    Args:
        open_source: returns the source for one browser.
        default_theme: theme of a page whose address contains no theme.
        zone: time zone of the local time; None for UTC only.
    """

    def make(document: Document) -> None:
        arguments = document.session_context.request.arguments
        named = (value.decode("utf-8", "replace") for value in arguments.get("theme", ()))
        theme = THEMES[next((name for name in named if name in THEMES), default_theme)]
        try:
            Page(document, theme, open_source(), zone)
        except Exception:
            # Bokeh itself would answer with an empty white page.
            logging.getLogger(__name__).exception("a page cannot be drawn")
            document.clear()
            document.template = get_env().from_string(_ERROR_PAGE)
            document.template_variables["theme"] = theme

    return make


def json_in_script(text: str) -> str:
    """Escape JSON for use in a script of a page, so that no text in the JSON can end the script."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def colours(theme: Theme) -> str:
    """Return the colours of a theme as custom properties of CSS, for example ``--caution-word``."""
    pairs = ((name, value) for name, value in vars(theme).items() if isinstance(value, str) and name != "name")
    return "".join(f"--{name.replace('_', '-')}:{value};" for name, value in pairs)


def _variables(theme: Theme, source: PageSource, first: str) -> dict[str, Any]:
    return {
        "theme": theme,
        "themes": tuple(THEMES),
        "colours": colours(theme),
        "angles": ANGLES,
        "name": source.name,
        "first": first,
        "scripts": [f"static/js/{name}.min.js" for name in SCRIPTS],
        "css": (STATIC / "page.css").read_text(encoding="utf-8"),
        "script": (STATIC / "page.js").read_text(encoding="utf-8"),
    }


@cache
def _template() -> Template:
    template: Template = get_env().from_string((STATIC / "page.html").read_text(encoding="utf-8"))
    return template
