"""The loop over cases that replaces a parametrisation: it runs every case, and names those that fail."""

import pytest

from ship_testing.every_case import check_every_case


def test_every_case_is_tried_and_each_failure_is_named() -> None:
    tried = []

    def check(number: int, name: str) -> None:
        tried.append(number)
        if number == 1:
            with pytest.raises(ValueError, match="invalid literal"):
                int("1")
        assert number != 2, "two"

    with pytest.raises(pytest.fail.Exception) as failure:
        check_every_case([(0, "a"), (1, "b"), (2, "c"), (3, "d")], check)
    assert tried == [0, 1, 2, 3]
    message = str(failure.value)
    assert message.startswith("2 of 4 cases failed:\n  1-b: Failed: DID NOT RAISE")
    assert "  2-c: AssertionError: two" in message
    assert "3-d" not in message


def test_no_case_at_all_is_a_failure() -> None:
    with pytest.raises(AssertionError, match="no case"):
        check_every_case([], lambda: None)


def test_cases_without_failure_pass() -> None:
    check_every_case([(1, 1), (2, 2)], lambda left, right: None)
