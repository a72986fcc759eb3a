"""Lines of the terminal view for hand-made states, without textual."""

import dataclasses
import math
import unicodedata
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ship_monitor.terminal.app import details, help_page
from ship_monitor.terminal.screen import View, alert_to_show, screen, selectable_names
from ship_monitor.terminal.styled_text import LineFormatter, TextStyle
from ship_testing.suite_states import (
    NOW_NS,
    SHIFTED_SENSOR,
    SHIFTED_SENSOR_ALERT,
    SHIFTED_SENSOR_INPUT,
    angle,
    angles_timed_out,
    plain_text,
    source,
    source_out,
    state_with_mounting_shift,
)
from ship_watch.suite_state import ANGLES, Event, Priority, Safety

VIEW = View(80, 24, "demo", "LIVE", "namespace /demo, domain 7")


def draw(shown, view=VIEW, alerts=...):
    return screen(shown, shown.alerts if alerts is ... else alerts, view)


def texts(shown, view=VIEW, alerts=...):
    return [plain_text(line).rstrip() for line in draw(shown, view, alerts)]


def row_of(lines, start):
    return next(line for line in lines if line[1:].startswith(start))


def cells(text):
    """Return the number of cells of a text by Unicode (East Asian Width), independent of the drawing library."""
    return sum(2 if unicodedata.east_asian_width(char) in "WF" else 1 for char in text)


def test_screen_matches_the_design():
    assert texts(state_with_mounting_shift()) == [
        " demo  LIVE   ! CAUTION  over the limit (roll)                     12:00:07 UTC",
        " (!) WARNING star.starboard out        11:59:29  UNACK       1 unack, 1 active",
        "─" * 80,
        "           value                   95 %  limit  state       why",
        " HEADING    034.39° true          ±4.2″     5″  ! CAUTION   one star source",
        " PITCH         0.1° bow down      ±2.7″     3″  + SAFE",
        " ROLL          2.1° port down     ±3.7″     3″  ! CAUTION   over the limit",
        " AZIMUTH    359.88°               ±4.9″    10″  + SAFE      2 lights",
        " ELEVATION  +68.74°               ±5.3″    10″  + SAFE      2 lights",
        "─" * 80,
        " ages   stars 0.5 s   lights 0.6 s   ins 0.1 s       horizon geodetic",
        "── sources ── 7 of 8 in " + "─" * 56,
        " x star.starboard   OUT   0.6 s    2.0 Hz  81 rejected in a row, reads 49″ high",
        " + ins              IN    0.1 s    2.0 Hz",
        " + star.fore        IN    0.6 s    2.0 Hz  σ as stated (1.01)",
        " + lights           IN    0.6 s    2.0 Hz  σ as stated (1.01)",
        " + encoder          IN    0.1 s    2.0 Hz",
        " + baselines        IN    0.3 s    2.0 Hz",
        " + gnss             IN    0.1 s    2.0 Hz",
        " + weather          IN    1.1 s    2.0 Hz",
        "── events " + "─" * 70,
        " 11:59:31  state: roll SAFE → CAUTION, over the limit",
        " 11:59:29  WARNING star.starboard rejected",
        " a acknowledge   Enter details   t theme   p pause   ? help   q quit",
    ]


@pytest.mark.parametrize(
    ("word", "look"), [("SAFE", TextStyle.SAFE), ("CAUTION", TextStyle.CAUTION), ("UNSAFE", TextStyle.UNSAFE)]
)
def test_each_safety_is_a_word_with_its_style(word, look):
    shown = state_with_mounting_shift(angles=(angle("heading", safety=Safety[word]),))
    spans = [span for line in draw(shown) for span in line if word in span.text.split() and "HEADING" not in span.text]
    assert [span.style for span in spans if "→" not in span.text] == [look, look]  # of the suite, of the angle


def test_old_value_is_struck_through_with_its_age():
    old = angle("heading", is_old=True, age_s=12.0, safety=Safety.UNSAFE, reason="no data on ship/attitude")
    lines = draw(state_with_mounting_shift(angles=(old,)))
    heading = lines[4]
    assert [span.text.strip() for span in heading if span.style is TextStyle.OLD] == ["034.39° true"]
    assert "OLD 12 s" in plain_text(heading)
    very_old = dataclasses.replace(old, age_s=754.0)
    assert texts(state_with_mounting_shift(angles=(very_old,)))[4].split()[:4] == ["HEADING", "—", "OLD", "13"]


def test_details_and_help_show_the_safety_of_all_angles():
    """On any page the first row has the safety of the suite, the second that of the angles."""
    shown = state_with_mounting_shift()
    for chosen in ("heading", "star.starboard", ""):
        lines = details(shown, shown.alerts, dataclasses.replace(VIEW, chosen=chosen))
        top, second = (plain_text(line) for line in lines[:2])
        assert "! CAUTION  over the limit (roll)" in top
        assert " ".join(second.split()) == "HDG ! CAUTION PIT + SAFE ROL ! CAUTION AZI + SAFE ELE + SAFE"
        assert {span.style for span in lines[1]} >= {TextStyle.SAFE, TextStyle.CAUTION}
    assert plain_text(help_page(shown, VIEW)[1]).startswith(" HDG ! CAUTION")


def test_nothing_looks_good_without_outputs():
    """After the end of the suite: no ticks, no counts, ages struck through; sources that were OUT stay OUT."""
    angles = tuple(angles_timed_out(*ANGLES, age_s=19.0))
    shown = state_with_mounting_shift(angles=angles)
    lines = draw(shown)
    all_text = [plain_text(line) for line in lines]
    sources = all_text[12:20]
    assert [text[1] for text in sources] == ["x", *["?"] * 7]
    assert not any(text[1:2] == "+" for text in all_text)
    assert "8 in" not in "\n".join(all_text)
    ages = next(line for line in lines if plain_text(line).startswith(" ages"))
    assert TextStyle.OLD in {span.style for span in ages}
    assert all(TextStyle.TEXT not in {span.style for span in line if span.text.strip()} for line in lines[13:20])


def test_consequence_is_indented_below_its_cause():
    """Lights need the ship's attitude, which is late: the row of the lights is indented below that of the attitude."""
    late = source_out("ship_attitude", "81 rejected in a row: late")
    lights = source_out("lights", "needs ship_attitude", because_of="ship_attitude")
    rows = texts(state_with_mounting_shift(sources=(late, lights, source("ins"))))[12:15]
    assert [row[:20] for row in rows] == [" x ship_attitude    ", " x   lights         ", " + ins              "]
    assert rows[1].endswith("  needs ship_attitude")


def test_local_time_is_shown_with_utc():
    line = texts(state_with_mounting_shift(), dataclasses.replace(VIEW, zone=ZoneInfo("Europe/Oslo")))[0]
    assert line.endswith(" 14:00:07 CEST  12:00:07 UTC")


def test_each_alert_has_its_advice():
    """The list of alerts has the advice below each alert."""
    shown = state_with_mounting_shift()
    lines = [plain_text(line).strip() for line in details(shown, (SHIFTED_SENSOR_ALERT,), VIEW)]
    assert f"to do: {SHIFTED_SENSOR_ALERT.advice}" in " ".join(lines)


def test_waiting_screen_names_the_suite():
    nothing = state_with_mounting_shift(
        utc_ns=0,
        angles=tuple(
            angle(name, value=math.nan, reason="no data", age_s=math.inf, is_old=True, safety=Safety.UNSAFE)
            for name in ANGLES[:3]
        ),
        ages_s={"stars": math.inf},
        sources=(),
        alerts=None,
        inputs=(),
        events=(),
        waiting_for="ship/attitude",
    )
    lines = texts(nothing)
    assert lines[0].endswith("--:--:-- UTC")
    assert lines[1:3] == [" no alert node", " waiting for ship/attitude: namespace /demo, domain 7"]
    assert row_of(lines, "HEADING").split() == ["HEADING", "—", "—", "5″", "x", "UNSAFE", "no", "data"]


def test_sources_beyond_the_room_are_counted():
    many = state_with_mounting_shift(
        sources=(SHIFTED_SENSOR, *(source(f"reference.number_{place}") for place in range(20)))
    )
    lines = texts(many)
    assert lines[12].startswith(" x star.starboard")
    assert " 14 more in" in "\n".join(lines)
    assert len([line for line in lines if " reference." in line]) + 14 == 20
    all_out = state_with_mounting_shift(
        sources=tuple(dataclasses.replace(SHIFTED_SENSOR, name=f"star.s{place}") for place in range(20))
    )
    assert any("13 more OUT" in line for line in texts(all_out))


@pytest.mark.parametrize("chosen", [f"reference.number_{place}" for place in range(20)])
def test_selected_source_is_visible(chosen):
    many = state_with_mounting_shift(
        sources=(SHIFTED_SENSOR, *(source(f"reference.number_{place}") for place in range(20)))
    )
    assert any(line.startswith(f">+ {chosen[:15]}") for line in texts(many, dataclasses.replace(VIEW, chosen=chosen)))


def test_larger_terminal_shows_more():
    wide = texts(state_with_mounting_shift(), dataclasses.replace(VIEW, width=120, height=50))
    assert len(wide) == 50
    assert "attitude_conflict 72, gate 9" in "\n".join(wide)


@pytest.mark.parametrize(("width", "height"), [(63, 24), (80, 14), (20, 3), (1, 1)])
def test_small_terminal_has_one_line_with_the_worst_state(width, height):
    lines = texts(state_with_mounting_shift(), dataclasses.replace(VIEW, width=width, height=height))
    assert not any(lines[1:])
    assert lines[0].startswith("CAUTION heading, roll"[: width - 1])


def test_terminal_with_one_row_less():
    lines = texts(state_with_mounting_shift(), dataclasses.replace(VIEW, height=23))
    assert len(lines) == 23
    assert any("star.starboard" in line and "OUT" in line for line in lines)
    assert lines[-1].startswith(" a acknowledge")


def test_pause_is_shown_and_alerts_continue():
    alarm = dataclasses.replace(SHIFTED_SENSOR_ALERT, priority=Priority.ALARM, text="heading lost")
    lines = texts(state_with_mounting_shift(), dataclasses.replace(VIEW, paused_s=12.0), alerts=(alarm,))
    assert "PAUSED 12 s ago" in lines[0]
    assert lines[1].startswith(" /!\\ ALARM heading lost")


def test_unacknowledged_alert_is_shown_first():
    acknowledged = dataclasses.replace(SHIFTED_SENSOR_ALERT, id="first", priority=Priority.ALARM, state=3)
    assert alert_to_show((acknowledged, SHIFTED_SENSOR_ALERT)) == SHIFTED_SENSOR_ALERT
    assert alert_to_show((acknowledged,)) == acknowledged
    assert alert_to_show(None) is None
    assert "1 unack, 2 active" in texts(state_with_mounting_shift(alerts=(acknowledged, SHIFTED_SENSOR_ALERT)))[1]


def test_details_have_all_digits():
    def page(chosen):
        view = dataclasses.replace(VIEW, chosen=chosen)
        return "\n".join(
            plain_text(line).rstrip() for line in details(state_with_mounting_shift(), (SHIFTED_SENSOR_ALERT,), view)
        )

    assert "34.392000°" in page("heading")
    assert "2.14″" in page("heading")  # 4.2″ / 1.96
    assert "2026-05-01 11:59:28.000" in page("star.starboard")
    assert "attitude_conflict 72, gate 9" in page("star.starboard")
    assert "(!) WARNING star.starboard out" in page("")


def test_ascii_terminal_keeps_every_meaning():
    view = dataclasses.replace(VIEW, is_ascii=True)
    lines = texts(state_with_mounting_shift(), view)
    assert all(line.isascii() for line in lines)
    assert row_of(lines, "HEADING").split()[:5] == ["HEADING", "034.39deg", "true", '+-4.2"', '5"']
    assert row_of(lines, "PITCH").split()[:4] == ["PITCH", "0.1deg", "bow", "down"]
    assert all(plain_text(line).isascii() for line in help_page(state_with_mounting_shift(), view))


def test_names_from_the_network_cannot_control_the_terminal():
    evil = dataclasses.replace(SHIFTED_SENSOR_ALERT, text="\x1b[2J\x1b]0;title\x07 fire\r\n\u202eright to left\u0301")
    for line in draw(
        state_with_mounting_shift(alerts=(evil,), sources=(dataclasses.replace(SHIFTED_SENSOR, name="\x1b[31m" * 9),))
    ):
        assert all(char.isprintable() for char in plain_text(line))


WIDE = st.text(alphabet=st.sampled_from("aß漢字ｆ🚢\u0301\x1b\t\n−″σ─ "), max_size=60)


@settings(max_examples=150, deadline=None)
@given(
    name=WIDE,
    text=WIDE,
    number=st.floats(),
    other=st.floats(),
    width=st.integers(0, 200),
    height=st.integers(1, 60),
    chosen=st.sampled_from(("", "heading", "x", "lights")),
    is_ascii=st.booleans(),
    safety=st.sampled_from(Safety),
    is_old=st.booleans(),
    count=st.integers(0, 30),
)
def test_every_line_has_the_width_of_the_terminal(
    name, text, number, other, width, height, chosen, is_ascii, safety, is_old, count
):
    changed = {
        "value": number,
        "accuracy_95": other,
        "age_s": abs(other),
        "safety": safety,
        "reason": text,
        "is_old": is_old,
    }
    an_input = dataclasses.replace(
        SHIFTED_SENSOR_INPUT, topic=name, latency_s=number, age_s=other, reasons={text: 10**9}
    )
    shown = state_with_mounting_shift(
        angles=tuple(angle(each, **changed) for each in ANGLES),
        sources=tuple(source(f"{name}{place}", reason=text, rate_hz=number, age_s=other) for place in range(count)),
        alerts=(dataclasses.replace(SHIFTED_SENSOR_ALERT, text=text),),
        inputs=(an_input,) * count,
        events=(Event(NOW_NS, "state", name, text),) * count,
        waiting_for=text,
    )
    view = dataclasses.replace(
        VIEW, width=width, height=height, name=name, location=text, chosen=chosen, is_ascii=is_ascii
    )
    for lines in (screen(shown, shown.alerts, view), details(shown, shown.alerts, view), help_page(shown, view)):
        assert len(lines) == height
        assert {cells(plain_text(line)) for line in lines} <= {width}


@given(WIDE, st.integers(0, 90), st.booleans(), st.booleans())
def test_fitted_text_has_the_given_width(text, width, to_right, is_ascii):
    assert cells(LineFormatter(90, is_ascii).fit(text, width, to_right=to_right)) == width


def test_selection_goes_downward():
    assert selectable_names(state_with_mounting_shift())[:6] == (*ANGLES, "star.starboard")
