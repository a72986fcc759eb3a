"""A line as it arrives becomes sentences, or what is wrong with it.

A live line is cut where a connection begins, ends or loses bytes. So a sentence counts only from its ``$`` to its
checksum: half a heading, ``$GPHDT,21``, would be a heading as well.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from ship_bags.nmea.sentences import NotOfInterest, Sentence, Unusable, read_sentence
from ship_nmea.line_splitter import LONGEST_LINE

TOO_LONG, NOISE, HALF = "line too long", "binary noise", "half line or no checksum"

# In front of a sentence on an IEC 61162-450 network: the datagram's mark and a TAG block.
_FRONT = re.compile(rb"(UdPbC\x00)?(\\[^\\]*\\)*")
_PRINTABLE = re.compile(rb"[\x20-\x7e\t]*")
_CHECKSUM = re.compile(r".*\*[0-9A-Fa-f]{2}", re.DOTALL)


@dataclass(frozen=True)
class HeardText:
    """A text and what it says."""

    text: str
    says: Sentence | NotOfInterest | Unusable

    @property
    def talker(self) -> str:
        """Two letters of who speaks; empty where the sentence is a maker's own or broken."""
        if isinstance(self.says, Unusable) and not self.says.detail:
            return ""
        return self.text[1:3] if self.text.startswith("$") and not self.text.startswith("$P") else ""


def heard_texts(line: bytes) -> Iterator[HeardText]:
    """What a line says: one sentence, or several of which the ends were lost."""
    if len(line) > LONGEST_LINE:
        yield HeardText(_shown(line), Unusable(TOO_LONG))
        return
    front = _FRONT.match(line)
    line = line[front.end() if front else 0 :].strip()
    if not _PRINTABLE.fullmatch(line):
        yield HeardText(_shown(line), Unusable(NOISE))
        return
    before, *sentences = line.decode("ascii").split("$")
    if before:
        yield HeardText(before, _without_start(before, is_cut=bool(sentences)))
    for body in sentences:
        text = f"${body.rstrip()}"
        yield HeardText(text, read_sentence(text) if _CHECKSUM.fullmatch(text) else Unusable(HALF))


def _without_start(text: str, is_cut: bool) -> Sentence | NotOfInterest | Unusable:
    """What a text without ``$`` says: a line of a mast, an encapsulated sentence (AIS), or the end of a sentence."""
    if text.startswith("!"):
        return NotOfInterest(text.split(",")[0])
    return Unusable(HALF) if is_cut or _CHECKSUM.fullmatch(text) else read_sentence(text)


def _shown(line: bytes) -> str:
    return line.decode("ascii", errors="backslashreplace")
