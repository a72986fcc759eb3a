"""One page for each browser: the template, the texts of its first screenful, and the panels below."""

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from bokeh.core.templates import get_env
from bokeh.document import Document
from bokeh.models import ColumnDataSource, CustomJS
from bokeh.models.ui import UIElement
from jinja2 import Template

from ship_monitor.page.picture_source import PictureSource
from ship_monitor.page.shown import shown
from ship_monitor.page.themes import THEMES, Theme
from ship_watch.history import History
from ship_watch.picture import ANGLES, Picture

STATIC = Path(__file__).with_name("static")
"""Template, style and script of the page."""

TEXTS_PERIOD_MS = 500
PLOTS_EVERY = 2
"""Plots are told something every so many times that the texts are."""


class Panels(Protocol):
    """The plots below the first screenful, made for one browser.

    A panel that is tagged ``wide`` (``tags=["wide"]``) takes both columns.
    """

    @property
    def layout(self) -> Sequence[UIElement]:
        """The panels, in reading order."""
        ...

    def update(self, history: History, picture: Picture) -> None:
        """Draw what is new. Called once a second while the page is open, its plots wanted and not paused."""
        ...

    def choose(self, angle: str, source: str) -> None:
        """Show the budget and error of an angle, and mark a source in every panel; empty where none is marked."""
        ...


class Page:
    """Fills the document of one browser, and keeps it up to date.

    Args:
        document: of the browser.
        theme: in which it is drawn.
        source: of the pictures.
        panels: what is drawn below.
    """

    def __init__(self, document: Document, theme: Theme, source: PictureSource, panels: Panels | None) -> None:
        self._source, self._panels = source, panels
        self._count = 0
        self._wants_plots = True
        self._texts = ColumnDataSource(data={"text": [self._text()]}, name="texts")
        # The page's script is told by each change, and by the first one that the link is there.
        self._texts.js_on_change("data", CustomJS(code="monitor.show(JSON.parse(cb_obj.data.text[0]))"))
        self._chosen = ColumnDataSource(data={}, name="chosen")
        self._chosen.on_change("data", self._choose)
        document.js_on_event(
            "document_ready", CustomJS(args={"chosen": self._chosen}, code="monitor.connected(chosen)")
        )
        controls = source.controls()
        if controls is not None:
            controls.name = "controls"
            document.add_root(controls)
        for panel in panels.layout if panels is not None else ():
            document.add_root(panel)
        document.add_root(self._texts)
        document.add_root(self._chosen)
        # The page says itself that the link is lost, in its own colours.
        document.config.notify_connection_status = False
        document.title = f"{source.name} · monitor"
        document.template = _template()
        document.template_variables.update(_variables(theme, source, json_in_script(self._texts.data["text"][0])))
        document.template_variables["scripts"] = scripts(document)
        document.add_periodic_callback(self.update, TEXTS_PERIOD_MS)

    def update(self) -> None:
        """Say what is new. An error leaves the page without news, and it then says so itself."""
        self._texts.data = {"text": [self._text()]}
        self._count += 1
        if self._panels is not None and self._wants_plots and self._count % PLOTS_EVERY == 0:
            self._panels.update(self._source.history, self._picture)

    def _text(self) -> str:
        self._picture = self._source.look()
        source = self._source
        return json.dumps(shown(self._picture, source.history, source.label, source.place), allow_nan=False)

    def _choose(self, _name: str, _old: Any, chosen: dict[str, list[Any]]) -> None:
        self._wants_plots = bool(chosen["plots"][0]) and not chosen["paused"][0]
        if self._panels is not None:
            self._panels.choose(str(chosen["angle"][0]), str(chosen["source"][0]))


def page_maker(
    open_source: Callable[[], PictureSource], build_panels: Callable[[Theme], Panels] | None, default_theme: str
) -> Callable[[Document], None]:
    """What fills the document of each browser.

    Args:
        open_source: gives the source of pictures of one browser.
        build_panels: makes the panels of one browser.
        default_theme: where the address names none.
    """

    def make(document: Document) -> None:
        arguments = document.session_context.request.arguments
        named = (value.decode("utf-8", "replace") for value in arguments.get("theme", ()))
        theme = THEMES[next((name for name in named if name in THEMES), default_theme)]
        Page(document, theme, open_source(), None if build_panels is None else build_panels(theme))

    return make


def json_in_script(text: str) -> str:
    """JSON that may stand inside a script of a page: no text in it can end the script."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def colours(theme: Theme) -> str:
    """The colours of a theme as custom properties of CSS: ``--caution-word`` and the like."""
    pairs = ((name, value) for name, value in vars(theme).items() if isinstance(value, str) and name != "name")
    return "".join(f"--{name.replace('_', '-')}:{value};" for name, value in pairs)


def scripts(document: Document) -> list[str]:
    """Those of Bokeh's scripts that the models of a document need: four of five megabytes are for others."""
    modules = {type(model).__module__ for model in document.models}
    parts = [""]
    if any(module.startswith("bokeh.models.widgets") for module in modules):
        parts.append("-widgets")
    if any(module.startswith("bokeh.models.widgets.tables") for module in modules):
        parts.append("-tables")
    return [f"static/js/bokeh{part}.min.js" for part in parts]


def _variables(theme: Theme, source: PictureSource, first: str) -> dict[str, Any]:
    return {
        "theme": theme,
        "themes": tuple(THEMES),
        "colours": colours(theme),
        "angles": ANGLES,
        "name": source.name,
        "first": first,
        "css": (STATIC / "page.css").read_text(encoding="utf-8"),
        "script": (STATIC / "page.js").read_text(encoding="utf-8"),
    }


@cache
def _template() -> Template:
    """The template, with Bokeh's macros at hand."""
    template: Template = get_env().from_string((STATIC / "page.html").read_text(encoding="utf-8"))
    return template
