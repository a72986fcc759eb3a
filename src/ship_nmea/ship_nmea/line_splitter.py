"""Split received bytes, from an instrument or from the bridge, into lines."""

import re

from ship_bags.nmea.lines import LONGEST_LINE

_END = re.compile(rb"[\r\n]+")


class LineSplitter:
    """Splitter of a byte stream into lines; a line that is too long is cut, but a sentence at its end is kept."""

    def __init__(self) -> None:
        self._rest = b""
        self._is_skipping = False

    def split(self, data: bytes) -> list[bytes]:
        """Return the lines that end in ``data``, and the first :data:`LONGEST_LINE` + 1 bytes of a too long line."""
        *ended, rest = _END.split(self._rest + data)
        found: list[bytes] = []
        for line in ended:
            found += _split_long_line(line, self._is_skipping)
            self._is_skipping = False
        too_long, self._rest = _split_long_line(rest, self._is_skipping)
        self._is_skipping = bool(self._is_skipping or too_long) and not self._rest
        return [line for line in [*found, too_long] if line]

    def flush(self) -> list[bytes]:
        """Return the incomplete line at the end of a datagram or a connection, if any."""
        rest, self._rest, self._is_skipping = self._rest, b"", False
        return [rest] if rest else []


def _split_long_line(line: bytes, is_skipping: bool) -> tuple[bytes, bytes]:
    """Split a line that is too long into its first part, cut, and the sentence at its end.

    A sentence may follow binary data without a line end. A line that is not too long, and whose first part was not cut,
    is returned as the second part.

    Args:
        line: the line, or the part of it received so far.
        is_skipping: True if the first part of the line was already cut.
    """
    if len(line) <= LONGEST_LINE and not is_skipping:
        return b"", line
    start = line.rfind(b"$")
    if start < 0 or len(line) - start > LONGEST_LINE:
        start = len(line)
    return b"" if is_skipping else line[:start][: LONGEST_LINE + 1], line[start:]
