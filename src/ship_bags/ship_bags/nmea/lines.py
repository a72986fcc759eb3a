"""Parsing of a line of a live source or a log into sentences, or into the reasons why the line is unusable.

A line is cut where a connection begins, ends or loses bytes, and where a logger stops. Therefore a sentence counts only
if it is present from its ``$`` to its checksum; a truncated heading, ``$GPHDT,21``, would look valid. On request,
sentences without checksum are checked by the forms of :mod:`ship_bags.nmea.complete_sentences`.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from ship_bags.nmea.complete_sentences import is_complete
from ship_bags.nmea.sentences import NotOfInterest, Sentence, Unusable, read_sentence

LONGEST_LINE = 512
"""Maximum length of a line, bytes; a standard sentence has 82, a proprietary sentence up to three times as many."""

TOO_LONG, NOISE, INCOMPLETE = "line too long", "binary noise", "half line or no checksum"
BINARY = "binary"

REQUIRED, OPTIONAL = "required", "optional"
"""Checksums of an instrument's sentences: required or optional."""

# In front of a sentence on an IEC 61162-450 network: the datagram's mark and a TAG block.
_FRONT = re.compile(rb"(UdPbC\x00)?(\\[^\\]*\\)*")
_PRINTABLE = re.compile(rb"[\x20-\x7e\t]*")
_CHECKSUM = re.compile(r".*\*[0-9A-Fa-f]{2}", re.DOTALL)


@dataclass(frozen=True)
class ParsedText:
    """Text with its parsing result."""

    text: str
    result: Sentence | NotOfInterest | Unusable

    @property
    def talker(self) -> str:
        """Two letters of the talker; empty for a proprietary or broken sentence."""
        if self.result == NotOfInterest(BINARY) or (isinstance(self.result, Unusable) and not self.result.detail):
            return ""
        return self.text[1:3] if self.text.startswith("$") and not self.text.startswith("$P") else ""


def parse_line(line: bytes, needs_checksum: bool = True) -> Iterator[ParsedText]:
    """Yield the texts of a line: one sentence, or several whose line ends were lost.

    Args:
        line: bytes of the line; it may begin with the mark of a datagram and TAG blocks.
        needs_checksum: True to reject sentences without a checksum; otherwise complete sentences are used.
    """
    if len(line) > LONGEST_LINE:
        yield ParsedText(_printable(line), Unusable(TOO_LONG))
        return
    front = _FRONT.match(line)
    before, *sentences = line[front.end() if front else 0 :].strip().split(b"$")
    if not _PRINTABLE.fullmatch(before):
        yield ParsedText(_printable(before), _classify_binary(is_before_sentence=bool(sentences)))
    elif before:
        text = before.decode("ascii")
        yield ParsedText(text, _parse_without_start(text, is_cut=bool(sentences)))
    for place, body in enumerate(sentences, start=1):
        if not _PRINTABLE.fullmatch(body):
            yield ParsedText(_printable(b"$" + body), _classify_binary(is_before_sentence=place < len(sentences)))
            continue
        text = f"${body.decode('ascii').rstrip()}"
        yield ParsedText(text, _parse_text(text, needs_checksum))


def _parse_text(text: str, needs_checksum: bool) -> Sentence | NotOfInterest | Unusable:
    """Parse a text that begins with ``$``."""
    if _CHECKSUM.fullmatch(text):
        return read_sentence(text)
    if needs_checksum or "*" in text:
        return Unusable(INCOMPLETE)
    result = read_sentence(text)
    return Unusable(INCOMPLETE) if isinstance(result, Sentence) and not is_complete(result.kind, text) else result


def is_talker(text: str) -> bool:
    """Return True for two capital letters or digits, the form of a talker."""
    return len(text) == 2 and text.isascii() and text.isalnum() and text.isupper()


def _classify_binary(is_before_sentence: bool) -> NotOfInterest | Unusable:
    """Classify binary data: messages of another protocol (UBX, RTCM) before a sentence, or noise."""
    return NotOfInterest(BINARY) if is_before_sentence else Unusable(NOISE)


def _parse_without_start(text: str, is_cut: bool) -> Sentence | NotOfInterest | Unusable:
    """Parse a text without ``$``: a line ``MET`` of a weather mast, AIS, or the end of a sentence."""
    if text.startswith("!"):
        return NotOfInterest(text.split(",")[0])
    return Unusable(INCOMPLETE) if is_cut or _CHECKSUM.fullmatch(text) else read_sentence(text)


def _printable(line: bytes) -> str:
    return line.decode("ascii", errors="backslashreplace")
