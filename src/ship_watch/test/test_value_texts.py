"""Texts of values for people."""

import math
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ship_watch import value_texts
from ship_watch.suite_state import ANGLES, AngleState, Safety

ARCSEC = math.pi / 648000
NOON_NS = 1_777_636_807_250_999_999  # 2026-05-01 12:00:07.250999999 by `date -u -d @1777636807`


def angle(name, degrees, **changed):
    fields = {
        "name": name,
        "value": math.radians(degrees),
        "accuracy_95": 4.2 * ARCSEC,
        "limit": 5 * ARCSEC,
        "protection_level": math.nan,
        "safety": Safety.SAFE,
        "reason": "",
        "age_s": 0.1,
        "is_old": False,
        "stamp_ns": NOON_NS,
        "since_ns": NOON_NS,
    }
    return AngleState(**fields | changed)


@pytest.mark.parametrize(
    ("reason", "text"),
    [
        ("no data", "no data from star.bow"),
        ("invalid", "no valid data from star.bow"),
        ("never received", "star.bow never received"),
        ("81 rejected in a row: late", "late data from star.bow"),
        ("3 accepted again", "star.bow rejected"),
        ("a, b: no data", "no data from a, b (star.bow)"),
        ("a: 5 rejected in a row: not fixed", "a (star.bow) rejected: not fixed"),
        ("no stars", "no stars seen by star.bow"),
        ("{x}", "star.bow {x}"),
    ],
)
def test_faults(reason: str, text: str) -> None:
    assert value_texts.fault_text("star.bow", reason) == text


@pytest.mark.parametrize(
    ("name", "degrees", "number", "sense"),
    [
        ("heading", 34.392, "034.39°", "true"),
        ("heading", 359.9951, "000.00°", "true"),
        ("heading", -0.001, "000.00°", "true"),
        ("heading", -90.0, "270.00°", "true"),
        ("azimuth", 359.88, "359.88°", ""),
        ("elevation", 68.74, "+68.74°", ""),
        ("elevation", -5.5, "−05.50°", ""),
        ("pitch", -0.13, "0.1°", "bow down"),
        ("pitch", 0.13, "0.1°", "bow up"),
        ("pitch", -0.04, "0.0°", "level"),
        ("roll", 2.1, "2.1°", "port up"),
        ("roll", -12.34, "12.3°", "port down"),
    ],
)
def test_angle_has_a_word_for_its_sign(name, degrees, number, sense):
    assert value_texts.angle_reading(angle(name, degrees)) == (number, sense)


def test_an_old_value_keeps_its_age_and_loses_its_number_after_a_minute():
    old = angle("heading", 34.39, is_old=True, age_s=12.0)
    assert value_texts.angle_reading(old).number == "034.39°"
    assert value_texts.accuracy_text(old) == "OLD 12 s"
    very_old = angle("heading", 34.39, is_old=True, age_s=61.0)
    assert value_texts.angle_reading(very_old).number == value_texts.NO_VALUE
    assert value_texts.accuracy_text(very_old) == "OLD 61 s"


def test_missing_value_is_a_dash():
    never = angle("pitch", math.nan, is_old=True, age_s=math.inf, accuracy_95=math.nan)
    assert value_texts.angle_reading(never) == (value_texts.NO_VALUE, "")
    assert value_texts.accuracy_text(never) == value_texts.NO_VALUE


@pytest.mark.parametrize(
    ("arcsec", "text"),
    [(4.24, "4.2″"), (99.94, "99.9″"), (99.96, "100″"), (3599, "3599″"), (7200, "2.0°"), (-3, "3.0″")],
)
def test_the_size_of_a_small_angle(arcsec, text):
    assert value_texts.small_angle(arcsec * ARCSEC) == text


def test_limit_has_its_given_digits():
    assert [value_texts.limit_text(each * ARCSEC) for each in (5.0, 2.5, 10.0, math.nan)] == ["5″", "2.5″", "10″", "—"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        *((0.04, "0.0 s"), (9.94, "9.9 s"), (9.96, "10 s"), (99.0, "99 s"), (100.0, "2 min"), (5400.0, "90 min")),
        *((7200.0, "2 h"), (360000.0, "4 d"), (math.inf, "never"), (math.nan, "—"), (-0.2, "0.0 s")),
    ],
)
def test_age_has_one_unit(seconds, text):
    assert value_texts.age_text(seconds) == text


def test_times_are_utc():
    assert value_texts.utc_clock(NOON_NS) == "12:00:07"
    assert value_texts.date_and_clock(NOON_NS) == "2026-05-01 12:00:07.250"
    assert value_texts.utc_clock(0) == "--:--:--"


@given(st.sampled_from(ANGLES), st.floats(allow_nan=True, allow_infinity=True), st.floats(min_value=0.0))
def test_any_number_has_a_short_text(name, degrees, age_s):
    shown = angle(name, degrees, age_s=age_s, accuracy_95=math.radians(degrees))
    number, sense = value_texts.angle_reading(shown)
    assert len(value_texts.accuracy_text(shown)) > 0
    if abs(degrees) <= (90.0 if name == "elevation" else 360.0):
        assert len(number) <= 7
        assert len(f"{number} {sense}") <= 16 or name == "roll"


def test_local_time_has_the_name_of_its_offset() -> None:
    assert value_texts.local_clock(NOON_NS, ZoneInfo("Europe/Oslo")) == "14:00:07 CEST"
    assert value_texts.local_clock(NOON_NS, ZoneInfo("America/Sao_Paulo")) == "09:00:07 UTC-03"
    assert value_texts.local_clock(NOON_NS, None) == ""
    assert value_texts.local_clock(0, ZoneInfo("Europe/Oslo")) == "--:--:--"
