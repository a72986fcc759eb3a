"""The table before a voyage: what failed stands first, and the last line says whether the ship may go."""

from ship_bringup.checks.check_line import CheckLine, Result, verdict, worst_first

OK, WARN, FAIL = (CheckLine("c", result, "") for result in (Result.OK, Result.WARN, Result.FAIL))
UNCHECKED = CheckLine("c", Result.NOT_CHECKED, "")


def test_the_verdict_counts_what_is_not_good():
    assert verdict([OK, OK]) == "READY: all checks passed"
    assert verdict([OK, WARN, UNCHECKED]) == "READY: 1 warning, 1 not checked"
    assert verdict([FAIL, OK, WARN, WARN, FAIL]) == "NOT READY: 2 failed, 2 warnings"


def test_a_failed_row_of_the_last_check_stands_before_the_warnings_of_the_first():
    assert worst_first([[OK, WARN], [UNCHECKED], [OK, FAIL]]) == [FAIL, WARN, UNCHECKED, OK, OK]
