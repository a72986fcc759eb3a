"""Controls of a bag under the top bar: play and pause, speed, time slider, and a note about missing data.

The controls have the colours of the page, which are custom properties of the CSS of the document.
"""

from collections.abc import Callable
from typing import Any

from bokeh.models import Button, CustomJS, Div, InlineStyleSheet, Row, Slider, Toggle

SPEEDS = (1, 10, 60)
STEP_S = 1.0

_PLAY, _PAUSE = "▶ Play", "❚❚ Pause"


class TimeControls:
    """Controls for the displayed time of a bag.

    The page's script finds the slider and the button by their names, ``time`` and ``play``.

    Attributes:
        layout: layout that the page places under its top bar.

    Args:
        length_s: length of the bag, s.
        note: note about missing data; may be empty.
        go_to: called with the time chosen by the user, s after the first message.
    """

    def __init__(self, length_s: float, note: str, go_to: Callable[[float], None]) -> None:
        self._length_s, self._go_to = length_s, go_to
        self._set_s = length_s
        style = InlineStyleSheet(css=_CSS)
        self._play = Toggle(label=_PLAY, name="play", width=110, margin=0, stylesheets=[style])
        self._speed = Button(label=f"× {SPEEDS[0]}", width=64, margin=0, stylesheets=[style])
        self._slider = Slider(
            start=0.0,
            end=max(length_s, STEP_S),
            value=length_s,
            step=STEP_S,
            name="time",
            show_value=False,
            tooltips=False,
            sizing_mode="stretch_width",
            min_width=240,
            margin=(0, 8),
            stylesheets=[style],
        )
        self._clock = Div(text=_clock(length_s, length_s), width=150, margin=0, stylesheets=[style])
        self._play.on_change("active", self._on_play_changed)
        self._speed.on_click(self._on_speed_clicked)
        self._slider.on_change("value", self._on_slider_dragged)
        self._slider.on_change("value_throttled", self._on_slider_released)
        self._slider.js_on_change("value", CustomJS(args={"clock": self._clock, "length": length_s}, code=_CLOCK_JS))
        missing = Div(text=note, render_as_text=True, visible=bool(note), margin=0, stylesheets=[style])
        missing.styles = {"max-width": "22rem"}
        self.layout = Row(
            children=[self._play, self._speed, self._clock, self._slider, missing],
            sizing_mode="stretch_width",
            styles={"align-items": "center", "gap": "4px 12px", "flex-wrap": "wrap"},
        )

    @property
    def is_playing(self) -> bool:
        """True while the bag is played."""
        return bool(self._play.active)

    @property
    def speed(self) -> int:
        """Seconds of the bag that are played in one second."""
        return SPEEDS[self._speed_index]

    _speed_index = 0

    def show(self, at_s: float) -> None:
        """Move the slider to a time, s, without pausing the playback."""
        self._set_s = at_s
        self._slider.value = at_s

    def stop(self) -> None:
        """Pause the playback."""
        self._play.active = False

    def _on_play_changed(self, _name: str, _old: Any, is_playing: bool) -> None:
        self._play.label = _PAUSE if is_playing else _PLAY
        if is_playing and self._slider.value >= self._length_s:
            self.show(0.0)
            self._go_to(0.0)

    def _on_speed_clicked(self) -> None:
        self._speed_index = (self._speed_index + 1) % len(SPEEDS)
        self._speed.label = f"× {self.speed}"

    def _on_slider_dragged(self, _name: str, _old: Any, at_s: float) -> None:
        """Pause the playback while the user drags the slider."""
        if at_s != self._set_s:
            self.stop()

    def _on_slider_released(self, _name: str, _old: Any, at_s: float) -> None:
        self._set_s = at_s
        self._go_to(at_s)


def _clock(at_s: float, length_s: float) -> str:
    """Return a time and the length of the bag as hours, minutes and seconds."""
    return " / ".join(f"{int(s) // 3600}:{int(s) // 60 % 60:02d}:{int(s) % 60:02d}" for s in (at_s, length_s))


_CLOCK_JS = """
const two = (n) => String(Math.floor(n) % 60).padStart(2, "0");
const clockText = (s) => Math.floor(s / 3600) + ":" + two(s / 60) + ":" + two(s);
clock.text = clockText(cb_obj.value) + " / " + clockText(length);
"""

_CSS = """
:host,.bk-btn,.bk-clearfix{font-family:B612,"Wide Watch",sans-serif}
:host,.bk-btn,.bk-clearfix{color:var(--text);font-size:15px;font-variant-numeric:tabular-nums}
.bk-btn,.bk-btn.bk-active,.bk-btn:hover{background:var(--panel)!important;color:var(--text)!important;
  border:1px solid var(--second-text)!important;border-radius:2px;box-shadow:none!important;padding:6px 8px}
.noUi-target{background:var(--grid)!important;border:1px solid var(--border)!important;box-shadow:none!important}
.noUi-connect{background:var(--second-text)!important}
.noUi-handle{background:var(--text)!important;border:1px solid var(--background)!important;box-shadow:none!important}
.noUi-handle::before,.noUi-handle::after{display:none}
:focus-visible{outline:2px solid var(--text)!important}
"""
