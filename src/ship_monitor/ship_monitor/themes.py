"""Colours of page and terminal: day (dark), dusk and night (red light).

Red, orange and yellow are for states and alerts; series are blue, violet and teal. At night all colours are red light:
states then differ by outline, dark fill and bright fill, series by marker and dash. Colour must never be the only
difference.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Theme:
    """Colours of one theme, as ``#RRGGBB``.

    Attributes:
        name: "day", "dusk" or "night", as in the address of the page.
        background: background; also in the first bytes of the page.
        panel: background of tiles and panels.
        border: lines around panels.
        grid: lines inside plots.
        text: values and titles.
        second_text: labels, ticks and less important texts.
        safe: line and text of SAFE; never a fill.
        caution_fill: fill of CAUTION.
        caution_word: text on ``caution_fill``.
        caution_border: frame of CAUTION; also texts in its colour on a panel.
        unsafe_fill: fill of UNSAFE; also texts in its colour on a panel.
        unsafe_word: text on ``unsafe_fill``.
        old: values that are too old.
        alarm: icon of an alarm.
        warning: icon of a warning.
        caution: icon of a caution.
        series: three colours of lines and dots.
    """

    name: str
    background: str
    panel: str
    border: str
    grid: str
    text: str
    second_text: str
    safe: str
    caution_fill: str
    caution_word: str
    caution_border: str
    unsafe_fill: str
    unsafe_word: str
    old: str
    alarm: str
    warning: str
    caution: str
    series: tuple[str, str, str]


_NAMES = ("day", "dusk", "night")
_COLOURS: dict[str, tuple[Any, Any, Any]] = {
    "background": ("#0E141B", "#05080B", "#000000"),
    "panel": ("#18212B", "#0C1218", "#0A0000"),
    "border": ("#3B4957", "#26313B", "#4A0E08"),
    "grid": ("#2A3541", "#19222B", "#2A0603"),
    "text": ("#F2F6FA", "#C4CED7", "#FF4026"),
    "second_text": ("#A9B7C4", "#8593A0", "#DE3420"),
    "safe": ("#5FD3A6", "#46A582", "#DE3420"),
    "caution_fill": ("#FFC53D", "#D9A32B", "#4A0E08"),
    "caution_word": ("#14100A", "#0B0803", "#FF4026"),
    "caution_border": ("#FFC53D", "#D9A32B", "#FF4026"),
    "unsafe_fill": ("#FF4D42", "#E0433A", "#FF4026"),
    "unsafe_word": ("#120303", "#0C0202", "#000000"),
    "old": ("#7F8C99", "#66727D", "#B02A18"),
    "alarm": ("#FF4D42", "#E0433A", "#FF4026"),
    "warning": ("#FF9A3D", "#D97F2B", "#FF4026"),
    "caution": ("#FFE14D", "#D9C23A", "#FF4026"),
    "series": (
        ("#6CB6FF", "#C3A6F2", "#5FD0C5"),
        ("#5296D6", "#9D86C9", "#4AA79E"),
        ("#FF4026", "#B02A18", "#DE3420"),
    ),
}
"""Attribute of a theme → its value in each of the three themes."""

THEMES: Mapping[str, Theme] = MappingProxyType(
    {name: Theme(name, **{each: row[n] for each, row in _COLOURS.items()}) for n, name in enumerate(_NAMES)}
)
"""Name → theme, in the order of the keys 1 to 3."""

FONT = "B612, 'Wide Watch', sans-serif"
"""Font families of the page: B612 if the system has it, else the font of matplotlib."""
