"""The panels below the first screenful, in two columns: why the tiles say what they say.

A panel that is out of sight rests: it takes what it has missed when it comes into sight.
"""

from collections.abc import Callable, Collection
from typing import Any

from bokeh.models import Column, InlineStyleSheet

from ship_monitor.page.alignment_panel import AlignmentPanel
from ship_monitor.page.budget_panel import BudgetPanel
from ship_monitor.page.error_panel import ErrorPanel, has_truth
from ship_monitor.page.figures import NARROW, tooltip_style
from ship_monitor.page.innovation_panel import InnovationPanel
from ship_monitor.page.lights_panel import LightsPanel
from ship_monitor.page.sky_panel import SkyPanel
from ship_monitor.page.tables import EventsPanel, InputsPanel
from ship_monitor.page.themes import Theme
from ship_monitor.page.trails import TimePlots
from ship_watch.history import KEPT_S, History
from ship_watch.picture import Picture


class Panels:
    """All panels of one browser.

    Attributes:
        layout: what the page places below its first screenful.
        times: the time that the plots show; it says whether they are paused.
        marked: name of the source that somebody has marked; empty for none.
        seen: names of the panels in sight, which are drawn; None before that is known: all are.
    """

    def __init__(self, theme: Theme) -> None:
        self.times = TimePlots(KEPT_S)
        self.marked = ""
        self.seen: Collection[str] | None = None
        self._innovations, self._errors = InnovationPanel(theme, self.times), ErrorPanel(theme, self.times)
        self._budget, self._events = BudgetPanel(theme, self.times), EventsPanel(theme)
        self._sky, self._lights = SkyPanel(theme), LightsPanel(theme)
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
        for name, box in self._boxes.items():
            box.layout.update(name=name, styles={"grid-area": name})
        self._grid = InlineStyleSheet(css="")
        self.layout = Column(
            children=[box.layout for box in self._boxes.values()],
            sizing_mode="stretch_width",
            stylesheets=[self._grid, tooltip_style(theme)],
        )

    def choose(self, angle: str) -> None:
        """Show the budget and the error of an angle, one of :data:`ship_watch.picture.ANGLES`."""
        self._budget.choose(angle)

    def update(self, history: History, picture: Picture) -> None:
        """Draw what is new in the panels in sight.

        Args:
            history: what plots draw.
            picture: what is shown of this moment.
        """
        self.times.follow(picture.utc_ns)
        is_simulated, has_telescope = has_truth(history), bool(history.lights)
        self._errors.box.layout.visible = is_simulated
        self._lights.box.layout.visible = has_telescope
        self._grid.css = _grid_css(is_simulated=is_simulated, has_telescope=has_telescope)
        marked = self.marked
        draw: dict[str, Callable[[], Any]] = {
            "innovations": lambda: self._innovations.update(history, picture, marked, has_truth=is_simulated),
            "error": lambda: self._errors.update(history, self._budget.chosen),
            "budget": lambda: self._budget.update(history, marked),
            "sky": lambda: self._sky.update(history, picture, marked),
            "lights": lambda: self._lights.update(history, picture, marked),
            "events": lambda: self._events.update(picture, marked),
            "alignment": lambda: self._alignment.update(history, marked),
            "inputs": lambda: self._inputs.update(picture, marked),
        }
        for name, draw_one in draw.items():
            if (self.seen is None or name in self.seen) and self._boxes[name].layout.visible:
                draw_one()


def build_panels(theme: Theme) -> Panels:
    """The panels of one browser, empty as yet."""
    return Panels(theme)


_ONE_COLUMN = ("error", "budget", "innovations", "sky", "lights", "alignment", "events", "inputs")
"""The order on a small screen."""


def _grid_css(*, is_simulated: bool, has_telescope: bool) -> str:
    """Where the panels stand: error and budget of an angle are seen at once, and beside them who is to blame."""
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
