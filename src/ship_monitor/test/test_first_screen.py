"""Content of the page's first screen, for hand-made states."""

import json
import math
from collections import deque
from dataclasses import replace

import pytest

from ship_geometry.rotations import ARCSEC
from ship_monitor.page.first_screen import first_screen
from ship_testing import suite_states
from ship_watch.history.history import History, SafetyPoint
from ship_watch.suite_state import ANGLES, Presence, Priority, Safety

WELL = suite_states.suite_state()


def with_angle(name, **changes):
    angles = tuple(replace(each, **changes) if each.name == name else each for each in WELL.angles)
    return replace(WELL, angles=angles)


def tile(picture, name):
    return first_screen(picture, History(), "LIVE", "")["angles"][name]


def test_tile_has_value_accuracy_limit_and_safety():
    heading = tile(WELL, "heading")
    assert (heading["number"], heading["sense"], heading["accuracy"]) == ("034.39°", "true", "±3.3″")
    assert (heading["reason"], heading["is_reason"], heading["safety"]) == ("limit 5″", False, "SAFE")


def test_limit_is_in_the_middle_of_the_bar():
    at_limit = with_angle("heading", accuracy_95=5.0 * ARCSEC)
    assert tile(at_limit, "heading")["bar"] == pytest.approx(0.5)
    assert tile(with_angle("heading", accuracy_95=50.0 * ARCSEC), "heading")["bar"] == 1.0


@pytest.mark.parametrize("accuracy", [math.nan, math.inf])
def test_unknown_accuracy_has_no_short_bar(accuracy):
    bar = tile(with_angle("heading", accuracy_95=accuracy), "heading")["bar"]
    assert bar is None or bar == 1.0


def test_pitch_without_a_value_has_no_sense():
    assert tile(with_angle("pitch", value=math.nan), "pitch")["sense"] == ""


def test_reason_over_the_limit_has_the_limit():
    picture = with_angle("roll", safety=Safety.CAUTION, reason="over the limit", accuracy_95=3.7 * ARCSEC)
    assert tile(picture, "roll")["reason"] == "over the limit, 3″"


def test_old_value_has_its_age_and_no_bar():
    old = tile(suite_states.state_with_two_faults(), "azimuth")
    assert (old["is_old"], old["accuracy"], old["bar"]) == (True, "OLD 12 s", None)


def test_tooltip_has_full_digits():
    assert tile(WELL, "heading")["tip"][0] == "34.392000°"
    assert tile(WELL, "heading")["tip"][1] == "σ 1.684″"  # 3.3 / 1.96
    assert tile(WELL, "pitch")["tip"][0] == "−0.120000°"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_unknown_values_are_valid_json(value):
    angles = tuple(
        replace(each, value=value, accuracy_95=value, age_s=math.inf, protection_level=value) for each in WELL.angles
    )
    sources = tuple(replace(each, age_s=math.inf, rate_hz=value) for each in WELL.sources)
    ages = dict.fromkeys(WELL.ages_s, math.inf)
    picture = replace(WELL, angles=angles, sources=sources, ages_s=ages, utc_ns=0)
    screen = json.loads(json.dumps(first_screen(picture, History(), "LIVE", ""), allow_nan=False))
    assert screen["utc"] == "--:--:--"
    assert screen["ages"] == [["stars", "never", None], ["lights", "never", None], ["ins", "never", None]]
    assert screen["angles"]["heading"]["age_s"] is None


def test_lights_have_no_age_without_a_theodolite():
    assert [
        name for name, *_ in first_screen(replace(WELL, angles=WELL.angles[:3]), History(), "LIVE", "")["ages"]
    ] == [
        "stars",
        "ins",
    ]


def test_waiting_text_has_output_and_location():
    screen = first_screen(replace(WELL, waiting_for="ship/attitude"), History(), "LIVE", "namespace /demo, domain 3")
    assert (screen["waiting"], screen["place"]) == ("waiting for ship/attitude", "namespace /demo, domain 3")
    assert first_screen(WELL, History(), "LIVE", "namespace /demo, domain 3")["place"] == ""


@pytest.mark.parametrize(
    ("alerts", "text", "icon", "state", "unack"),
    [
        (None, "No alert node", "", "", 0),
        ((), "No alerts", "ok", "", 0),
        ((suite_states.alert("star.bow", "out", 0),), "WARNING · star.bow out", "warning", "unack", 1),
        ((suite_states.alert("box", "box full", 0, Priority.ALARM, 3),), "ALARM · box full", "alarm", "ack", 0),
        ((suite_states.alert("ins", "late", 0, Priority.WARNING, 4),), "WARNING · ins late", "warning", "rectified", 1),
        ((suite_states.alert("ins", "late", 0, Priority.CAUTION, 3),), "CAUTION · ins late", "caution", "ack", 0),
    ],
)
def test_alert_line(alerts, text, icon, state, unack):
    line = first_screen(replace(WELL, alerts=alerts), History(), "LIVE", "")["alert"]
    assert (line["text"], line["icon"], line["state"], line["unack"]) == (text, icon, state, unack)


def test_first_of_several_alerts_is_shown_and_all_are_listed():
    line = first_screen(suite_states.state_with_two_faults(), History(), "LIVE", "")["alert"]
    assert line["text"] == "WARNING · Pointing lost: no data from encoder"
    assert line["sub"] == "11:59:57 · not acknowledged"
    assert (line["unack"], len(line["all"])) == (2, 2)
    assert line["all"][1]["advice"].startswith("Clean the sensor and check its mounting; calibrate")


def test_mounting_shift_is_shown_at_its_source():
    shifted = suite_states.source("star.starboard", mounting_shift=51.0 * ARCSEC)
    rows = first_screen(suite_states.suite_state(shifted), History(), "LIVE", "")["sources"]["rows"]
    assert next(row["sub"] for row in rows if row["name"] == "star.starboard") == "mounting shifted by 51.0″"


def test_sources_that_are_out_have_banners_and_reasons():
    sources = first_screen(suite_states.state_with_two_faults(), History(), "LIVE", "")["sources"]
    assert sources["out"] == [("star.starboard", "star.starboard OUT"), ("encoder", "encoder OUT")]
    assert sources["head"] == "6 of 8 in"
    assert [row["sub"] for row in sources["rows"][:2]] == [
        "reads 49″ high · 81 rejected in a row since 11:59:28",
        "no data since 11:59:55",
    ]
    assert sources["why"] == [], "the list names them"


def test_single_source_out_has_two_more_lines():
    one = tuple(each for each in suite_states.state_with_two_faults().sources if each.name != "encoder")
    assert first_screen(replace(WELL, sources=one), History(), "LIVE", "")["sources"]["why"] == [
        "reads 49″ high",
        "since 11:59:28 · 81 rejected",
    ]


def dependent_sources(*names, cause="encoder", reason="needs encoder"):
    return [suite_states.source_out(name, reason, because_of=cause, out_since_ns=suite_states.NOW_NS) for name in names]


def test_consequence_is_below_its_cause_without_a_banner():
    encoder = suite_states.source_out("encoder", "no data", out_since_ns=suite_states.NOW_NS - suite_states.NS)
    listed = (suite_states.SHIFTED_SENSOR, encoder, *dependent_sources("lights"), suite_states.source("ins"))
    sources = first_screen(replace(WELL, sources=listed), History(), "LIVE", "")["sources"]
    assert [name for name, _ in sources["out"]] == ["star.starboard", "encoder"]
    rows = [(row["name"], row["is_because"]) for row in sources["rows"][:3]]
    assert rows == [("star.starboard", False), ("encoder", False), ("lights", True)]


def test_overloaded_node_has_the_banner_of_its_consequences():
    behind = dependent_sources("star.fore", "lights", cause="ship_attitude", reason="ship_attitude is behind")
    sources = first_screen(suite_states.suite_state(*behind), History(), "LIVE", "")["sources"]
    assert sources["out"] == [("ship_attitude", "ship_attitude is behind")]
    assert [row["is_because"] for row in sources["rows"][:3]] == [True, True, False]


def test_number_of_banners_is_limited():
    out = [
        suite_states.source_out(name, "no data", out_since_ns=1)
        for name in ("ins", "star.fore", "gnss", "weather", "encoder")
    ]
    banners = first_screen(suite_states.suite_state(*out), History(), "LIVE", "")["sources"]["out"]
    assert [text for _, text in banners[:2]] == ["ins OUT", "star.fore OUT"]
    assert banners[2][1] == "3 more OUT"


def test_overall_safety():
    assert first_screen(WELL, History(), "LIVE", "")["overall"] == {"safety": "SAFE", "text": ""}
    overall = first_screen(suite_states.state_with_two_faults(), History(), "LIVE", "")["overall"]
    assert overall == {"safety": "UNSAFE", "text": "no data from encoder (azimuth, elevation)"}


def test_sources_are_unknown_if_all_outputs_are_old():
    old = suite_states.suite_state(*suite_states.angles_timed_out(*ANGLES, age_s=19.0))
    screen = first_screen(old, History(), "LIVE", "")
    assert screen["is_stale"]
    assert (screen["sources"]["is_known"], screen["sources"]["head"]) == (False, "last: 8 of 8 in")
    assert not first_screen(suite_states.state_with_two_faults(), History(), "LIVE", "")["is_stale"], (
        "the attitude is fresh"
    )


def test_sources_not_configured_come_last_uncounted():
    off = replace(suite_states.source("reference.gyro"), presence=Presence.OFF, age_s=math.inf)
    sources = first_screen(replace(WELL, sources=(off, *WELL.sources)), History(), "LIVE", "")["sources"]
    assert sources["head"] == "8 of 8 in"
    assert (sources["rows"][-1]["name"], sources["rows"][-1]["age"]) == ("reference.gyro", "")


def ribbon(words, start_s=0, name="heading"):
    """Return the intervals of one word a second: None is a point without safety, "-" a second without a point."""
    first_ns = suite_states.NOW_NS - 599 * suite_states.NS
    points = deque(
        SafetyPoint(first_ns + (start_s + second) * suite_states.NS, {name: word})
        for second, word in enumerate(words)
        if word != "-"
    )
    return first_screen(WELL, History(safety=points), "LIVE", "")["ribbons"]["rows"][0]


SAFE, CAUTION = Safety.SAFE, Safety.CAUTION


@pytest.mark.parametrize(
    ("words", "stretches"),
    [
        ([], []),
        ([SAFE, SAFE], [(0, 2, "SAFE")]),
        ([SAFE, CAUTION, CAUTION], [(0, 1, "SAFE"), (1, 3, "CAUTION")]),
        ([SAFE, "-", SAFE], [(0, 1, "SAFE"), (2, 3, "SAFE")]),
        ([SAFE, None, None, SAFE], [(0, 1, "SAFE"), (3, 4, "SAFE")]),
        ([None, CAUTION], [(1, 2, "CAUTION")]),
    ],
)
def test_ribbon_joins_seconds_of_equal_safety(words, stretches):
    # The first point of the history is one second after the start of the ribbon.
    expected = [((start + 1) / 600, (end + 1) / 600, word) for start, end, word in stretches]
    assert ribbon(words) == [[pytest.approx(start), pytest.approx(end), word] for start, end, word in expected]


def test_ribbon_is_ten_minutes_long():
    assert ribbon([SAFE] * 5, start_s=-700) == []


def test_ticks_are_at_even_minutes():
    ticks = first_screen(WELL, History(), "LIVE", "")["ribbons"]["ticks"]
    assert [label for _, label in ticks] == ["11:52", "11:54", "11:56", "11:58", "12:00"]
    assert ticks[-1][0] == pytest.approx(1.0 - 7.0 / 600.0)


def test_start_of_an_outage_is_marked():
    marks = first_screen(suite_states.state_with_two_faults(), History(), "LIVE", "")["ribbons"]["marks"]
    assert marks == [pytest.approx(1.0 - 39.0 / 600.0), pytest.approx(1.0 - 12.0 / 600.0)]
