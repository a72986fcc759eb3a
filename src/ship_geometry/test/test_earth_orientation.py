from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import astropy_iers_data
import numpy as np
import pytest

from ship_geometry.earth.earth_orientation import (
    OutsideEarthOrientation,
    earth_orientation_table,
    prediction_sigma_s,
    read_finals2000a,
)
from ship_geometry.earth.time_scales import DAY_NS, SECOND_NS, UNIX_EPOCH_MJD, leap_seconds
from ship_geometry.rotations import ARCSEC

RECORD = 188


@pytest.fixture(scope="module")
def table():
    return earth_orientation_table()


def ns_of(*date):
    return int(datetime(*date, tzinfo=timezone.utc).timestamp()) * SECOND_NS


def test_other_series_of_the_iers_agrees(table):
    # EOP 20 C04, made in Paris from other combinations than finals2000A in Washington; columns: ... MJD, x, y, UT1-UTC.
    c04 = np.loadtxt(astropy_iers_data.IERS_B_FILE, usecols=(4, 5, 6, 7))
    c04 = c04[c04[:, 0] >= 51_544.0]
    ours = table.at((c04[:, 0].astype(np.int64) - UNIX_EPOCH_MJD) * DAY_NS)
    ut1_difference_s = ours.ut1_minus_utc_s - c04[:, 3]
    assert np.max(np.abs(ut1_difference_s)) < 1e-3
    # The stated error is at least 50 µs: the two series differ by less on average.
    assert np.std(ut1_difference_s) < 50e-6
    assert np.std(ut1_difference_s) < np.median(ours.ut1_sigma_s)
    assert np.max(np.abs(ours.pole_x / ARCSEC - c04[:, 1])) < 1e-3
    assert np.max(np.abs(ours.pole_y / ARCSEC - c04[:, 2])) < 1e-3


def test_value_of_the_papers_day(table):
    # models.md §2: UT1 - UTC = -0.3055 s on 2014-07-09 11:50.
    assert table.at(1_404_906_607_800_000_000).ut1_minus_utc_s == pytest.approx(-0.3055, abs=5e-5)


def test_interpolation_runs_smoothly_over_a_leap_second(table):
    midnight_ns = ns_of(2017, 1, 1)
    before, after = table.at(midnight_ns - DAY_NS // 2), table.at(midnight_ns + DAY_NS // 2)
    at_midnight = table.at(midnight_ns)
    # The day is 1 ms longer than 86 400 s: apart from the leap second, UT1 - UTC changes by half of that in half a day.
    assert at_midnight.ut1_minus_utc_s - before.ut1_minus_utc_s == pytest.approx(1.0, abs=2e-3)
    assert after.ut1_minus_utc_s - at_midnight.ut1_minus_utc_s == pytest.approx(0.0, abs=2e-3)
    just_before = table.at(midnight_ns - 1)
    assert at_midnight.ut1_minus_utc_s - just_before.ut1_minus_utc_s == pytest.approx(1.0, abs=1e-6)


def test_error_between_the_daily_values_is_within_its_sigma(table):
    # Every second day is omitted and interpolated: with twice the step the error is four times as large.
    recent = table.mjd > 51_544.0
    ut1_s, sigma_s = table.ut1_minus_tai_s[recent], 50e-6
    error_s = 0.5 * (ut1_s[:-2] + ut1_s[2:]) - ut1_s[1:-1]
    assert np.std(error_s) / 4.0 < sigma_s
    assert np.max(np.abs(error_s)) / 4.0 < 3.0 * sigma_s


def test_error_of_a_prediction_grows_from_the_last_measurement(table):
    measured_until_ns = round(table.measured_until_mjd - UNIX_EPOCH_MJD) * DAY_NS
    times_ns = measured_until_ns + DAY_NS * np.array([-1, 0, 1, 30, 100])
    predicted = table.at(times_ns)
    # The prediction error is 5 ms at 30 days by definition; the errors of measurement and interpolation are below 0.1
    # ms.
    assert predicted.ut1_sigma_s[3] == pytest.approx(5e-3, rel=1e-3)
    assert predicted.ut1_sigma_s[4] == pytest.approx(5e-3 * (100 / 30) ** 1.2, rel=1e-3)
    assert predicted.ut1_sigma_s[1] < 1e-4
    assert np.all(np.diff(predicted.ut1_sigma_s[1:]) > 0.0)
    assert prediction_sigma_s(0.0) == 0.0


@pytest.mark.parametrize("date", [(1972, 12, 31), (2060, 1, 1)])
def test_outside_the_table_there_is_a_reason(table, date):
    time_ns = ns_of(*date)
    assert "finals2000A.all covers 1973-01-02" in table.unavailable_text(time_ns)
    with pytest.raises(OutsideEarthOrientation, match=f"no Earth orientation for {date[0]}-.* newer astropy-iers-data"):
        table.at(np.array([ns_of(2020, 1, 1), time_ns]))
    assert table.unavailable_text(ns_of(2020, 1, 1)) is None


def test_table_ends_with_the_leap_seconds(table):
    early = replace(leap_seconds(), known_until_ns=ns_of(2026, 6, 28))
    shorter = replace(table, leap_seconds=early)
    assert shorter.last_ns == early.known_until_ns
    assert shorter.unavailable_text(early.known_until_ns + 1) is not None
    assert shorter.unavailable_text(early.known_until_ns) is None


def test_old_file_predicts_and_then_has_no_values(tmp_path):
    # The file as it was when 2020-01-01 (MJD 58849) was the last measured day, with a hundred days predicted.
    raw = Path(astropy_iers_data.IERS_A_FILE).read_bytes()
    days = 58_849 - 41_684 + 1
    old = bytearray(raw[: (days + 100) * RECORD])
    for day in range(days, days + 100):
        old[day * RECORD + 57 : day * RECORD + 58] = b"P"
    path = tmp_path / "finals2000A.all"
    path.write_bytes(bytes(old))
    table = read_finals2000a(path, leap_seconds())
    assert table.measured_until_mjd == 58_849
    assert table.at(ns_of(2020, 1, 31)).ut1_sigma_s == pytest.approx(5e-3, rel=1e-3)
    assert table.unavailable_text(ns_of(2020, 5, 1)) is not None


def test_error_names_a_file_of_another_format(tmp_path):
    raw = Path(astropy_iers_data.IERS_A_FILE).read_bytes()[: 100 * RECORD]
    path = tmp_path / "finals.txt"
    gap = raw[: 50 * RECORD] + raw[51 * RECORD :]
    letters = raw[:60] + b"x" + raw[61:]
    for content, match in ((b"", "not in the form"), (raw[:-1], "not in the form"), (letters, "could not convert")):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=rf"finals\.txt: .*{match}"):
            read_finals2000a(path, leap_seconds())
    path.write_bytes(gap)
    with pytest.raises(ValueError, match="days or values are missing"):
        read_finals2000a(path, leap_seconds())
