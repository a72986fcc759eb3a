"""Bytes as they arrive, from an instrument or from the bridge, become lines."""

import re

from ship_bags.nmea.lines import LONGEST_LINE

_END = re.compile(rb"[\r\n]+")


class LineSplitter:
    """Puts the lines of a stream together; a line that is too long is cut, but for a sentence at its end."""

    def __init__(self) -> None:
        self._rest = b""
        self._skips = False

    def take(self, data: bytes) -> list[bytes]:
        """The lines that end in the next bytes; one cut has a byte more than :data:`LONGEST_LINE`."""
        *ended, rest = _END.split(self._rest + data)
        found: list[bytes] = []
        for line in ended:
            found += _before_and_sentence(line, self._skips)
            self._skips = False
        too_long, self._rest = _before_and_sentence(rest, self._skips)
        self._skips = bool(self._skips or too_long) and not self._rest
        return [line for line in [*found, too_long] if line]

    def end(self) -> list[bytes]:
        """What is left where a datagram or a connection ends."""
        rest, self._rest, self._skips = self._rest, b"", False
        return [rest] if rest else []


def _before_and_sentence(line: bytes, is_skipped: bool) -> tuple[bytes, bytes]:
    """Return a line as what is too long in it, cut, and the rest: a sentence may follow binary data without a line end.

    Args:
        line: or the beginning of one.
        is_skipped: whether it is the rest of a line that was cut already.
    """
    if len(line) <= LONGEST_LINE and not is_skipped:
        return b"", line
    start = line.rfind(b"$")
    if start < 0 or len(line) - start > LONGEST_LINE:
        start = len(line)
    return b"" if is_skipped else line[:start][: LONGEST_LINE + 1], line[start:]
