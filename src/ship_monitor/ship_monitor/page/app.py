"""One page for each browser: the template, the texts of its first screenful, and the panels below."""

import json
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from bokeh.core.templates import get_env
from bokeh.document import Document
from bokeh.models import Column, ColumnDataSource, CustomJS
from jinja2 import Template

from ship_monitor.page.panels import Panels, build_panels
from ship_monitor.page.picture_source import PictureSource
from ship_monitor.page.shown import shown
from ship_monitor.page.themes import THEMES, Theme
from ship_watch.picture import ANGLES
from ship_watch.words import local_clock

STATIC = Path(__file__).with_name("static")
"""Template, style and script of the page."""

SCRIPTS = ("bokeh", "bokeh-widgets")
"""Those of Bokeh's scripts that the page needs: four of six megabytes are for others."""

_TRIED_AGAIN = """\
<!doctype html><html style="background:{{ theme.background }};color:{{ theme.text }}">
<meta http-equiv="refresh" content="2"><title>monitor</title>
<p>The page cannot be drawn now; it is tried again. The log of the monitor says why.</p></html>
"""

TEXTS_PERIOD_MS = 500
PLACE_PERIOD_MS = 20
"""Time between two panels that are put into their frames."""

PLOTS_EVERY = 2
"""Plots are told something every so many times that the texts are."""


class Page:
    """Fills the document of one browser, and keeps it up to date.

    Plots are made when the first of them come into sight, one panel after another, and each rests while it is out of
    sight or paused; the texts of the first screenful wait for none of them.

    Args:
        document: of the browser.
        theme: in which it is drawn.
        source: of the pictures.
        zone: of the local time; None for UTC alone.
    """

    def __init__(self, document: Document, theme: Theme, source: PictureSource, zone: ZoneInfo | None) -> None:
        self._source, self._theme, self._zone = source, theme, zone
        self._document = document
        self._panels: Panels | None = None
        self._is_placing = False
        self._below = Column(name="panels", sizing_mode="stretch_width")
        self._count = 0
        self._is_paused = False
        self._angle = ""  # chosen, and not yet shown
        self._texts = ColumnDataSource(data={"text": [self._text()]}, name="texts")
        # The page's script is told by each change, and by the first one that the link is there.
        self._texts.js_on_change("data", CustomJS(code="monitor.show(JSON.parse(cb_obj.data.text[0]))"))
        self._chosen = ColumnDataSource(data={}, name="chosen")
        self._chosen.on_change("data", self._choose)
        document.js_on_event(
            "document_ready", CustomJS(args={"chosen": self._chosen}, code="monitor.connected(chosen)")
        )
        controls = source.controls(self._say)
        if controls is not None:
            controls.name = "controls"
            document.add_root(controls)
        self._below.js_on_change("children", CustomJS(code="monitor.watchPanels(cb_obj.children[0].children)"))
        for root in (self._below, self._texts, self._chosen):
            document.add_root(root)
        # The page says itself that the link is lost, in its own colours.
        document.config.notify_connection_status = False
        document.title = f"{source.name} · monitor"
        document.template = _template()
        first = json_in_script(self._texts.data["text"][0])
        document.template_variables.update(_variables(theme, source, first))
        document.add_periodic_callback(self._update, TEXTS_PERIOD_MS)

    def _update(self) -> None:
        """Say and draw what is new. An error leaves the page without news, and it then says so itself."""
        self._say()
        self._count += 1
        if self._count % PLOTS_EVERY == 0:
            self._draw()

    def _say(self) -> None:
        self._texts.data = {"text": [self._text()]}

    def _draw(self) -> None:
        if self._panels is not None and not self._is_paused:
            self._drawn = self._picture
            self._panels.update(self._source.history, self._drawn)

    def _make_panels(self) -> None:
        """Make the panels, and show their frames; each panel follows when the browser says that it is in sight."""
        self._say()
        self._panels = build_panels(self._theme, is_stepwise=True, is_bag="BAG" in self._source.label.upper())
        self._drawn = self._picture
        self._panels.update(self._source.history, self._drawn)
        self._below.children = [self._panels.layout]

    def _place_panels(self) -> None:
        """Put one panel after another into its frame; before each step the page has its texts of now."""
        if self._panels is None:
            return
        self._is_placing = False  # also where one of the next lines fails
        self._say()
        self._is_placing = self._panels.place_next(self._source.history, self._drawn)
        if self._is_placing:
            self._document.add_timeout_callback(self._place_panels, PLACE_PERIOD_MS)

    def _text(self) -> str:
        source = self._source
        self._picture = source.look()
        local = local_clock(self._picture.utc_ns, self._zone)
        told = shown(self._picture, source.history, source.label, source.place, local)
        told["is_paused"] = self._is_paused or (self._panels is not None and self._panels.times.is_paused)
        return json.dumps(told, allow_nan=False)

    def _choose(self, _name: str, _old: Any, chosen: dict[str, list[Any]]) -> None:
        """Follow what the person at the browser has chosen; see ``tell`` of the page's script."""
        choice = {name: values[0] for name, values in chosen.items()}
        self._is_paused = bool(choice["paused"])
        self._angle = choice["angle"] if choice["angle"] in ANGLES else self._angle
        if self._panels is None and choice["wanted"]:
            self._make_panels()
        if self._panels is None:
            return
        if choice["live"]:
            self._panels.times.go_live()
            self._drawn = self._picture
        if self._angle:
            self._panels.choose(self._angle)
            self._angle = ""
        self._panels.marked = str(choice["marked"])
        if choice["seen"] is not None:
            self._panels.seen = frozenset(str(choice["seen"]).split())
        # At once, and of a page that is paused the time at which it is.
        self._panels.update(self._source.history, self._drawn)
        if not self._is_placing:
            self._is_placing = True
            self._document.add_next_tick_callback(self._place_panels)


def page_maker(
    open_source: Callable[[], PictureSource], default_theme: str, zone: ZoneInfo | None = None
) -> Callable[[Document], None]:
    """Return a function that fills the document of each browser.

    Args:
        open_source: gives the source of pictures of one browser.
        default_theme: where the address names none.
        zone: of the local time that stands beside UTC; None for UTC alone.
    """

    def make(document: Document) -> None:
        arguments = document.session_context.request.arguments
        named = (value.decode("utf-8", "replace") for value in arguments.get("theme", ()))
        theme = THEMES[next((name for name in named if name in THEMES), default_theme)]
        try:
            Page(document, theme, open_source(), zone)
        except Exception:
            # Bokeh's own answer is an empty white page.
            logging.getLogger(__name__).exception("a page cannot be drawn")
            document.clear()
            document.template = get_env().from_string(_TRIED_AGAIN)
            document.template_variables["theme"] = theme

    return make


def json_in_script(text: str) -> str:
    """JSON that may stand inside a script of a page: no text in it can end the script."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def colours(theme: Theme) -> str:
    """The colours of a theme as custom properties of CSS: ``--caution-word`` and the like."""
    pairs = ((name, value) for name, value in vars(theme).items() if isinstance(value, str) and name != "name")
    return "".join(f"--{name.replace('_', '-')}:{value};" for name, value in pairs)


def _variables(theme: Theme, source: PictureSource, first: str) -> dict[str, Any]:
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
    """The template, with Bokeh's macros at hand."""
    template: Template = get_env().from_string((STATIC / "page.html").read_text(encoding="utf-8"))
    return template
