"""The table before a voyage: failures come first, and the last line states whether the ship is ready."""

from ship_bringup.checks.check_line import CheckLine, Result, summary_text, worst_first

OK, WARN, FAIL = (CheckLine("c", result, "") for result in (Result.OK, Result.WARN, Result.FAIL))
UNCHECKED = CheckLine("c", Result.NOT_CHECKED, "")


def test_summary_counts_failures_and_warnings():
    assert summary_text([OK, OK]) == "READY: all checks passed"
    assert summary_text([OK, WARN, UNCHECKED]) == "READY: 1 warning, 1 not checked"
    assert summary_text([FAIL, OK, WARN, WARN, FAIL]) == "NOT READY: 2 failed, 2 warnings"


def test_failures_come_before_warnings():
    assert worst_first([[OK, WARN], [UNCHECKED], [OK, FAIL]]) == [FAIL, WARN, UNCHECKED, OK, OK]
