"""Lights panel: lights on the detector of the calibration telescope in the last minute, and their last residuals."""

import math

import numpy as np
from bokeh.models import ColumnDataSource, Range1d

from ship_monitor.plots.curves import next_step, signed_text
from ship_monitor.plots.figures import (
    ARCSEC_PER_RAD,
    PanelBox,
    ResidualBars,
    draw_frame,
    draw_texts,
    empty_plot,
    empty_source,
    narrow_height,
)
from ship_monitor.themes import Theme
from ship_watch.history.history import BeaconPoint, History, points_after
from ship_watch.suite_state import SuiteState

WINDOW_NS = 60_000_000_000
STEPS_MM = (2.0, 5.0, 7.0, 10.0, 20.0, 50.0, 100.0)
BAR_STEPS_ARCSEC = (2.5, 5.0, 10.0, 25.0, 50.0, 100.0, 250.0)
"""Possible residuals of a bar of full length, arcsec."""

_MARKERS = ("circle", "square", "triangle", "diamond")


class LightsPanel:
    """Panel with the detector.

    Attributes:
        box: the panel.
    """

    def __init__(self, theme: Theme) -> None:
        self._theme = theme
        self._x, self._z = Range1d(-7.0, 7.0), Range1d(-7.0, 7.0)
        self.figure = empty_plot(
            theme, 320, self._x, self._z, x_axis_label="x, mm on the detector", y_axis_label="z, mm"
        )
        self.figure.stylesheets = [*self.figure.stylesheets, narrow_height(180)]
        self._past_points = empty_source("x", "z", "alpha", "colour", "marker")
        self._newest_points = empty_source("x", "y", "colour", "marker", "text", "ahead", "align", "over", "base")
        dots = {"size": 3, "line_color": "colour", "fill_color": None, "line_alpha": "alpha", "marker": "marker"}
        self.figure.scatter("x", "z", source=self._past_points, **dots)
        self._bars = ResidualBars(theme, self.figure, BAR_STEPS_ARCSEC)
        self._scale_bar = ColumnDataSource({"x": [0.0], "y": [0.0], "text": [""]})
        scale = {"length": ResidualBars.FULL_PX, "length_units": "screen", "angle": 0.0}
        self.figure.ray("x", "y", source=self._scale_bar, line_color=theme.second_text, line_width=2.5, **scale)
        draw_texts(self.figure, self._scale_bar, text_color=theme.second_text, y_offset=-3, text_baseline="bottom")
        newest = {"size": 12, "line_color": "colour", "fill_color": None, "line_width": 2, "marker": "marker"}
        self._newest_markers = self.figure.scatter("x", "y", source=self._newest_points, **newest)
        placing = {"x_offset": "ahead", "y_offset": "over", "text_align": "align", "text_baseline": "base"}
        draw_texts(self.figure, self._newest_points, text_color=theme.text, **placing)
        self.box = PanelBox(theme, "Lights on the detector", [self.figure])

    def update(self, history: History, suite_state: SuiteState, marked: str) -> None:
        """Draw the last minute; the lights are highlighted if ``marked`` is "lights"."""
        draw_frame(self._theme, self.figure, marked == "lights")
        self._newest_markers.glyph.line_width = 4 if marked == "lights" else 2
        recent_points = {
            name: recent
            for name, points in sorted(history.beacons.items())
            if (recent := points_after(points, suite_state.utc_ns - WINDOW_NS))
        }
        if not recent_points:
            for source in (self._past_points, self._newest_points, self._scale_bar):
                source.data = {name: [] for name in source.data}
            self._bars.draw(*(np.empty(0),) * 4, self._theme.text)
            self.box.set_subtitle("no lights in the last 60 s")
            return
        places = [
            1e3 * abs(place) for points in recent_points.values() for point in points for place in (point.x, point.z)
        ]
        half = next_step(1.05 * max(places), STEPS_MM)
        for side in (self._x, self._z):
            side.update(start=-half, end=half)
        self._draw_past(recent_points, suite_state.utc_ns)
        self._draw_last(recent_points, half)
        self.box.set_subtitle("last 60 s · bar at a light: its residual")

    def _draw_past(self, recent_points: dict[str, list[BeaconPoint]], utc_ns: int) -> None:
        columns: dict[str, list[object]] = {name: [] for name in self._past_points.data}
        for index, points in enumerate(recent_points.values()):
            columns["x"] += [1e3 * point.x for point in points]
            columns["z"] += [1e3 * point.z for point in points]
            columns["alpha"] += [1.0 - 0.8 * (utc_ns - point.utc_ns) / WINDOW_NS for point in points]
            columns["colour"] += [
                self._colour(index) if point.is_used else self._theme.caution_border for point in points
            ]
            columns["marker"] += [_MARKERS[index % len(_MARKERS)] if point.is_used else "x" for point in points]
        self._past_points.data = columns

    def _draw_last(self, recent_points: dict[str, list[BeaconPoint]], half: float) -> None:
        now: dict[str, list[object]] = {name: [] for name in self._newest_points.data}
        for index, (name, points) in enumerate(recent_points.items()):
            point = points[-1]
            text = f"light {name}"
            if math.isfinite(point.x_residual):
                right, up = (signed_text(ARCSEC_PER_RAD * off) for off in (point.x_residual, point.z_residual))
                text += f"  x {right}″  z {up}″"
            is_right, is_high = 1e3 * point.x > 0.2 * half, 1e3 * point.z > 0.5 * half
            row = {
                "x": 1e3 * point.x,
                "y": 1e3 * point.z,
                "colour": self._colour(index) if point.is_used else self._theme.caution_border,
                "marker": _MARKERS[index % len(_MARKERS)] if point.is_used else "x",
                "text": text if point.is_used else f"✕ {text} rejected",
                "ahead": 12 if is_right else -12,
                "align": "right" if is_right else "left",
                "over": 14 if is_high else -14,
                "base": "top" if is_high else "bottom",
            }
            for key, value in row.items():
                now[key].append(value)
        self._newest_points.data = now
        last = [points[-1] for points in recent_points.values()]
        residuals = (np.array([point.x_residual for point in last]), np.array([point.z_residual for point in last]))
        step = self._bars.draw(np.array(now["x"]), np.array(now["y"]), *residuals, self._theme.text)
        self._scale_bar.data = {"x": [-0.95 * half], "y": [-0.93 * half], "text": [f"{step:g}″"]}

    def _colour(self, index: int) -> str:
        return self._theme.series[index % len(self._theme.series)]
