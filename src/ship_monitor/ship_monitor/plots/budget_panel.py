"""Error budget panel of one angle: stacked variances of the error sources on an axis labelled with sigmas.

Variances add up, sigmas do not: the bands add up to the total, and 2″ is four times as high as 1″. The top of a short
peak is cut off, and its height is written there.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from bokeh.models import FixedTicker, InlineStyleSheet, RadioButtonGroup, Range1d, Stack
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_monitor.plots.curves import StreamedLine, TimeAxis, label_positions
from ship_monitor.plots.figures import (
    ARCSEC_PER_RAD,
    PanelBox,
    SideLabels,
    batched_model_changes,
    draw_texts,
    empty_source,
    empty_time_plot,
    is_budget_part_of,
    narrow_height,
    with_mark,
)
from ship_monitor.themes import FONT, Theme
from ship_watch.history.history import HISTORY_S, BudgetPoint, History
from ship_watch.suite_state import ANGLES

MAX_BANDS = 5
"""Maximum number of sources with separate bands."""

TOPS_ARCSEC = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 100.0, 200.0, 500.0)
"""Possible ends of the axis, sigma, arcsec."""

_HATCHES = (None, "/", ".", "\\", "x", "-")
_OPACITIES = (0.75, 0.75, 0.75, 0.4, 0.4, 0.25)


class BudgetPanel:
    """Panel with the bands of one angle.

    Attributes:
        box: the panel.
        angle: displayed angle, one of :data:`ship_watch.suite_state.ANGLES`; empty if no angle is displayed.
        chosen_angle: angle chosen by the user; empty before a choice.
    """

    def __init__(self, theme: Theme, times: TimeAxis) -> None:
        self._theme = theme
        self._times = times
        self.angle = self.chosen_angle = self._marked = ""
        self._bands: tuple[str, ...] = ()
        self._sources: tuple[str, ...] = ()
        self._names: list[str] = []
        self._choice = RadioButtonGroup(labels=[], stylesheets=[InlineStyleSheet(css=_choice_css(theme))])
        self._choice.on_change("active", lambda _name, _old, place: self._on_button(self._names[place]))
        self._height = Range1d(0.0, 1.0)
        self._create_plot()
        self.box = PanelBox(theme, "Error budget", [self._choice, self._figure])

    def choose(self, angle: str) -> None:
        """Select an angle chosen by the user; the angle is drawn at the next update."""
        self.chosen_angle = angle
        self._select_angle(angle)

    def _on_button(self, angle: str) -> None:
        if angle != self.angle:  # the button of the displayed angle is set by the program
            self.choose(angle)

    def _select_angle(self, angle: str) -> None:
        if angle != self.angle:
            self.angle, self._sources = angle, ()

    def update(self, history: History, marked: str) -> None:
        """Draw the new points of the angle.

        Args:
            history: history with the budgets.
            marked: marked source, whose sources of error have separate, highlighted bands; empty if no source is
                marked.
        """
        topics = {angle: topic for topic, points in history.budgets.items() if points for angle in points[-1].by_angle}
        self._names = [angle for angle in ANGLES if angle in topics]
        self._choice.labels = self._names
        if not self._names:
            self.box.set_subtitle("no error budget data")
            return
        if self.angle not in self._names:
            self._select_angle(self._names[0])
        if marked != self._marked:
            self._marked, self._bands = marked, ()
        self._choice.active = self._names.index(self.angle)
        points = history.budgets[topics[self.angle]]
        sources = tuple(points[-1].by_angle[self.angle])
        if sources != self._sources:
            self._sources, self._bands = sources, ()
            self._create_plot()
            self.box.set_children([self._choice, self._figure])
        self._trail.stream_new(points, self._columns)
        self._draw(points)

    def _create_plot(self) -> None:
        """Create an empty plot with a column for each source of error."""
        columns = [_column(source) for source in self._sources]
        self._trail = StreamedLine((*columns, "total"), by="total", filled=columns)
        self._figure = empty_time_plot(self._theme, self._times, 200, self._height, has_axis=True)
        self._figure.yaxis[0].ticker = FixedTicker(ticks=[])
        self._figure.stylesheets = [*self._figure.stylesheets, narrow_height(180)]
        self._labels = SideLabels(self._theme, self._figure)
        self._peaks = empty_source("x", "y", "text", "align", "ahead")
        placing = {"text_align": "align", "x_offset": "ahead", "text_baseline": "top", "y_offset": 2}
        placing |= {"level": "overlay", "background_fill_color": self._theme.panel, "padding": 2}
        draw_texts(self._figure, self._peaks, text_color=self._theme.text, **placing)
        self._band_renderers: list[object] = []

    def _columns(self, points: Sequence[BudgetPoint]) -> dict[str, FloatArray]:
        variances = variances_arcsec2(points, self.angle, self._sources)
        columns = {_column(source): variances[:, index] for index, source in enumerate(self._sources)}
        return {**columns, "total": variances.sum(axis=1)}

    def _draw(self, points: Sequence[BudgetPoint]) -> None:
        columns = self._trail.source.data
        totals = np.asarray(columns["total"], float)
        if not np.isfinite(totals).any():
            self.box.set_subtitle(f"{self.angle}: currently unknown")
            return
        known = np.isfinite(totals)
        means = {source: float(np.mean(np.asarray(columns[_column(source)])[known])) for source in self._sources}
        bands = largest_sources(means, self._bands, [one for one in means if is_budget_part_of(one, self._marked)])
        if bands != self._bands:
            self._bands = bands
            with batched_model_changes(self._figure):
                self._draw_bands()
        top = top_of_axis(totals)
        self._height.end = top**2
        ticks = root_ticks(top)
        self._figure.yaxis[0].ticker.ticks = [tick**2 for tick in ticks]
        self._figure.yaxis[0].major_label_overrides = {tick**2: f"{tick:g}″" for tick in ticks}
        times = np.asarray(columns["t"], float)
        found = peaks(times, totals, top)
        is_late = [at > self._times.range.end - 0.3e3 * HISTORY_S for at, _ in found]  # no room for text to the right
        peak_labels = {
            "x": [at for at, _ in found],
            "y": [top**2] * len(found),
            "text": [f"to {math.sqrt(height):.1f}″ ↑" for _, height in found],
            "align": ["right" if late else "left" for late in is_late],
            "ahead": [-4 if late else 4 for late in is_late],
        }
        if peak_labels != self._peaks.data:
            self._peaks.data = peak_labels
        last = {source: variances_arcsec2([points[-1]], self.angle, (source,))[0, 0] for source in self._sources}
        self._labels.write(band_labels(last, self._bands, top**2, self._marked))
        sigma = math.sqrt(total) if (total := sum(last.values())) >= 0.0 else math.nan
        self.box.set_subtitle(f"{self.angle}, σ {sigma:.2f}″ · stacked variances, axis labelled in σ")

    def _draw_bands(self) -> None:
        """Draw new bands: the sources in ``_bands``, and the sum of the other sources."""
        for renderer in self._band_renderers:
            self._figure.renderers.remove(renderer)
        edges = [[_column(name) for name in self._bands[: count + 1]] for count in range(len(self._bands))]
        if len(self._sources) > len(self._bands):
            edges.append([_column(name) for name in self._sources])
        self._band_renderers, below = [], None
        for index, fields in enumerate(edges):
            colour = self._theme.series[index % 3] if index < len(self._bands) else self._theme.second_text
            if index < len(self._bands) and is_budget_part_of(self._bands[index], self._marked):
                colour = self._theme.text
            band = self._figure.varea(
                x="t",
                y1=0.0 if below is None else {"expr": Stack(fields=below)},
                y2={"expr": Stack(fields=fields)},
                source=self._trail.source,
                fill_color=colour,
                fill_alpha=_OPACITIES[index],
                hatch_pattern=_HATCHES[index],
                hatch_color=self._theme.panel,
                hatch_scale=8.0,
                hatch_weight=1.5,
            )
            self._band_renderers.append(band)
            below = fields


def variances_arcsec2(points: Sequence[BudgetPoint], angle: str, sources: Sequence[str]) -> FloatArray:
    """Return the variances of an angle, arcsec², shape (points, sources); NaN for missing variances."""
    empty: Mapping[str, float] = {}
    rows = [[point.by_angle.get(angle, empty).get(source, np.nan) for source in sources] for point in points]
    return np.array(rows, float).reshape(len(points), len(sources)) * ARCSEC_PER_RAD**2


def largest_sources(
    means: Mapping[str, float], current_bands: tuple[str, ...], required: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the sources with separate bands, the largest at the bottom; after small changes the bands stay.

    Args:
        means: source → mean variance.
        current_bands: current bands; a band is replaced only by a variance that is a quarter larger.
        required: sources that have separate bands before all others if their mean variance is above 0.
    """
    known = {source: mean for source, mean in means.items() if mean > 0.0}
    weight = {source: mean * (1.25 if source in current_bands else 1.0) for source, mean in known.items()}
    chosen = sorted(weight, key=lambda source: (source not in required, -weight[source]))[:MAX_BANDS]
    if set(chosen) == set(current_bands):
        return current_bands
    return tuple(sorted(chosen, key=lambda source: -known[source]))


def top_of_axis(totals: FloatArray) -> float:
    """Return the end of the axis, sigma, arcsec: above the 90 % quantile, so that short peaks are cut off.

    Args:
        totals: variances, arcsec²; NaN in gaps.
    """
    usual = math.sqrt(1.15 * float(np.nanquantile(totals, 0.9)))
    return next((top for top in TOPS_ARCSEC if top >= usual), TOPS_ARCSEC[-1])


def peaks(times: FloatArray, totals: FloatArray, top: float) -> list[tuple[float, float]]:
    """Return time and variance of the peak of each interval that is cut off; lower peaks close to another are left out.

    Args:
        times: times in the browser's unit, shape (n,).
        totals: variances, arcsec²; a gap ends an interval.
        top: end of the axis, sigma, arcsec.
    """
    over: NDArray[np.bool_] = totals > top**2
    edges = np.flatnonzero(np.diff(np.concatenate(([False], over, [False])).astype(int)))
    found = []
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        at = int(start) + int(np.argmax(totals[start:end]))
        found.append((float(times[at]), float(totals[at])))
    least = 0.15 * 1e3 * HISTORY_S
    kept: list[tuple[float, float]] = []
    for peak in sorted(found, key=lambda one: -one[1]):  # two texts must not overlap
        if all(abs(peak[0] - other[0]) >= least for other in kept):
            kept.append(peak)
    return sorted(kept)


def root_ticks(top: float) -> list[float]:
    """Return the labels of the axis, sigma, arcsec: multiples of a round step that do not overlap."""
    step = next(step for step in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if top / step <= 6.0)
    ticks = [0.0]
    for count in range(1, int(top / step + 1e-9) + 1):
        if (count * step) ** 2 - ticks[-1] ** 2 >= 0.1 * top**2:
            ticks.append(count * step)
    return ticks


def band_labels(last: Mapping[str, float], bands: Sequence[str], height: float, marked: str = "") -> dict[float, str]:
    """Return the labels of the bands, height → text: each near the middle of its band at the right end, no overlap.

    The result is empty if a variance is unknown.

    Args:
        last: source → newest variance, arcsec².
        bands: sources with separate bands, from below.
        height: height of the axis, arcsec².
        marked: marked source; empty if no source is marked.
    """
    others = sum(value for source, value in last.items() if source not in bands)
    parts = [(band, last[band]) for band in bands] + ([("other", others)] if len(last) > len(bands) else [])
    middles, below = [], 0.0
    for _, part in parts:
        middles.append(below + 0.5 * part)
        below += part
    if not math.isfinite(below):
        return {}
    heights = label_positions(middles, 0.115 * height, 0.03 * height, 0.97 * height)
    texts = [
        with_mark(f"{name.replace('_', ' ')} {math.sqrt(max(part, 0.0)):.2f}″", is_budget_part_of(name, marked))
        for name, part in parts
    ]
    return dict(zip(heights, texts, strict=True))


def _column(source: str) -> str:
    """Return the name of a source's column, which differs from the names of the columns of time and total."""
    return f"of {source}"


def _choice_css(theme: Theme) -> str:
    return (
        f":host{{margin:0 12px}}.bk-btn{{background:{theme.panel};color:{theme.second_text};font:13px {FONT};"
        f"border:1px solid {theme.border};padding:2px 9px;box-shadow:none}}"
        f".bk-btn:hover{{background:{theme.border};color:{theme.text}}}"
        f".bk-btn.bk-active{{background:{theme.border};color:{theme.text};font-weight:bold;"
        f"border-color:{theme.second_text};box-shadow:none;outline:none}}"
    )
