"""Figures and panels in the colours of a theme: no toolbar, no legend, drag zooms the time of all, nothing is white."""

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
from ship_monitor.page.curves import fixed_step
from ship_monitor.page.themes import FONT, Theme
from ship_monitor.page.trails import TimePlots

ARCSEC_PER_RAD = 3600.0 * 180.0 / np.pi
"""Arcseconds in a radian."""

NARROW = "@media (max-width: 700px)"
"""Small screens: one column, plots 180 px high."""

_SIDE_PX = 118


class HasFigure(Protocol):
    """Anything that draws into one plot."""

    figure: Any


Key = TypeVar("Key")
Row = TypeVar("Row", bound=HasFigure)

_FORMULA_BEGIN = re.compile(r"(?<=\$)(?=\$)|(?<=\\)(?=[(\[])")


def plot(theme: Theme, height: int, x_range: Range1d, y_range: Range1d, **options: Any) -> figure:
    """An empty plot."""
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
    dress(theme, made)
    return made


def time_plot(theme: Theme, times: TimePlots, height: int, y_range: Range1d, *, has_axis: bool) -> figure:
    """An empty plot along the shared time; double click returns to live."""
    made = plot(theme, height, times.range, y_range, x_axis_type="datetime")
    made.on_event("doubletap", lambda _event: times.go_live())
    clock = DatetimeTickFormatter(
        milliseconds="%H:%M:%S", seconds="%H:%M:%S", minsec="%H:%M:%S", minutes="%H:%M", hourmin="%H:%M", hours="%H:%M"
    )
    made.xaxis.update(formatter=clock, visible=has_axis)
    made.xaxis.ticker.desired_num_ticks = 4
    made.min_border_right = _SIDE_PX
    return made


def dress(theme: Theme, made: figure) -> None:
    """Give axes and grids of a plot the colours of the theme."""
    for axis in made.axis:
        axis.update(axis_line_color=None, major_tick_line_color=None, minor_tick_line_color=None)
        axis.update(major_label_text_color=theme.second_text, major_label_text_font=FONT)
        axis.update(major_label_text_font_size="13px", axis_label_text_color=theme.second_text)
        axis.update(axis_label_text_font=FONT, axis_label_text_font_size="13px", axis_label_text_font_style="normal")
    made.grid.grid_line_color = theme.grid
    made.yaxis.ticker.desired_num_ticks = 4


def frame(theme: Theme, made: figure, is_marked: bool, colour: str = "") -> None:
    """Draw the frame of a plot: thick and in the colour of the text where the plot is of what somebody has marked."""
    usual = colour or theme.border
    made.update(outline_line_color=theme.text if is_marked else usual, outline_line_width=3 if is_marked else 1)


def without_formulas(text: str) -> str:
    """Return a text that Bokeh draws letter by letter: what would begin a formula of TeX is split, unseen."""
    return _FORMULA_BEGIN.sub("\u2060", text)


class SideLabels:
    """Words at the right of a plot, at the heights of what they name."""

    def __init__(self, theme: Theme, made: figure) -> None:
        self._axis = LinearAxis(ticker=FixedTicker(ticks=[]), axis_line_color=None, minor_tick_line_color=None)
        self._axis.update(major_label_text_color=theme.text, major_label_text_font=FONT)
        self._axis.update(major_label_text_font_size="13px", major_tick_line_color=theme.second_text)
        self._axis.update(major_tick_in=0, major_tick_out=4, major_label_standoff=3)
        made.add_layout(self._axis, "right")

    def write(self, texts: Mapping[float, str]) -> None:
        """Show these words, each at its height."""
        self._axis.ticker.ticks = sorted(texts)
        self._axis.major_label_overrides = {height: without_formulas(text) for height, text in texts.items()}


def hover(theme: Theme, made: figure, html: str, renderers: list[Any], *, is_line: bool = False) -> None:
    """Show a point's figures under the pointer, of a line wherever the pointer is above or below it.

    ``html`` names columns as ``@column{0.0}``.
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
    """Tooltips in the colours of the theme, for the whole page, where Bokeh puts them; without it they are white."""
    return GlobalInlineStyleSheet(css=f".bk-Tooltip{{background:{theme.background};border-color:{theme.border}}}")


def narrow_height(height_px: int) -> InlineStyleSheet:
    """Another height of a plot on a small screen."""
    return InlineStyleSheet(
        css=f"{NARROW}{{:host{{height:{height_px}px !important;flex-basis:{height_px}px !important}}}}"
    )


def models_at_once(layout: Model) -> AbstractContextManager[None]:
    """While many models come or go: a document looks through all that it has after each, or once at the end of this."""
    made: AbstractContextManager[None] = nullcontext() if layout.document is None else layout.document.models.freeze()
    return made


def words(made: figure, source: ColumnDataSource, **options: Any) -> None:
    """Words at places of a plot: columns ``x``, ``y`` and ``text`` of a source; ``options`` as of Bokeh's text."""
    made.text("x", "y", "text", source=source, text_font=value(FONT), text_font_size="13px", **options)


class ResidualBars:
    """Bars at places of a plot, true in direction whatever the scales of its axes, and one that tells their length.

    Args:
        theme: colours.
        made: the plot.
        steps_arcsec: residuals that a bar of the full length may stand for.
    """

    FULL_PX = 42.0

    def __init__(self, theme: Theme, made: figure, steps_arcsec: Sequence[float]) -> None:
        self._steps = steps_arcsec
        self._bars = ColumnDataSource({name: [] for name in ("x", "y", "length", "angle")})
        self._renderer = made.ray(
            "x", "y", "length", "angle", length_units="screen", source=self._bars, line_color=theme.text, line_width=2.5
        )

    def draw(self, x: FloatArray, y: FloatArray, right: FloatArray, up: FloatArray, colour: str) -> float:
        """Draw a bar at each place, from what it is off to the right and up, rad; NaN has none.

        Returns:
            What the full length stands for, arcsec.
        """
        off = ARCSEC_PER_RAD * np.hypot(right, up)
        known = np.isfinite(off)
        step = fixed_step(float(np.max(off[known])) if known.any() else 0.0, self._steps)
        self._bars.data = {
            "x": x[known],
            "y": y[known],
            "length": self.FULL_PX / step * off[known],
            "angle": np.arctan2(up[known], right[known]),
        }
        self._renderer.glyph.line_color = colour
        return step


class GrowingRows(Generic[Key, Row]):
    """Plots below one another, of which few are made at a time: each takes a computer, and a browser, a while.

    Args:
        box: panel that holds them.
        make: makes the plot of a key; the last one has the axis.

    Attributes:
        at_once: most plots that are made in one call of :meth:`grow`.
        are_complete: True if there is one for each key.
    """

    def __init__(self, box: "PanelBox", make: Callable[[Key, bool], Row]) -> None:
        self._box, self._make = box, make
        self._keys: list[Key] = []
        self.rows: dict[Key, Row] = {}
        self.at_once = 1000
        self.are_complete = False

    def grow(self, keys: Sequence[Key]) -> dict[Key, Row]:
        """Make plots of keys that have none, in the order of the keys; return all that there are.

        The caller draws them, and only then shows them (:meth:`show`): what is drawn into a plot that is on its way to
        a browser would not follow it, because the document does not know the plot yet.
        """
        if list(keys) != self._keys:
            self._keys, self.rows = list(keys), {}
        for key in self._keys[len(self.rows) :][: self.at_once]:
            self.rows[key] = self._make(key, key == self._keys[-1])
        return self.rows

    def show(self) -> None:
        """Put the plots that there are into the panel."""
        self.are_complete = len(self.rows) == len(self._keys)
        self._box.hold([row.figure for row in self.rows.values()])


class PanelBox:
    """A panel: its title, what is said beside it, and what it holds.

    Attributes:
        title: its name.
        layout: what the page places.
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
        self.say("")

    def say(self, text: str) -> None:
        """Write what stands beside the title, small."""
        self._head.text = f"<b>{escape(self.title)}</b><span>{escape(text)}</span>"

    def hold(self, children: Sequence[Any]) -> None:
        """Hold other things than before."""
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
