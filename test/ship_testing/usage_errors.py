"""Error of a command with bad arguments."""

from collections.abc import Callable, Sequence

import pytest


def usage_error(main: Callable[[Sequence[str]], int], capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the one line on stderr, with its end, of a command that ends with exit code 2 and no other output."""
    code = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err
