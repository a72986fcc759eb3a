"""The panels below the first screenful, in two columns: why the tiles say what they say.

A panel that no browser shows rests: it takes what it has missed when it comes into sight.
"""

from bokeh.models import Column, InlineStyleSheet

from ship_monitor.page.alignment_panel import AlignmentPanel
from ship_monitor.page.budget_panel import BudgetPanel
from ship_monitor.page.error_panel import ErrorPanel, has_truth
from ship_monitor.page.figures import NARROW, TimePlots, tooltip_style
from ship_monitor.page.innovation_panel import InnovationPanel
from ship_monitor.page.lights_panel import LightsPanel
from ship_monitor.page.sky_panel import SkyPanel
from ship_monitor.page.tables import EventsPanel, InputsPanel
from ship_monitor.page.themes import Theme
from ship_watch.history import KEPT_S, History
from ship_watch.picture import Picture


class Panels:
    """All panels of one browser.

    Attributes:
        layout: what the page places below its first screenful.
        times: the time that the plots show; it says whether they are paused.
        budget: the panel whose angle can be chosen.
    """

    def __init__(self, theme: Theme) -> None:
        self.times = TimePlots(KEPT_S)
        self._innovations, self._errors = InnovationPanel(theme, self.times), ErrorPanel(theme, self.times)
        self._sky, self._lights = SkyPanel(theme), LightsPanel(theme)
        self.budget, self._events = BudgetPanel(theme, self.times), EventsPanel(theme)
        self._alignment, self._inputs = AlignmentPanel(theme), InputsPanel(theme)
        explained = Column(
            children=[self.budget.box.layout, self._events.box.layout], sizing_mode="stretch_width", spacing=12
        )
        self._inputs.box.layout.styles = _WHOLE_WIDTH
        self.layout = Column(
            children=[
                self._innovations.box.layout,
                self._errors.box.layout,
                self._sky.box.layout,
                self._lights.box.layout,
                explained,
                self._alignment.box.layout,
                self._inputs.box.layout,
            ],
            sizing_mode="stretch_width",
            stylesheets=[InlineStyleSheet(css=_GRID_CSS), tooltip_style(theme)],
        )

    def update(self, history: History, picture: Picture) -> None:
        """Draw what is new.

        Args:
            history: what plots draw.
            picture: what is shown of this moment.
        """
        self.times.follow(picture.utc_ns)
        is_simulated = has_truth(history)
        self._errors.box.layout.visible = is_simulated
        self._innovations.box.layout.styles = {} if is_simulated else _WHOLE_WIDTH
        self._innovations.update(history, picture, has_truth=is_simulated)
        if is_simulated:
            self._errors.update(history)
        has_telescope = bool(history.lights)
        self._lights.box.layout.visible = has_telescope
        self._sky.box.layout.styles = {} if has_telescope else _WHOLE_WIDTH
        self._sky.update(history, picture)
        self._lights.update(history, picture)
        self.budget.update(history)
        self._alignment.update(history)
        self._events.update(picture)
        self._inputs.update(picture)


def build_panels(theme: Theme) -> Panels:
    """The panels of one browser, empty as yet."""
    return Panels(theme)


_WHOLE_WIDTH = {"grid-column": "1 / -1"}

_GRID_CSS = (
    ":host{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:12px;padding:12px 16px;box-sizing:border-box}"
    f"{NARROW}{{:host{{grid-template-columns:minmax(0,1fr);padding:8px}}}}"
)
