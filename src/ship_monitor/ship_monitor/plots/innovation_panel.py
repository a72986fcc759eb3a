"""Innovation panel and error panel: differences over time, with the band of ±3 sigma.

Innovations are measured minus predicted values by source. A dot or square is the mean innovation of a measurement along
one axis; a cross is that of a rejected measurement. The times during which a source was OUT are shaded. Errors are
those of each angle against the truth, only in simulation, where a truth is known.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import islice

import numpy as np
from bokeh.models import ColumnDataSource, Range1d

from ship_geometry.rotations import FloatArray
from ship_monitor.plots.curves import (
    BAND,
    MS,
    STEPS_ARCSEC,
    StreamedLine,
    TimeAxis,
    label_positions,
    next_step,
    signed_text,
    three_sigma_band,
)
from ship_monitor.plots.figures import (
    ARCSEC_PER_RAD,
    GrowingRows,
    PanelBox,
    SideLabels,
    add_hover,
    draw_frame,
    empty_source,
    empty_time_plot,
    with_mark,
    without_formulas,
)
from ship_monitor.themes import Theme
from ship_watch.history.history import ErrorPoint, History, InnovationPoint, points_after
from ship_watch.suite_state import Presence, SourceDetails, SuiteState

CHANNELS: Mapping[tuple[str, str], str] = {
    ("ship/error_arcsec", "heading"): "heading",
    ("ship/error_arcsec", "pitch"): "pitch",
    ("ship/error_arcsec", "roll"): "roll",
    ("theodolite/error_arcsec", "azimuth_cos_elevation"): "azimuth · cos elevation",
    ("theodolite/error_arcsec", "elevation"): "elevation",
}
"""Topic and channel → title of a plot."""

STATISTICS_WINDOW_NS = 60_000_000_000
"""Window of the statistics written at a plot, ns."""

AXIS_WINDOW_NS = 15_000_000_000
"""Window whose values determine the height of a plot, ns: earlier values, for example after a start, may be cut off."""


MEAN_WINDOW_NS = 10_000_000_000
"""Window of the means at a plot, ns; the height of the plot is determined by the last six windows."""

AXES_DRAWN = (("up", "z"), ("right", "x"))
"""Drawn axes of star sensors and lights, one marker each; rotations about the boresight are far less accurate."""

_MARKERS = (("circle", "●"), ("square", "■"))


def has_truth(history: History) -> bool:
    """True if any of the newest errors is known."""
    for points in history.errors.values():
        if any(np.isfinite(error) for point in islice(reversed(points), 20) for error in point.error.values()):
            return True
    return False


class ErrorPanel:
    """Panel with a plot for each angle that has an error.

    Attributes:
        box: the panel; hidden without truth.
        plots: plots, one for each angle.
    """

    def __init__(self, theme: Theme, times: TimeAxis) -> None:
        self.box = PanelBox(theme, "Error inside ±3σ", [])
        self.plots: GrowingRows[tuple[str, str], _ErrorRow] = GrowingRows(
            self.box, lambda key, is_last: _ErrorRow(theme, times, key, has_axis=is_last)
        )

    def update(self, history: History, chosen: str) -> None:
        """Draw the new points.

        Args:
            history: history with the errors.
            chosen: highlighted angle; empty for no angle.
        """
        newest = {topic: points[-1].error for topic, points in history.errors.items() if points}
        keys = [key for key in CHANNELS if key[1] in newest.get(key[0], {})]
        rows = self.plots.grow(keys)
        steps = {row.update(history.errors[topic], chosen) for (topic, _), row in rows.items()}
        self.plots.show()
        steps.discard(15.0)
        wider = " · wider where stated" if steps else ""
        self.box.set_subtitle(f"against the truth of the simulation · axis ±15″{wider}")


class _Row:
    """Plot over time with bands of ±3 sigma; the height is symmetric about zero."""

    def __init__(self, theme: Theme, times: TimeAxis, height_px: int, *, has_axis: bool) -> None:
        self._theme, self._height = theme, Range1d(-15.0, 15.0)
        self.figure = empty_time_plot(theme, times, height_px, self._height, has_axis=has_axis)
        self._labels = SideLabels(theme, self.figure)

    def _draw_band(self, source: ColumnDataSource, colour: str, fill_alpha: float, line_alpha: float) -> None:
        self.figure.varea("t", "low", "high", source=source, fill_color=colour, fill_alpha=fill_alpha)
        line = {"line_color": colour, "line_dash": "dashed", "line_alpha": line_alpha}
        for edge in BAND[2:]:
            self.figure.line("t", edge, source=source, **line)


class _ErrorRow(_Row):
    """Plot of one angle."""

    def __init__(self, theme: Theme, times: TimeAxis, key: tuple[str, str], *, has_axis: bool) -> None:
        super().__init__(theme, times, 88 if has_axis else 66, has_axis=has_axis)
        self._channel, self._title = key[1], CHANNELS[key]
        self._trail = StreamedLine(("error", "sigma", *BAND), by="error", filled=BAND[:2])
        self._draw_band(self._trail.source, theme.series[0], 0.18, 1.0)
        line = self.figure.line("t", "error", source=self._trail.source, line_color=theme.text, line_width=1.2)
        add_hover(theme, self.figure, "@error{+0.0}″, σ @sigma{0.0}″", [line], is_line=True)

    def update(self, points: Sequence[ErrorPoint], chosen: str) -> float:
        """Draw the new points; return half the height of the axis, arcsec."""
        self._trail.stream_new(points, self._columns)
        newest_ns = points[-1].utc_ns
        error, sigma = self._finite_values(points_after(points, newest_ns - STATISTICS_WINDOW_NS))
        rms = float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")
        mean_sigma = float(np.mean(sigma)) if len(sigma) else float("nan")
        now, sigma_now = self._finite_values(points_after(points, newest_ns - AXIS_WINDOW_NS))
        largest = max(
            (float(np.quantile(np.abs(some), 0.9)) for some in (now, 3.0 * sigma_now) if len(some)), default=0.0
        )
        step = next_step(largest)
        self._height.update(start=-step, end=step)
        is_chosen = bool(chosen) and self._channel.startswith(chosen)
        self.figure.title.text = with_mark(self._title, is_chosen) + (f" · axis ±{step:g}″" if step > 15.0 else "")
        draw_frame(self._theme, self.figure, is_chosen)
        self._labels.write({0.35 * step: f"rms {rms:.1f}″", -0.35 * step: f"σ {mean_sigma:.1f}″"})
        return step

    def _finite_values(self, points: Sequence[ErrorPoint]) -> tuple[FloatArray, FloatArray]:
        """Return the finite errors and sigmas, arcsec."""
        columns = self._columns(points)
        error, sigma = columns["error"], columns["sigma"]
        return error[np.isfinite(error)], sigma[np.isfinite(sigma)]

    def _columns(self, points: Sequence[ErrorPoint]) -> dict[str, FloatArray]:
        error = np.array([point.error.get(self._channel, np.nan) for point in points], float)
        sigma = np.array([point.sigma.get(self._channel, np.nan) for point in points], float)
        return {"error": error, "sigma": sigma, **three_sigma_band(sigma)}


class InnovationPanel:
    """Panel with a plot for each source with innovations.

    Attributes:
        box: the panel.
        plots: plots, one for each source.
    """

    def __init__(self, theme: Theme, times: TimeAxis) -> None:
        self.box = PanelBox(theme, "Innovations by source", [])
        self.plots: GrowingRows[str, _SourceRow] = GrowingRows(
            self.box, lambda name, is_last: _SourceRow(theme, times, name, has_axis=is_last)
        )

    def update(self, history: History, suite_state: SuiteState, marked: str, *, has_truth: bool) -> None:
        """Draw the new points; the subtitle states if there is no truth.

        Args:
            history: history with the innovations.
            suite_state: state with the sources.
            marked: marked source; empty if no source is marked.
            has_truth: True if the errors against truth are known.
        """
        sources = {source.name: source for source in suite_state.sources}
        names = [name for name, points in history.innovations.items() if any(point.axes for point in points)]
        names.sort(key=lambda name: (not name.startswith("star"), name))
        rows = self.plots.grow(names)
        for name, row in rows.items():
            row.update(history.innovations[name], sources.get(name), suite_state.utc_ns, is_marked=name == marked)
        self.plots.show()
        nothing = "" if rows else "no innovations yet. "
        markers = "means, ″ · ● up, z · ■ right, x · ✕ rejected"
        self.box.set_subtitle(nothing + (markers if has_truth else f"no truth data, errors unknown · {markers}"))


class _SourceRow(_Row):
    """Plot of one source."""

    def __init__(self, theme: Theme, times: TimeAxis, name: str, *, has_axis: bool) -> None:
        super().__init__(theme, times, 150 if has_axis else 128, has_axis=has_axis)
        self._name = name
        self._out = empty_source("start", "end")
        shade = {"fill_color": theme.caution_border, "fill_alpha": 0.14, "line_color": None}
        hatch = {"hatch_pattern": "right_diagonal_line", "hatch_color": theme.caution_border, "hatch_alpha": 0.25}
        self.figure.vstrip(x0="start", x1="end", source=self._out, **shade, **hatch, hatch_scale=14)
        self._trails = [
            StreamedLine(("value", "used", "refused", *BAND), by="value", filled=BAND[:2]) for _ in AXES_DRAWN
        ]
        for trail, (marker, _), colour in zip(self._trails, _MARKERS, theme.series, strict=False):
            self._draw(trail, marker, colour)

    def _draw(self, trail: StreamedLine, marker: str, colour: str) -> None:
        source, theme = trail.source, self._theme
        self._draw_band(source, colour, 0.13, 0.5)
        filled, hollow = {"size": 2.8, "fill_color": colour, "line_color": None}, {"size": 3.6, "fill_color": None}
        look = filled if marker == "circle" else {**hollow, "line_color": colour}
        dots = self.figure.scatter("t", "used", source=source, marker=marker, line_width=0.8, **look)
        crosses = self.figure.scatter(
            "t", "refused", source=source, marker="x", size=6, line_color=theme.caution_border, line_width=1.5
        )
        add_hover(theme, self.figure, "@value{+0.0}″, ±3σ to @edge_high{0.0}″", [dots, crosses])

    def update(
        self, points: Sequence[InnovationPoint], source: SourceDetails | None, utc_ns: int, *, is_marked: bool
    ) -> None:
        """Draw the new points of the source."""
        for trail, axes in zip(self._trails, AXES_DRAWN, strict=True):
            trail.stream_new(points, partial(_columns, axes=axes))
        recent = points_after(points, utc_ns - 6 * MEAN_WINDOW_NS)
        step = next_step(_axis_limit(recent))
        self._height.update(start=-step, end=step)
        self._labels.write(_side_texts(points_after(points, utc_ns - MEAN_WINDOW_NS), step))
        text, is_out = source_line(self._name, source, step)
        colour = self._theme.caution_border if is_out else self._theme.text
        self.figure.title.update(text=without_formulas(with_mark(text, is_marked)), text_color=colour)
        draw_frame(self._theme, self.figure, is_marked)
        self.figure.title.text_font_style = "bold" if is_out else "normal"
        self._shade_outages(source, utc_ns)

    def _shade_outages(self, source: SourceDetails | None, utc_ns: int) -> None:
        """Shade the times for which the source was OUT; shades after now are removed."""
        now = MS * utc_ns
        spans = [
            (start, min(end, now))
            for start, end in zip(self._out.data["start"], self._out.data["end"], strict=True)
            if start < now
        ]
        if source is not None and source.presence is Presence.OUT and source.out_since_ns:
            since = MS * source.out_since_ns
            spans = [*(span for span in spans if span[0] < since), (since, now)]
        shade = {"start": [start for start, _ in spans], "end": [end for _, end in spans]}
        if shade != self._out.data:  # unchanged data would be sent again
            self._out.data = shade


def source_line(name: str, source: SourceDetails | None, step: float) -> tuple[str, bool]:
    """Return the title of a source's plot, with presence and reason or NIS consistency, and True if the source is OUT.

    Args:
        name: name of the source.
        source: state of the source; None if unknown.
        step: half the height of the axis, arcsec; stated in the title if it is not the smallest step.
    """
    axis = f" · axis ±{step:g}″" if step > STEPS_ARCSEC[0] else ""
    if source is None:
        return name + axis, False
    if source.presence is Presence.OUT:
        disagreement = f" · {source.disagreement}" if source.disagreement else ""
        sigmas = f" · residual {abs(source.residual):.1f} σ" if np.isfinite(source.residual) else ""
        return f"✕ {name}  OUT{axis} · {source.reason}{disagreement}{sigmas}", True
    consistency = f" · {source.nis_consistency.text}" if source.nis_consistency and source.nis_consistency.text else ""
    return f"✓ {name}  {source.presence.value}{axis}{consistency}", False


def _columns(points: Sequence[InnovationPoint], axes: tuple[str, ...]) -> dict[str, FloatArray]:
    """Return the columns of one axis, arcsec; NaN for measurements without this axis."""
    # Nearly all points have the same axes. One look-up for each set of axes is faster than one for each point.
    places = {
        point_axes: next((place for place, axis in enumerate(point_axes) if axis in axes), None)
        for point_axes in {p.axes for p in points}
    }
    rows = [
        (math.nan, math.nan) if (place := places[point.axes]) is None else (point.mean[place], point.sigma[place])
        for point in points
    ]
    value, sigma = ARCSEC_PER_RAD * np.array(rows, float).reshape(-1, 2).T
    used = np.array([point.is_accepted for point in points], bool)
    return {
        "value": value,
        "used": np.where(used, value, np.nan),
        "refused": np.where(used, np.nan, value),
        **three_sigma_band(sigma),
    }


def _axis_limit(points: Sequence[InnovationPoint]) -> float:
    """Return the size that the height of a plot must contain, arcsec.

    The size contains 98 % of the values and the narrowest 10 % of the bands. While another source is OUT, the band of a
    prediction may be so wide that nothing else would be visible.
    """
    largest = 0.0
    for axes in AXES_DRAWN:
        columns = _columns(points, axes)
        for column, share in (("value", 0.98), ("edge_high", 0.1)):
            known = np.abs(columns[column][np.isfinite(columns[column])])
            largest = max(largest, float(np.quantile(known, share)) if len(known) else 0.0)
    return largest


def _side_texts(points: Sequence[InnovationPoint], step: float) -> dict[float, str]:
    """Return height → text of the recent mean of each axis."""
    means: list[tuple[float, str]] = []
    for axes, (_, glyph) in zip(AXES_DRAWN, _MARKERS, strict=True):
        known = (values := _columns(points, axes)["value"])[np.isfinite(values)]
        if len(known):
            name = next(axis for point in points for axis in point.axes if axis in axes)
            means.append((float(np.mean(known)), f"{glyph} {name} {signed_text(float(np.mean(known)))}″"))
    # Labels are at one of forty heights: otherwise labels that move by a pixel would be sent at each update.
    wanted = [round(20.0 * mean / step) * step / 20.0 for mean, _ in means]
    heights = label_positions(wanted, 0.32 * step, -0.9 * step, 0.9 * step)
    return {height: text for height, (_, text) in zip(heights, means, strict=True)}
