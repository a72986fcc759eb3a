"""The colours of the page: day (dark), dusk and night (red light), one table for everything that is drawn.

Red, orange and yellow belong to states and alerts; series are blue, violet and teal. At night nothing but red light may
leave the screen, so that states differ by outline, dark fill and bright fill, and series by marker and dash: whoever
draws must never let colour alone tell two things apart.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Theme:
    """The colours of one theme, as ``#RRGGBB``.

    Attributes:
        name: "day", "dusk" or "night"; the one in the address of the page.
        background: behind everything; in the first bytes of the page.
        panel: of tiles and panels.
        border: lines around panels.
        grid: lines inside plots.
        text: values and titles.
        second_text: labels, ticks and what is less important.
        safe: line and word of SAFE; nothing is filled with it.
        caution_fill: fill of CAUTION, ``caution_word`` the word on it and ``caution_border`` its frame.
        caution_word: see ``caution_fill``.
        caution_border: see ``caution_fill``; also what is written in the colour of CAUTION on a panel.
        unsafe_fill: fill of UNSAFE, also what is written in its colour on a panel.
        unsafe_word: the word on ``unsafe_fill``.
        old: values that are no longer current.
        alarm: icon of an alarm; ``warning`` and ``caution`` likewise.
        warning: see ``alarm``.
        caution: see ``alarm``.
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
"""The themes by their names, in the order of the keys 1 to 3."""

FONT = "B612, 'Wide Watch', sans-serif"
"""Families of the page's writing: a cockpit's face where the system has it, else what matplotlib brings."""
