from datetime import datetime, timezone
from fractions import Fraction

import erfa
import numpy as np
import pytest

from ship_geometry.earth.time_scales import (
    SECOND_NS,
    julian_date,
    leap_seconds,
    read_leap_seconds,
    tt_julian_date,
    utc_text,
)


def ns_of(*date):
    return int(datetime(*date, tzinfo=timezone.utc).timestamp()) * SECOND_NS


def test_leap_seconds_are_those_compiled_into_erfa():
    # erfa.leap_seconds is a separate table: year, month, TAI - UTC from the first of that month.
    for year, month, tai_minus_utc_s in erfa.leap_seconds.get():
        if year < 1972:
            continue
        assert leap_seconds().at(ns_of(int(year), int(month), 1)) == tai_minus_utc_s
        assert leap_seconds().at(ns_of(int(year), int(month), 1) - 1) in (tai_minus_utc_s - 1, 10.0)
    assert leap_seconds().at(ns_of(2026, 7, 1)) == 37.0


def test_terrestrial_time_is_that_of_erfas_own_utc_chain():
    for year in range(1975, 2026, 5):
        ours = tt_julian_date(ns_of(year, 3, 4, 5, 6, 7) + 123_456_789)
        theirs = erfa.taitt(*erfa.utctai(*erfa.dtf2d("UTC", year, 3, 4, 5, 6, 7.123456789)))
        difference_s = ((ours[0] - theirs[0]) + (ours[1] - theirs[1])) * 86_400.0
        assert abs(difference_s) < 1e-9


def test_nanoseconds_survive_in_the_two_parts():
    time_ns = ns_of(2026, 11, 21) + 43_200_123_456_789
    whole, fraction = julian_date(time_ns)
    exact_day = Fraction(time_ns, 86_400 * SECOND_NS) + Fraction(4_881_175, 2)
    error_s = float((Fraction(float(whole)) + Fraction(float(fraction)) - exact_day) * 86_400)
    assert abs(error_s) < 2e-11
    assert np.isclose(julian_date(time_ns + 1)[1] - fraction, 1.157e-14, rtol=0.01)


def test_arrays_and_single_times_agree():
    times = np.array([ns_of(1999, 12, 31, 23, 59, 59), ns_of(2017, 1, 1), ns_of(2024, 2, 29)])
    whole, fraction = tt_julian_date(times)
    for i, time_ns in enumerate(times):
        assert (whole[i], fraction[i]) == tt_julian_date(int(time_ns))


def test_a_leap_second_is_two_seconds_of_terrestrial_time():
    before, after = tt_julian_date(ns_of(2016, 12, 31, 23, 59, 59)), tt_julian_date(ns_of(2017, 1, 1))
    assert ((after[0] - before[0]) + (after[1] - before[1])) * 86_400.0 == pytest.approx(2.0, abs=1e-9)


@pytest.mark.parametrize("text", ["", "41317.0 1 1 1972 10\n", "# File expires on 28 June 2027\n1 2\n"])
def test_error_names_a_file_without_a_table(tmp_path, text):
    path = tmp_path / "Leap_Second.dat"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"Leap_Second\.dat: not a table of leap seconds"):
        read_leap_seconds(path)


def test_time_as_text():
    assert utc_text(1_404_906_607_800_000_000) == "2014-07-09 11:50:07 UTC"
