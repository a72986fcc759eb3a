"""Sentences of alerts (IEC 61162-1) that pynmea2 lacks; their definition here adds them to the parser of pynmea2.

pynmea2 registers a sentence under the name of its class, with (description, name, converter) of each field.
"""

import itertools
import unicodedata

import pynmea2

LONGEST_BYTES = 82
"""Maximum length of a sentence in bytes, with its ``$`` and its line end (IEC 61162-1)."""

_RESERVED = "!$*,\\^~\x7f\r\n"
"""Reserved characters: in a text they are written as ``^`` and their hexadecimal code."""
_ASCII_REPLACEMENTS = str.maketrans({
    "″": '"', "′": "'", "°": " deg", "σ": "sigma", "–": "-", "−": "-", "…": "...",
    "×": "x", "·": " ", "µ": "u", "≤": "<=", "≥": ">=", "±": "+-",
})  # fmt: skip
_ELLIPSIS = ".."
"""End of a text that is longer than its field."""


class ALF(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Alert: the state of one alert; two sentences if the alert has a description in addition to its title."""

    fields = (
        ("Total number of sentences, 1 or 2", "total", int),
        ("Sentence number", "number", int),
        ("Sequential message identifier, 0 to 9", "sequence", int),
        ("Time of last change, UTC", "time", pynmea2.nmea_utils.timestamp),
        ("Category: A, B or C", "category"),
        ("Priority: E, A, W or C", "priority"),
        ("State: V, S, A, O, U or N", "state"),
        ("Manufacturer mnemonic code", "manufacturer"),
        ("Alert identifier", "alert", int),
        ("Alert instance, 1 to 999999", "instance", int),
        ("Revision counter, 1 to 99", "revision", int),
        ("Escalation counter, 0 to 9", "escalation", int),
        ("Alert text", "text"),
    )


class ALC(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Cyclic alert list: these fields are followed by manufacturer, identifier, instance and revision of each alert."""

    fields = (
        ("Total number of sentences, 01 to 99", "total", int),
        ("Sentence number", "number", int),
        ("Sequential message identifier, 00 to 99", "sequence", int),
        ("Number of alert entries", "entries", int),
    )


class ACN(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Alert command."""

    fields = (
        ("Time, UTC", "time", pynmea2.nmea_utils.timestamp),
        ("Manufacturer mnemonic code", "manufacturer"),
        ("Alert identifier", "alert", int),
        ("Alert instance, 1 to 999999", "instance", int),
        ("Command: A acknowledge, Q repeat, O responsibility transfer, S silence", "command"),
        ("Sentence status flag: C", "flag"),
    )


class ARC(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Alert command refused."""

    fields = (
        ("Time, UTC", "time", pynmea2.nmea_utils.timestamp),
        ("Manufacturer mnemonic code", "manufacturer"),
        ("Alert identifier", "alert", int),
        ("Alert instance, 1 to 999999", "instance", int),
        ("Refused command: A, Q, O or S", "command"),
    )


class HBT(pynmea2.TalkerSentence):  # type: ignore[misc]
    """Heartbeat."""

    fields = (
        ("Configured repeat interval, s", "interval_s", float),
        ("Equipment status: A or V", "status"),
        ("Sequential sentence identifier, 0 to 9", "sequence", int),
    )


def text_field(text: str, max_length: int) -> str:
    """Return a text as a field of a sentence: ASCII, reserved characters as codes, at most ``max_length`` characters.

    A character without an equivalent in ASCII becomes ``?``. A text that is too long is cut after a word, or
    within a first word that is too long, and ends with ``..``.

    Example:
        >>> text_field("σ 3.2″, limit 2″", 40)
        'sigma 3.2"^2C limit 2"'
        >>> text_field("no data from star.starboard", 20)
        'no data from..'
    """
    words = [_escape(word) for word in _ascii_text(text).split(" ")]
    field = " ".join("".join(word) for word in words)
    if len(field) <= max_length:
        return field
    room, shortened = max_length - len(_ELLIPSIS), ""
    for word in words:
        longer = f"{shortened} {''.join(word)}" if shortened else "".join(word)
        if len(longer) > room:
            break
        shortened = longer
    if not shortened:
        # The first word alone is too long: it is cut to the characters that fit.
        lengths = itertools.accumulate(map(len, words[0]))
        shortened = "".join(code for code, length in zip(words[0], lengths, strict=True) if length <= room)
    return shortened.rstrip(":;") + _ELLIPSIS


def _ascii_text(text: str) -> str:
    parts = unicodedata.normalize("NFKD", text.translate(_ASCII_REPLACEMENTS))
    return "".join(part if part.isascii() else "?" for part in parts if not unicodedata.combining(part))


def _escape(word: str) -> list[str]:
    """Return the characters of a word as written in a field; a code is one element, so that it is never cut."""
    return [f"^{ord(one):02X}" if one in _RESERVED or not one.isprintable() else one for one in word]


def time_field(time_ns: int, decimals: int) -> str:
    """Return the time of day (UTC) of a POSIX time as hhmmss.s with ``decimals`` decimals, rounded.

    Example:
        >>> time_field(1_403_741_109_999_600_000, 3)  # less than half a millisecond before the next second
        '000510.000'
    """
    unit_ns = 10 ** (9 - decimals)
    seconds, parts = divmod((time_ns + unit_ns // 2) // unit_ns, 10**decimals)
    minutes, second = divmod(seconds % 86_400, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}{minute:02d}{second:02d}.{parts:0{decimals}d}"
