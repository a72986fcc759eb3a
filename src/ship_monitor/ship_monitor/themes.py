"""Colours of page and terminal: day (dark), dusk and night (red light).

Red, orange and yellow are for states and alerts; series are blue, violet and teal. At night all colours are red light:
states then differ by outline, dark fill and bright fill, series by marker and dash. Colour must never be the only
difference.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


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


_DAY = Theme(
    name="day",
    background="#0E141B",
    panel="#18212B",
    border="#3B4957",
    grid="#2A3541",
    text="#F2F6FA",
    second_text="#A9B7C4",
    safe="#5FD3A6",
    caution_fill="#FFC53D",
    caution_word="#14100A",
    caution_border="#FFC53D",
    unsafe_fill="#FF4D42",
    unsafe_word="#120303",
    old="#7F8C99",
    alarm="#FF4D42",
    warning="#FF9A3D",
    caution="#FFE14D",
    series=("#6CB6FF", "#C3A6F2", "#5FD0C5"),
)

_DUSK = Theme(
    name="dusk",
    background="#05080B",
    panel="#0C1218",
    border="#26313B",
    grid="#19222B",
    text="#C4CED7",
    second_text="#8593A0",
    safe="#46A582",
    caution_fill="#D9A32B",
    caution_word="#0B0803",
    caution_border="#D9A32B",
    unsafe_fill="#E0433A",
    unsafe_word="#0C0202",
    old="#66727D",
    alarm="#E0433A",
    warning="#D97F2B",
    caution="#D9C23A",
    series=("#5296D6", "#9D86C9", "#4AA79E"),
)

_NIGHT = Theme(
    name="night",
    background="#000000",
    panel="#0A0000",
    border="#4A0E08",
    grid="#2A0603",
    text="#FF4026",
    second_text="#DE3420",
    safe="#DE3420",
    caution_fill="#4A0E08",
    caution_word="#FF4026",
    caution_border="#FF4026",
    unsafe_fill="#FF4026",
    unsafe_word="#000000",
    old="#B02A18",
    alarm="#FF4026",
    warning="#FF4026",
    caution="#FF4026",
    series=("#FF4026", "#B02A18", "#DE3420"),
)

THEMES: Mapping[str, Theme] = MappingProxyType({theme.name: theme for theme in (_DAY, _DUSK, _NIGHT)})
"""Name → theme, in the order of the keys 1 to 3."""

FONT = "B612, 'Wide Watch', sans-serif"
"""Font families of the page: B612 if the system has it, else the font of matplotlib."""
