"""Protection levels belong to the filter state of their attitude, also when a source is excluded."""

import functools
import re
from typing import Any

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC
from ship_node.messages.common_messages import Level
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, change_where, stamp_of
from ship_testing.published_levels import ProtectionLevelRun
from ship_testing.small_voyage import FORE, INS, STARBOARD, Run, new_adapter, remove_interval, run_adapter, voyage

UNAVAILABLE = 2
SHIFT_NS = START_NS + 5 * SECOND_NS


def shift_mounting(message: Any) -> None:
    message.elevation += 60.0 * ARCSEC
    # The covariance about the axes of the horizon stays that of the message.


@functools.cache
def run_with_mounting_shift() -> Run:
    """Two star sensors, one of them with a mounting shift of 60″ after five seconds."""

    def is_shifted(arrival: Arrival) -> bool:
        return arrival.topic == FORE and arrival.stamp_ns >= SHIFT_NS

    return run_adapter(new_adapter(), change_where(voyage(10.0), is_shifted, shift_mounting))


def test_a_mounting_shift_is_excluded_within_three_measurements() -> None:
    reports = [m for m in run_with_mounting_shift().messages("ship/integrity") if m.excluded]
    assert reports[0].excluded == ["star.fore"]
    assert stamp_of(reports[0]) - SHIFT_NS < 0.7 * SECOND_NS  # three periods of 0.2 s, and 0.12 s of latency


def test_the_diagnostics_name_the_excluded_source_and_the_time() -> None:
    report = next(m for m in run_with_mounting_shift().messages("ship/integrity") if m.excluded)
    report_ns = START_NS + 9 * SECOND_NS
    ((level, text),) = run_with_mounting_shift().diagnostics("integrity", report_ns, report_ns + SECOND_NS)
    assert level == Level.WARN
    seconds = re.fullmatch(r"excluded: star\.fore for (\d+) s", text)
    assert seconds is not None
    # The diagnostics refer to the last published levels, which are published once a second.
    assert int(seconds[1]) == pytest.approx((report_ns - stamp_of(report)) / SECOND_NS, abs=1.5)


def test_no_level_is_published_for_an_attitude_before_the_exclusion() -> None:
    """The remaining one of two sensors cannot be checked: there is no level from then on."""
    reports = [m for m in run_with_mounting_shift().messages("ship/integrity") if m.excluded]
    assert {m.state for m in reports} == {UNAVAILABLE}
    assert np.isnan([m.protection_level for m in reports]).all()
    attitudes = {stamp_of(m): m for m in run_with_mounting_shift().messages("ship/attitude")}
    assert "star.fore" not in attitudes[stamp_of(reports[0])].sources


def test_levels_are_published_before_the_attitude_and_once_a_second() -> None:
    reports = run_with_mounting_shift().messages("ship/integrity")
    before = [m for m in reports if not m.excluded and stamp_of(m) > START_NS + SECOND_NS]
    assert 3 <= len(before) <= 6
    assert all(np.all(np.asarray(m.protection_level) < 200.0 * ARCSEC) for m in before)


def test_published_levels_cover_each_output() -> None:
    """One sensor has a mounting shift, all stars time out, or the INS times out: no level is too small."""
    shifted = change_where(voyage(20.0), lambda a: a.topic == FORE and a.stamp_ns >= SHIFT_NS, shift_mounting)
    without_stars = remove_interval(voyage(20.0), 5.0, 9.0, FORE, STARBOARD)
    without_ins = remove_interval(voyage(20.0), 5.0, 6.5, INS)
    for arrivals in (shifted, without_stars, without_ins):
        run = ProtectionLevelRun(new_adapter(), arrivals)
        assert len(run.published_and_own_levels()) > 400
        assert run.exceedances() == []


def test_constant_levels_are_published_once_a_second() -> None:
    run = ProtectionLevelRun(new_adapter(), voyage(30.0))
    reports = [m for m in run.messages("ship/integrity") if stamp_of(m) >= START_NS + 15 * SECOND_NS]
    assert 14 <= len(reports) <= 16
