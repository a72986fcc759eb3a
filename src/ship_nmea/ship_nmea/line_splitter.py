"""Bytes as they arrive, from an instrument or from the bridge, become lines."""

import re

from ship_bags.nmea.lines import LONGEST_LINE

_END = re.compile(rb"[\r\n]+")


class LineSplitter:
    """Puts the lines of a stream together; a line that is too long is cut and its rest left out."""

    def __init__(self) -> None:
        self._rest = b""
        self._skips = False

    def take(self, data: bytes) -> list[bytes]:
        """The lines that end in the next bytes; one cut has a byte more than :data:`LONGEST_LINE`."""
        *ended, rest = _END.split(self._rest + data)
        if self._skips and ended:
            del ended[0]
            self._skips = False
        if len(rest) > LONGEST_LINE:
            if not self._skips:
                ended.append(rest)
            self._skips, rest = True, b""
        self._rest = b"" if self._skips else rest
        return [line[: LONGEST_LINE + 1] for line in ended if line]

    def end(self) -> list[bytes]:
        """What is left where a datagram or a connection ends."""
        rest, self._rest, self._skips = self._rest, b"", False
        return [rest] if rest else []
