"""Error of a command with bad arguments."""

from collections.abc import Callable, Sequence

import pytest


def usage_error(main: Callable[[Sequence[str]], int], capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Assert that a command ends with exit code 2 and one line on stderr only; return the line with its newline."""
    code = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err
