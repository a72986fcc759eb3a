"""Alignment and calibration panel: each state minus its nominal value, ±2σ.

Most rows have a common scale. A row that does not fit has a wider scale, which is written in the row. A gyro with
an offset of 1 000″ therefore does not shrink the bars of the other rows.
"""

import math
from collections.abc import Sequence

import numpy as np
from bokeh.models import FixedTicker, Range1d

from ship_monitor.plots.curves import next_step, signed_text
from ship_monitor.plots.figures import (
    ARCSEC_PER_RAD,
    PanelBox,
    SideLabels,
    belongs_to_source,
    empty_plot,
    empty_source,
    with_mark,
    without_formulas,
)
from ship_monitor.themes import Theme
from ship_watch.history.history import History, ParameterEstimate

STEPS_ARCSEC = (30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0, 18_000.0, 90_000.0, 648_000.0)
"""Possible half widths of the axis, arcsec."""

_ROW_PX = 20


class AlignmentPanel:
    """Panel with a row for each estimated state, for example an installation angle or a time offset.

    Attributes:
        box: the panel.
    """

    def __init__(self, theme: Theme) -> None:
        self._x, self._rows = Range1d(-60.0, 60.0), Range1d(-0.5, 0.5)
        self.figure = empty_plot(theme, 320, self._x, self._rows, x_axis_label="estimate − nominal, ″; bar ±2σ")
        self.figure.ygrid.grid_line_color = None
        self.figure.min_border_left = 176
        self.figure.xaxis.ticker.desired_num_ticks = 3
        self._values = SideLabels(theme, self.figure)
        self._source = empty_source("row", "value", "low", "high", "fill", "bar")
        self.figure.line([0.0, 0.0], [-1e3, 1e3], line_color=theme.second_text)
        self.figure.segment(
            "low", "row", "high", "row", source=self._source, line_color="bar", line_width=5, line_alpha=0.55
        )
        self.figure.scatter("value", "row", source=self._source, size=8, fill_color="fill", line_color=theme.text)
        self._theme = theme
        self.figure.yaxis[0].ticker = FixedTicker(ticks=[])
        self.box = PanelBox(theme, "Alignment and calibration", [self.figure])

    def update(self, history: History, marked: str) -> None:
        """Draw the current states; states of the marked source are highlighted."""
        states = [*history.alignment, *history.calibration]
        count = len(states)
        if not count:
            self._source.data = {name: [] for name in self._source.data}
            self.box.set_subtitle("no alignment or calibration data")
            return
        self.figure.height = _ROW_PX * count + 60
        self._rows.update(start=count - 0.5, end=-0.5)
        low, value, high = bars_arcsec(states)
        half = half_width(low, high)
        self._x.update(start=-half, end=half)
        own = own_half_widths(low, value, high, half)
        scale = half / own
        self._source.data = {
            "row": np.arange(count),
            "value": scale * value,
            "low": np.maximum(scale * low, -half),
            "high": np.minimum(scale * high, half),
            "fill": [self._theme.text if state.is_observable else self._theme.panel for state in states],
            "bar": [
                self._theme.text if belongs_to_source(state.name, marked) else self._theme.series[0] for state in states
            ],
        }
        self.figure.yaxis[0].ticker.ticks = list(range(count))
        self.figure.yaxis[0].major_label_overrides = {
            row: without_formulas(with_mark(state.name, belongs_to_source(state.name, marked)))
            for row, state in enumerate(states)
        }
        self._values.write(
            {
                row: state_text(state) + ("" if own[row] == half else f" · scale ±{own[row]:g}″")
                for row, state in enumerate(states)
            }
        )
        hidden = [state.name for state in states if not state.is_observable]
        self.box.set_subtitle(f"not observable: {', '.join(hidden)}" if hidden else "all observable")


_UNITS = {
    "rad": (ARCSEC_PER_RAD, "″", 1),
    "s": (1e3, " ms", 2),
    "m": (1e6, " µm", 0),
    "px": (1.0, " px", 2),
    "1": (1e2, " %", 4),
}
"""Unit of a state → factor to the displayed unit, displayed unit, decimals."""


def bars_arcsec(states: Sequence[ParameterEstimate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lower end, value and upper end of each bar, arcsec.

    The result is NaN for a state that is no angle or has no nominal value.
    """
    scale = np.array([ARCSEC_PER_RAD if state.unit == "rad" else np.nan for state in states])
    value = scale * np.array([deviation_from_nominal(state) for state in states])
    reach = 2.0 * scale * np.array([state.sigma for state in states])
    return value - reach, value, value + reach


def deviation_from_nominal(state: ParameterEstimate) -> float:
    """Return estimate minus nominal value, in the state's unit; an angle is wrapped to ±π."""
    off = state.value - state.nominal
    return math.remainder(off, 2.0 * math.pi) if state.unit == "rad" and math.isfinite(off) else off


def half_width(low: np.ndarray, high: np.ndarray) -> float:
    """Return half the width of the axis, arcsec: the smallest step that contains three quarters of the bars."""
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any():
        return STEPS_ARCSEC[0]
    reach = np.fmax(np.abs(low[known]), np.abs(high[known]))
    return next_step(float(np.quantile(reach, 0.75)), STEPS_ARCSEC)


def own_half_widths(low: np.ndarray, value: np.ndarray, high: np.ndarray, half: float) -> np.ndarray:
    """Return the half width of each row's scale, arcsec: ``half``, or a wider step if the value does not fit."""
    known = np.isfinite(low) & np.isfinite(high)
    needed = np.where(known, 1.05 * np.abs(value), 0.0)
    return np.array([half if not need > half else next_step(need, STEPS_ARCSEC) for need in needed])


def state_text(state: ParameterEstimate) -> str:
    """Return deviation ± 2σ in the displayed unit; in brackets if the state is not observable."""
    scale, unit, digits = _UNITS.get(state.unit, (1.0, f" {state.unit}", 3))
    text = (
        f"{signed_text(scale * deviation_from_nominal(state), digits)} ± {2.0 * scale * state.sigma:.{digits}f}{unit}"
    )
    return text if state.is_observable else f"({text})"
