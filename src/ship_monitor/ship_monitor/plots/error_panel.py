"""Error panel: error of each angle against the truth, with ±3 sigma; only in simulation, where a truth is known."""

from collections.abc import Mapping, Sequence
from itertools import islice

import numpy as np
from bokeh.models import Range1d

from ship_geometry.rotations import FloatArray
from ship_monitor.plots.curves import next_step
from ship_monitor.plots.figures import GrowingRows, PanelBox, SideLabels, add_hover, draw_frame, empty_time_plot
from ship_monitor.plots.marking import with_mark
from ship_monitor.plots.streamed_lines import BAND, StreamedLine, TimeAxis, three_sigma_band
from ship_monitor.themes import Theme
from ship_watch.history.history import ErrorPoint, History, points_after

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


class _ErrorRow:
    """Plot of one angle."""

    def __init__(self, theme: Theme, times: TimeAxis, key: tuple[str, str], *, has_axis: bool) -> None:
        self._theme, self._channel, self._title = theme, key[1], CHANNELS[key]
        self._height = Range1d(-15.0, 15.0)
        self.figure = empty_time_plot(theme, times, 88 if has_axis else 66, self._height, has_axis=has_axis)
        self._labels = SideLabels(theme, self.figure)
        self._trail = StreamedLine(("error", "sigma", *BAND), by="error", filled=BAND[:2])
        source, colour = self._trail.source, theme.series[0]
        self.figure.varea("t", "low", "high", source=source, fill_color=colour, fill_alpha=0.18)
        for edge in BAND[2:]:
            self.figure.line("t", edge, source=source, line_color=colour, line_dash="dashed")
        line = self.figure.line("t", "error", source=source, line_color=theme.text, line_width=1.2)
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
