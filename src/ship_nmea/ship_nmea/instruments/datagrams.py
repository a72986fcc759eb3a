"""Lines in datagrams: a sentence cut at the end of a datagram is joined with the next datagram of the same sender."""

import re

from ship_nmea.line_splitter import LineSplitter

JOIN_TIMEOUT_NS = 200_000_000
"""Maximum wait for the rest of a cut sentence, ns."""

_MAX_INCOMPLETE = 100
"""Maximum number of senders with a cut sentence in memory: a bound in case of forged addresses."""
_CUT_SENTENCE = re.compile(rb".*[$!](?!.*\*[0-9A-Fa-f]{2}\s*$)[^$!]*", re.DOTALL)
"""Pattern of a text that ends within a sentence, before the end of its checksum."""


class DatagramLines:
    """Joins the lines of datagrams, separately for each sender."""

    def __init__(self) -> None:
        self._incomplete: dict[str, tuple[int, int, bytes]] = {}

    def split(self, data: bytes, sender: str, arrival_ns: int, now_ns: int) -> list[tuple[int, bytes, str]]:
        """Return arrival, line and sender of the complete lines, and of cut lines whose rest has not arrived in time.

        Args:
            data: data of the datagram; empty if no datagram arrived.
            sender: sender of the datagram.
            arrival_ns: arrival time of the datagram, by the node's clock.
            now_ns: steady time.
        """
        lines = self._timed_out_lines(now_ns)
        if not data:
            return lines
        *_, first_part = self._incomplete.pop(sender, (0, 0, b""))
        splitter = LineSplitter()
        lines += [(arrival_ns, line, sender) for line in splitter.split(first_part + data)]
        for rest in splitter.flush():
            if _CUT_SENTENCE.fullmatch(rest) and len(self._incomplete) < _MAX_INCOMPLETE:
                self._incomplete[sender] = now_ns, arrival_ns, rest
            else:
                lines.append((arrival_ns, rest, sender))
        return lines

    def _timed_out_lines(self, now_ns: int) -> list[tuple[int, bytes, str]]:
        """Return the cut sentences whose rest has not arrived in time."""
        late = [sender for sender, (since_ns, _, _) in self._incomplete.items() if now_ns - since_ns > JOIN_TIMEOUT_NS]
        return [(*self._incomplete.pop(sender)[1:], sender) for sender in late]
