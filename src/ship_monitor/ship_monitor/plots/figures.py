"""Common parts of the panels: figures and boxes in the colours of a theme, and the mark of a selected source.

Figures have no toolbar and no legend; a drag zooms the time axis of all plots. States, alerts and events are named
after their source. An error source of a budget is common to all instruments of a kind: one noise of stars is the noise
of all star sensors.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from html import escape
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from bokeh.core.properties import value
from bokeh.model import Model
from bokeh.models import (
    BoxZoomTool,
    Column,
    ColumnDataSource,
    DatetimeTickFormatter,
    Div,
    FixedTicker,
    GlobalInlineStyleSheet,
    HoverTool,
    InlineStyleSheet,
    LinearAxis,
    Range1d,
)
from bokeh.plotting import figure

from ship_geometry.rotations import FloatArray
from ship_monitor.plots.curves import TimeAxis, next_step
from ship_monitor.themes import FONT, Theme
from ship_watch.suite_state import Event
from ship_watch.topics import source_of_name

MARK = "▶ "
"""Prefix of names that belong to the marked source."""

_BUDGET_PREFIXES = {
    "ins": ("ins_", "interpolation"),
    "star": ("star_", "installation"),
    "reference": ("reference_",),
    "lights": ("image",),
    "encoder": ("encoder",),
    "baselines": ("rtk", "drone_attitude", "lever_arms"),
    "ship_attitude": ("ship_attitude", "ship_noise"),
    "gnss": ("ship_position",),
    "weather": ("refraction",),
}
"""Kind of a source → prefixes of its sources of error in a budget. Other sources of error belong to the hull,
the theodolite or the Earth's orientation."""


ARCSEC_PER_RAD = 3600.0 * 180.0 / np.pi
"""Arcseconds in a radian."""

NARROW = "@media (max-width: 700px)"
"""Media query of small screens, which have one column."""

_SIDE_PX = 118
_FORMULA_BEGIN = re.compile(r"(?<=\$)(?=\$)|(?<=\\)(?=[(\[])")


def belongs_to_source(name: str, source: str) -> bool:
    """True if a state or an alert belongs to a source ("star.bow.azimuth" to "star.bow"); False for source ""."""
    return bool(source) and (name == source or name.startswith(f"{source}.") or source_of_name(name) == source)


def is_event_of_source(event: Event, source: str) -> bool:
    """True if an event concerns a source: if the source is its subject or a word of its text."""
    return belongs_to_source(event.subject, source) or (
        bool(source) and re.search(rf"(?<![\w.]){re.escape(source)}(?!\w|\.\w)", event.text) is not None
    )


def is_budget_part_of(part: str, source: str) -> bool:
    """True if ``part``, an error source of a budget, belongs to the kind of ``source``, a source of the suite."""
    return part.startswith(_BUDGET_PREFIXES.get(source.partition(".")[0], ())) if source else False


def with_mark(name: str, is_marked: bool) -> str:
    """Return a name, with the prefix :data:`MARK` if ``is_marked``."""
    return MARK + name if is_marked else name


class HasFigure(Protocol):
    """An object with one plot."""

    figure: Any


Key = TypeVar("Key")
Row = TypeVar("Row", bound=HasFigure)

def empty_plot(theme: Theme, height: int, x_range: Range1d, y_range: Range1d, **options: Any) -> figure:
    """Return an empty plot."""
    tools = [BoxZoomTool(dimensions="width")] if isinstance(options.get("x_axis_type"), str) else []
    for tool in tools:
        tool.overlay.update(fill_color=theme.series[0], fill_alpha=0.15, line_color=theme.second_text, line_alpha=1.0)
    made = figure(
        height=height,
        x_range=x_range,
        y_range=y_range,
        tools=tools,
        toolbar_location=None,
        background_fill_color=theme.panel,
        border_fill_color=theme.panel,
        outline_line_color=theme.border,
        min_border_left=48,
        min_border_right=8,
        min_border_top=4,
        min_border_bottom=4,
        sizing_mode="stretch_width",
        **options,
    )
    made.title.update(text_color=theme.text, text_font=FONT, text_font_size="13px", text_font_style="normal")
    made.title.update(standoff=2, vertical_align="bottom")
    apply_theme(theme, made)
    return made


def empty_time_plot(theme: Theme, times: TimeAxis, height: int, y_range: Range1d, *, has_axis: bool) -> figure:
    """Return an empty plot with the shared time axis; a double click returns to live."""
    made = empty_plot(theme, height, times.range, y_range, x_axis_type="datetime")
    made.on_event("doubletap", lambda _event: times.go_live())
    clock = DatetimeTickFormatter(
        milliseconds="%H:%M:%S", seconds="%H:%M:%S", minsec="%H:%M:%S", minutes="%H:%M", hourmin="%H:%M", hours="%H:%M"
    )
    made.xaxis.update(formatter=clock, visible=has_axis)
    made.xaxis.ticker.desired_num_ticks = 4
    made.min_border_right = _SIDE_PX
    return made


def apply_theme(theme: Theme, made: figure) -> None:
    """Apply the colours of the theme to axes and grids of a plot."""
    for axis in made.axis:
        axis.update(axis_line_color=None, major_tick_line_color=None, minor_tick_line_color=None)
        axis.update(major_label_text_color=theme.second_text, major_label_text_font=FONT)
        axis.update(major_label_text_font_size="13px", axis_label_text_color=theme.second_text)
        axis.update(axis_label_text_font=FONT, axis_label_text_font_size="13px", axis_label_text_font_style="normal")
    made.grid.grid_line_color = theme.grid
    made.yaxis.ticker.desired_num_ticks = 4


def draw_frame(theme: Theme, made: figure, is_marked: bool, colour: str = "") -> None:
    """Draw the frame of a plot: thick and in the colour of the text if the plot is marked."""
    usual = colour or theme.border
    made.update(outline_line_color=theme.text if is_marked else usual, outline_line_width=3 if is_marked else 1)


def without_formulas(text: str) -> str:
    """Return a text that Bokeh does not draw as a TeX formula: invisible characters split the start of a formula."""
    return _FORMULA_BEGIN.sub("\u2060", text)


class SideLabels:
    """Labels at the right of a plot, at given heights."""

    def __init__(self, theme: Theme, made: figure) -> None:
        self._axis = LinearAxis(ticker=FixedTicker(ticks=[]), axis_line_color=None, minor_tick_line_color=None)
        self._axis.update(major_label_text_color=theme.text, major_label_text_font=FONT)
        self._axis.update(major_label_text_font_size="13px", major_tick_line_color=theme.second_text)
        self._axis.update(major_tick_in=0, major_tick_out=4, major_label_standoff=3)
        made.add_layout(self._axis, "right")

    def write(self, texts: Mapping[float, str]) -> None:
        """Show texts, given as height → text."""
        self._axis.ticker.ticks = sorted(texts)
        self._axis.major_label_overrides = {height: without_formulas(text) for height, text in texts.items()}


def add_hover(theme: Theme, made: figure, html: str, renderers: list[Any], *, is_line: bool = False) -> None:
    """Add a tooltip with the values of a point; for a line the pointer may be at any height.

    ``html`` refers to columns as ``@column{0.0}``.
    """
    body = f'<div style="color:{theme.text};font:13px {FONT}">@t{{%H:%M:%S}} {html}</div>'
    made.add_tools(
        HoverTool(
            tooltips=body,
            formatters={"@t": "datetime"},
            renderers=renderers,
            mode="vline" if is_line else "mouse",
            show_arrow=False,
            point_policy="snap_to_data",
        )
    )


def tooltip_style(theme: Theme) -> GlobalInlineStyleSheet:
    """Return a style of the tooltips in the colours of the theme; without this style tooltips are white."""
    return GlobalInlineStyleSheet(css=f".bk-Tooltip{{background:{theme.background};border-color:{theme.border}}}")


def narrow_height(height_px: int) -> InlineStyleSheet:
    """Return a style that sets the height of a plot on a small screen."""
    return InlineStyleSheet(
        css=f"{NARROW}{{:host{{height:{height_px}px !important;flex-basis:{height_px}px !important}}}}"
    )


def batched_model_changes(layout: Model) -> AbstractContextManager[None]:
    """Return a context for adding or removing many models; the document checks its models once, at the end."""
    made: AbstractContextManager[None] = nullcontext() if layout.document is None else layout.document.models.freeze()
    return made


def empty_source(*columns: str) -> ColumnDataSource:
    """Return a source with empty columns."""
    return ColumnDataSource({name: [] for name in columns})


def draw_texts(made: figure, source: ColumnDataSource, **options: Any) -> None:
    """Draw texts in a plot: columns ``x``, ``y`` and ``text`` of a source; ``options`` as in Bokeh's text."""
    made.text("x", "y", "text", source=source, text_font=value(FONT), text_font_size="13px", **options)


class ResidualBars:
    """Bars of residuals in a plot; the direction of a bar on the screen does not depend on the scales of the axes.

    Args:
        theme: colours.
        made: the plot.
        steps_arcsec: possible residuals of a bar of full length, arcsec.
    """

    FULL_PX = 42.0

    def __init__(self, theme: Theme, made: figure, steps_arcsec: Sequence[float]) -> None:
        self._steps = steps_arcsec
        self._bars = empty_source("x", "y", "length", "angle")
        self._renderer = made.ray(
            "x", "y", "length", "angle", length_units="screen", source=self._bars, line_color=theme.text, line_width=2.5
        )

    def draw(self, x: FloatArray, y: FloatArray, right: FloatArray, up: FloatArray, colour: str) -> float:
        """Draw a bar at each position.

        Args:
            x: positions along x, shape (n,).
            y: positions along y, shape (n,).
            right: residuals to the right, rad, shape (n,); no bar for NaN.
            up: residuals up, rad, shape (n,).
            colour: colour of the bars.

        Returns:
            Residual of a bar of full length, arcsec.
        """
        off = ARCSEC_PER_RAD * np.hypot(right, up)
        known = np.isfinite(off)
        step = next_step(float(np.max(off[known])) if known.any() else 0.0, self._steps)
        self._bars.data = {
            "x": x[known],
            "y": y[known],
            "length": self.FULL_PX / step * off[known],
            "angle": np.arctan2(up[known], right[known]),
        }
        self._renderer.glyph.line_color = colour
        return step


class GrowingRows(Generic[Key, Row]):
    """Plots below each other; ``max_new_rows`` limits the plots made in one call, because each plot takes some time.

    Args:
        box: panel of the plots.
        make: returns the plot of a key; the second argument is True for the last plot, which has the time axis.

    Attributes:
        rows: key → plot.
        max_new_rows: maximum number of plots made in one call of :meth:`grow`.
        are_complete: True if there is a plot for each key.
    """

    def __init__(self, box: "PanelBox", make: Callable[[Key, bool], Row]) -> None:
        self._box, self._make = box, make
        self._keys: list[Key] = []
        self.rows: dict[Key, Row] = {}
        self.max_new_rows = 1000
        self.are_complete = False

    def grow(self, keys: Sequence[Key]) -> dict[Key, Row]:
        """Make plots for at most ``max_new_rows`` keys without a plot, in the order of the keys; return all plots.

        If the keys have changed, all plots are made again.

        The caller draws the plots before :meth:`show`. Changes of a plot that is being sent to a browser would be lost,
        because the document does not contain the plot yet.
        """
        if list(keys) != self._keys:
            self._keys, self.rows = list(keys), {}
        for key in self._keys[len(self.rows) :][: self.max_new_rows]:
            self.rows[key] = self._make(key, key == self._keys[-1])
        return self.rows

    def show(self) -> None:
        """Put the existing plots into the panel."""
        self.are_complete = len(self.rows) == len(self._keys)
        self._box.set_children([row.figure for row in self.rows.values()])


class PanelBox:
    """A panel: title, subtitle and content.

    Attributes:
        title: title of the panel.
        layout: layout that the page places.
    """

    def __init__(self, theme: Theme, title: str, children: Sequence[Any]) -> None:
        self.title = title
        self._head = Div(
            disable_math=True, sizing_mode="stretch_width", stylesheets=[InlineStyleSheet(css=_head_css(theme))]
        )
        self.layout = Column(
            children=[self._head, *children],
            sizing_mode="stretch_width",
            stylesheets=[InlineStyleSheet(css=_panel_css(theme))],
        )
        self.set_subtitle("")

    def set_subtitle(self, text: str) -> None:
        """Set the subtitle, in small letters after the title."""
        self._head.text = f"<b>{escape(self.title)}</b><span>{escape(text)}</span>"

    def set_children(self, children: Sequence[Any]) -> None:
        """Set the content of the panel."""
        if self.layout.children[1:] != list(children):
            self.layout.children = [self._head, *children]


def _head_css(theme: Theme) -> str:
    return (
        f":host{{padding:8px 12px 4px}}.bk-clearfix{{font:13px {FONT};color:{theme.second_text}}}"
        f"b{{font-size:15px;color:{theme.text};margin-right:10px}}"
    )


def _panel_css(theme: Theme) -> str:
    return (
        f":host{{background:{theme.panel};border:1px solid {theme.border};border-radius:4px;min-width:0;"
        "box-sizing:border-box;padding-bottom:6px;align-self:stretch !important;height:auto !important}"
    )
