"""One property over many cases in one test: the test runs all cases before it fails, and names each failed case."""

import traceback
from collections.abc import Callable, Iterable

import pytest


def check_every_case(cases: Iterable[tuple[object, ...]], check: Callable[..., None]) -> None:
    """Call ``check(*case)`` for each case; fail at the end with a line for each case that failed.

    The first failure includes its traceback. A test with many cases is one item of pytest this way.
    """
    failed: list[tuple[str, BaseException]] = []
    count = 0
    for case in cases:
        count += 1
        try:
            check(*case)
        except (Exception, pytest.fail.Exception) as error:
            failed.append(("-".join(map(str, case)), error))
    assert count > 0, "no case"
    if failed:
        lines = [f"  {name}: {type(error).__name__}: {str(error).partition(chr(10))[0]}" for name, error in failed]
        first = "".join(traceback.format_exception(failed[0][1]))
        pytest.fail(f"{len(failed)} of {count} cases failed:\n" + "\n".join(lines) + f"\nthe first:\n{first}", False)
